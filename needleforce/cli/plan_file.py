"""The plan of an insertion in a file, for `live` and `view`."""

from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from needleforce.anatomy import AnatomyError, Layer, PlanMatch, read_labels
from needleforce.cli.terminal import CommandError, progress_bar
from needleforce.scene import PlanScene

LEAST_VOXELS = 500


PLAN = "plan.json"


MOST_m = 10.0  # Of a coordinate; beyond it the unit is not the metre


Point = tuple[float, float, float]


class Planned(NamedTuple):
    """What a plan's file says.

    Attributes:
        entry_in_base_m: None: depths count as the session's.
    """

    scene: PlanScene
    match: PlanMatch
    entry_in_base_m: np.ndarray | None


class _LayerOfFile(msgspec.Struct, forbid_unknown_fields=True):
    name: str
    exit_m: float
    exit_std_m: float = 0.5e-3
    is_obstacle: bool = False


class _PlanFile(msgspec.Struct, forbid_unknown_fields=True):
    """See docs/scene.md."""

    rotation: tuple[Point, Point, Point] = (
        (1.0, 0.0, 0.0),
        (0.0, 1.0, 0.0),
        (0.0, 0.0, 1.0),
    )
    translation_m: Point = (0.0, 0.0, 0.0)
    entry_m: Point | None = None
    target_m: Point | None = None
    offset_std_m: float = 3e-3
    start_m: float = 0.0
    layers: tuple[_LayerOfFile, ...] = ()


def read_plan(place: Path) -> Planned:
    """A plan from its file, or from a folder with `plan.json`; labels may lie beside
    it.
    """
    path = place / PLAN if place.is_dir() else place
    try:
        plan = msgspec.json.decode(path.read_bytes(), type=_PlanFile)
        _require_places(plan)
        scene, layers = _segmented(plan, path.parent)
        match = PlanMatch(_given(plan) or layers, plan.offset_std_m)
    except (OSError, ValueError, msgspec.MsgspecError, AnatomyError) as error:
        raise CommandError(
            f"{path}: {error}; docs/scene.md says what a plan holds"
        ) from error
    entry_m = None if scene.entry_m is None else scene.to_robot(scene.entry_m)
    return Planned(scene._replace(layers=match.layers), match, entry_m)


def _require_places(plan: _PlanFile) -> None:
    """Refuse half of a way, and millimetres."""
    if (plan.entry_m is None) != (plan.target_m is None):
        raise ValueError("one of entry_m and target_m in it: expected both, or neither")
    places = (plan.translation_m, plan.entry_m or (), plan.target_m or ())
    if not all(abs(part) < MOST_m for place in places for part in place):
        raise ValueError(
            f"a place beyond {MOST_m:g} m in it: expected metres, not millimetres"
        )


def _segmented(plan: _PlanFile, folder: Path) -> tuple[PlanScene, list[Layer]]:
    """Surfaces, and the layers between entry and target, of the labels in a folder."""
    files = [*sorted(folder.glob("labels*.n*")), *sorted(folder.glob("*.seg.nrrd"))]
    turn = np.array(plan.rotation)
    shift = np.array(plan.translation_m)
    if (
        not np.allclose(turn @ turn.T, np.eye(3), atol=1e-3)
        or np.linalg.det(turn) < 0.0
    ):
        raise ValueError(
            f"rotation is {turn.tolist()}: expected orthonormal rows, no mirror image"
        )
    if plan.entry_m is None or plan.target_m is None:
        if not plan.layers:
            raise ValueError("neither layers nor entry_m and target_m in it")
        return PlanScene(rotation=turn, translation_m=shift), []
    way = np.array(plan.entry_m), np.array(plan.target_m)
    if np.array_equal(*way):
        raise ValueError(
            f"entry_m and target_m are the same point {list(plan.entry_m)}"
        )
    if not files:
        if not plan.layers:
            raise ValueError(
                "no layers in it, nor labels.nii.gz, .nrrd or a .seg.nrrd beside it"
            )
        return PlanScene((), (), *way, turn, shift), []
    labels = read_labels(files[0])
    with progress_bar("surfaces") as progress:
        large = [item.name for item in labels.structures if item.voxels >= LEAST_VOXELS]
        made = tuple(labels.surfaces(large, progress).values())
    layers = [] if plan.layers else labels.layers_along(*way)
    return PlanScene(made, (), *way, turn, shift), layers


def _given(plan: _PlanFile) -> list[Layer]:
    """The layers that stand in the file itself."""
    found = []
    depth_m = plan.start_m
    std_m = 0.0
    for one in plan.layers:
        if not one.exit_m > depth_m:
            raise ValueError(
                f"{one.name!r} ends at {one.exit_m} m, not below where it begins"
            )
        found.append(
            Layer(one.name, depth_m, one.exit_m, std_m, one.exit_std_m, one.is_obstacle)
        )
        depth_m = one.exit_m
        std_m = one.exit_std_m
    return found
