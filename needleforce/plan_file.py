"""The plan of an insertion from a file, for a session and the scene.

    plan = read_plan("plan")
    plan.follow_with(session)

The file is `plan.json`, see docs/how-to/scene.md; a segmentation may lie beside it.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec
import numpy as np

from foundation.arrays import Array
from foundation.errors import NeedleforceError
from needleforce.anatomy import (
    AnatomyError,
    FreeSpace,
    Grid,
    Labels,
    Layer,
    NeedleSurroundings,
    PlanMatch,
    Registration,
    Volume,
    read_labels,
    read_volume,
    require_clear_path,
)
from needleforce.anatomy.clearance import (
    MARGIN_m,
    NEEDLE_RADIUS_m,
    describe_clearance,
    too_near,
)
from needleforce.anatomy.labels import SHOWN_VOXEL_m
from needleforce.needle_on_plan import PlannedPath
from needleforce.plan_binding import (
    MadeOf,
    check_files,
    check_registration,
    path_sha256,
)
from needleforce.scene import PlanScene

if TYPE_CHECKING:
    from needleforce.session import InsertionSession

PLAN = "plan.json"


MIN_VOXELS = 500
"""Structures with fewer voxels are not shown."""


ROTATION_TOLERANCE = 1e-3
"""By so much the rows of a rotation may miss being orthonormal."""


PLAN_VERSION = 2
"""Of the file that `needleforce plan` writes; 1 was that of version 0.2."""

MISSING_PATH = "neither layers nor entry_m and target_m in it"
MISSING_LAYERS = "no layers in it, nor labels.nii.gz, .nrrd or a .seg.nrrd beside it"


GIVE_PLAN = "Give plan.json, or the folder that holds it beside labels.nii.gz."


class PlanFileError(NeedleforceError, ValueError):
    """A plan's file that cannot be read, or whose plan cannot be followed."""

    usual_advice = GIVE_PLAN


class Point(NamedTuple):
    """A place or a direction.

    Attributes:
        x: Along the first axis.
        y: Along the second axis.
        z: Along the third axis.
    """

    x: float
    y: float
    z: float


class Rotation(NamedTuple):
    """A rotation matrix.

    Attributes:
        x: First row.
        y: Second row.
        z: Third row.
    """

    x: Point
    y: Point
    z: Point


NO_ROTATION = Rotation(Point(1.0, 0.0, 0.0), Point(0.0, 1.0, 0.0), Point(0.0, 0.0, 1.0))


class LoadedPlan(NamedTuple):
    """A plan as a session and the scene take it.

    Attributes:
        scene: Anatomy and plan for the viewer.
        match: The layers with which ruptures are matched.
        entry_in_base_m: The entry point in the robot's base, shape (3,) [m]; None where
            depths count as the session's.
        warnings: What is wrong with the plan, or could not be checked.
        path: The planned path in the robot's base; None without entry and target.
        surroundings: The structures at risk around it; None where there are no labels.
    """

    scene: PlanScene
    match: PlanMatch
    entry_in_base_m: Array | None
    warnings: tuple[str, ...] = ()
    path: PlannedPath | None = None
    surroundings: NeedleSurroundings | None = None

    def follow_with(self, session: "InsertionSession") -> None:
        """Let a session follow the plan."""
        session.follow(
            self.match,
            self.entry_in_base_m,
            path=self.path,
            surroundings=self.surroundings,
        )


class _PlannedLayer(msgspec.Struct, forbid_unknown_fields=True):
    """A layer in the file.

    Attributes:
        name: Name of the structure.
        exit_m: Depth at which the needle leaves it [m].
        exit_std_m: Its standard deviation [m].
        is_obstacle: Bone or cartilage.
    """

    name: str
    exit_m: float
    exit_std_m: float = 0.5e-3
    is_obstacle: bool = False


class _PlanFile(msgspec.Struct, forbid_unknown_fields=True):
    """What stands in the file; see docs/how-to/scene.md.

    Attributes:
        rotation: From the model to the robot's base.
        translation_m: From the model to the robot's base [m].
        entry_m: Entry point in the model [m].
        target_m: Target in the model [m].
        offset_std_m: Standard deviation of a shift of all layers [m].
        covariance: Of the registration: a small rotation [rad] about the pivot and a
            shift [m] in the robot's base, (6, 6); without it `offset_std_m` counts for
            all directions.
        pivot_m: In the robot's base [m].
        start_m: Depth at which the first layer begins [m].
        layers: Layers along the needle.
        needle_radius_m: Radius of the needle [m].
        margin_m: Distance that stays free around it [m].
        accepted_obstacles: Names of obstacles that the needle may touch.
        situs_inversus: Liver and spleen of the patient are exchanged.
        version: Of the file's format; 0 for one written by hand.
        target: Name of the target.
        ct: CT, from the file's folder.
        labels: Segmentation, from the file's folder.
        structures: Names of structures by those in the segmentation, or a file with
            them, from the file's folder.
        registration: What the registration rests on, and where it puts the path.
        made_of: CT, labels and path that the plan was made of.
    """

    version: int = 0
    target: str = ""
    ct: str = ""
    labels: str = ""
    structures: str | dict[str, str] = ""
    registration: dict[str, Any] | None = None
    made_of: MadeOf | None = None
    rotation: Rotation | None = None
    translation_m: Point = Point(0.0, 0.0, 0.0)
    entry_m: Point | None = None
    target_m: Point | None = None
    offset_std_m: float = 3e-3
    covariance: tuple[tuple[float, ...], ...] = ()
    pivot_m: Point = Point(0.0, 0.0, 0.0)
    start_m: float = 0.0
    layers: tuple[_PlannedLayer, ...] = ()
    needle_radius_m: float = NEEDLE_RADIUS_m
    margin_m: float = MARGIN_m
    accepted_obstacles: tuple[str, ...] = ()
    situs_inversus: bool = False


class _Anatomy(NamedTuple):
    """What lies beside a plan.

    Attributes:
        scene: Anatomy and plan for the viewer.
        labels: The segmentation, if there is one.
        warnings: What has changed since the plan was made.
    """

    scene: PlanScene
    labels: Labels | None = None
    warnings: tuple[str, ...] = ()


def read_plan(
    place: str | Path,
    *,
    is_past: bool = False,
    situs_inversus: bool = False,
    progress: Callable[[float], None] = lambda fraction: None,
) -> LoadedPlan:
    """Return a plan from its file, or from a folder with `plan.json`.

    Args:
        place: The file or folder.
        is_past: The insertion is over: obstacles on its path are a warning.
        situs_inversus: Liver and spleen are exchanged, whether or not the plan says so.
        progress: Takes the fraction of the surfaces that is made.

    Raises:
        PlanFileError: The file cannot be read, or holds no plan that can be followed.
    """
    path = Path(place)
    if path.is_dir():
        path /= PLAN
    try:
        plan = msgspec.json.decode(path.read_bytes(), type=_PlanFile)
        plan.situs_inversus |= situs_inversus
        _require_metres(plan)
        _require_registration(plan)
        scene, labels, changes = _anatomy_of(plan, path.parent, progress)
        layers = _planned_layers(plan) or list(scene.layers)
        planned = _path_of(plan, scene)
        warnings = [
            *changes,
            *_check_obstacles(plan, labels, layers, is_past=is_past),
        ]
        surroundings = _surroundings_of(plan, labels)
        if planned is None:
            warnings.append(
                "no entry and target in the plan: not checked whether the "
                "needle is on it"
            )
        match = PlanMatch(
            layers,
            plan.offset_std_m,
            accepted_obstacles=[layer.name for layer in layers]
            if is_past
            else plan.accepted_obstacles,
        )
    except (OSError, ValueError, msgspec.MsgspecError, AnatomyError) as error:
        raise PlanFileError(f"{path}: {error}") from error
    entry_m = None if scene.entry_m is None else scene.to_robot(scene.entry_m)
    return LoadedPlan(
        scene._replace(
            layers=match.layers,
            warnings=tuple(warnings),
            watched=() if surroundings is None else surroundings.names,
        ),
        match,
        entry_m,
        tuple(warnings),
        planned,
        surroundings,
    )


def _registration_of(plan: _PlanFile) -> Registration:
    """Return where the patient lies in the robot's base."""
    return Registration(
        rotation=_checked_rotation(plan),
        translation_m=np.array(plan.translation_m),
        covariance=np.array(plan.covariance),
        pivot_m=np.array(plan.pivot_m),
        degrees=np.inf,
        residual_rms_m=np.nan,
    )


def _space_of(plan: _PlanFile) -> FreeSpace:
    """Return what must stay free around the needle."""
    return FreeSpace(plan.needle_radius_m, plan.margin_m, _largest_std_m(plan))


def _surroundings_of(
    plan: _PlanFile, labels: Labels | None
) -> NeedleSurroundings | None:
    """Return the structures at risk around the path; None without labels and path."""
    if labels is None or plan.entry_m is None or plan.target_m is None:
        return None
    return NeedleSurroundings(
        labels,
        _registration_of(plan),
        plan.entry_m,
        plan.target_m,
        _space_of(plan),
        leave_out=(plan.target, *plan.accepted_obstacles),
    )


def _largest_std_m(plan: _PlanFile) -> float:
    """Return the largest deviation of the registration at entry and target."""
    if not plan.covariance or plan.entry_m is None or plan.target_m is None:
        return plan.offset_std_m
    registration = _registration_of(plan)
    return registration.largest_std_m(np.array([plan.entry_m, plan.target_m]))


def _path_of(plan: _PlanFile, scene: PlanScene) -> PlannedPath | None:
    """Return the planned path in the robot's base; None without entry and target."""
    # By so much a variance may be negative: it is written in decimals
    max_rounding = 1e-12
    if scene.entry_m is None or scene.target_m is None:
        return None
    entry_m = scene.to_robot(scene.entry_m)
    target_m = scene.to_robot(scene.target_m)
    if not plan.covariance:
        path = PlannedPath.of_std(entry_m, target_m, plan.offset_std_m)
        return replace(path, tolerance_m=plan.margin_m)
    if {len(plan.covariance), *map(len, plan.covariance)} != {6}:
        raise ValueError("covariance in it is not 6 x 6")
    covariance = np.array(plan.covariance)
    least = np.linalg.eigvalsh(covariance)[0]
    if not np.allclose(covariance, covariance.T) or least < -max_rounding:
        raise ValueError("covariance in it is not symmetric and positive")
    return PlannedPath(
        entry_m,
        target_m,
        covariance,
        np.array(plan.pivot_m),
        tolerance_m=plan.margin_m,
    )


def _check_obstacles(
    plan: _PlanFile, labels: Labels | None, layers: Sequence[Layer], *, is_past: bool
) -> list[str]:
    """Return warnings of what the path comes near to; refuse obstacles.

    Args:
        plan: The plan.
        labels: The segmentation, if there is one.
        layers: Layers along the path.
        is_past: The insertion is over: obstacles are a warning, too.

    Raises:
        PlanError: The path comes too near to an obstacle.
    """
    if labels is None or plan.entry_m is None or plan.target_m is None:
        warnings = ["no labels beside the plan: clearance of obstacles not checked"]
        warnings += [
            f"the path runs through {layer.name}"
            for layer in layers
            if layer.is_obstacle
        ]
        return warnings
    space = _space_of(plan)
    clearances = labels.clearances(plan.entry_m, plan.target_m)
    if not is_past:
        require_clear_path(clearances, space, plan.accepted_obstacles)
    warnings = [
        f"the path {describe_clearance(one)}: less than {space}"
        for one in too_near(clearances, space)
    ]
    if not clearances:
        names = ", ".join(item.name for item in labels.structures)
        warnings.append(
            "no structure is known as bone, vessel or another at risk by its name: "
            f"clearance not checked; there are {names}: `structures` in the plan says "
            "what they are"
        )
    return [*warnings, labels.unchecked] if labels.unchecked else warnings


def _require_metres(plan: _PlanFile) -> None:
    """Refuse one end of the path without the other, and places in millimetres."""
    max_coordinate_m = 10.0  # A larger coordinate is not in metres [m]
    if (plan.entry_m is None) != (plan.target_m is None):
        raise ValueError("one of entry_m and target_m in it: expected both, or neither")
    points = (plan.translation_m, plan.entry_m or (), plan.target_m or ())
    coordinates_m = [coordinate for point in points for coordinate in point]
    if not all(abs(coordinate) < max_coordinate_m for coordinate in coordinates_m):
        raise ValueError(
            f"a place beyond {max_coordinate_m:g} m in it: expected metres, not "
            "millimetres"
        )


def _require_registration(plan: _PlanFile) -> None:
    """Refuse a plan of `needleforce plan` that was not registered."""
    if plan.version not in (0, PLAN_VERSION):
        raise ValueError(
            f"it has version {plan.version}: expected {PLAN_VERSION}, as "
            "`needleforce plan` writes it; earlier ones do not say what CT and labels "
            "they were made of"
        )
    if plan.version and plan.made_of is None:
        raise ValueError(
            "it does not say what it was made of (made_of): plan again with "
            "`needleforce plan`, and register"
        )
    if plan.version and plan.rotation is None:
        raise ValueError(
            "it does not say where the patient lies in the robot's base: expected the "
            "plan that `needleforce register --plan` writes"
        )
    if plan.version and plan.entry_m is not None and plan.target_m is not None:
        check_registration(
            plan.registration,
            _registration_of(plan),
            np.array(plan.entry_m),
            np.array(plan.target_m),
        )


def _anatomy_of(
    plan: _PlanFile, folder: Path, progress: Callable[[float], None]
) -> _Anatomy:
    """Return the scene of a plan, and the labels beside it.

    Surfaces are those of the labels in a folder, and so are the layers between entry
    and target where the plan has none.
    """
    rotation = _checked_rotation(plan)
    translation_m = np.array(plan.translation_m)
    if plan.entry_m is None or plan.target_m is None:
        if not plan.layers:
            raise ValueError(MISSING_PATH)
        return _Anatomy(PlanScene(rotation=rotation, translation_m=translation_m))
    entry_m = np.array(plan.entry_m)
    target_m = np.array(plan.target_m)
    if np.array_equal(entry_m, target_m):
        raise ValueError(
            f"entry_m and target_m are the same point {list(plan.entry_m)}"
        )
    scene = PlanScene((), (), entry_m, target_m, rotation, translation_m)
    file = _find_labels(plan, folder)
    if file is None:
        if not plan.layers:
            raise ValueError(MISSING_LAYERS)
        return _Anatomy(scene)
    labels, scan, warnings = _read_files(plan, file, folder)
    if scan is not None:
        scene = scene._replace(scan=crop_scan(scan, entry_m, target_m))
    surfaces = _large_surfaces(labels, progress)
    layers = [] if plan.layers else labels.layers_along(entry_m, target_m)
    return _Anatomy(
        scene._replace(surfaces=surfaces, layers=layers), labels, tuple(warnings)
    )


def _read_files(
    plan: _PlanFile, file: Path, folder: Path
) -> tuple[Labels, Volume | None, list[str]]:
    """Return labels and CT, if there is one, and what has changed in them.

    Args:
        plan: The plan.
        file: The labels.
        folder: Where the plan lies.
    """
    names = plan.structures or None
    if isinstance(names, str):
        names = folder / names
    labels = read_labels(file, names, situs_inversus=plan.situs_inversus)
    if plan.made_of is not None and not plan.ct:
        raise ValueError("it does not name its CT (ct)")
    scans = [folder / plan.ct] if plan.ct else sorted(folder.glob("ct.n*"))
    if not scans:
        return labels, None, []
    scan = read_volume(scans[0])
    warnings = _check_made_of(plan, scan, labels)
    return labels.checked_against(scan).with_dense(scan), scan, warnings


def _check_made_of(plan: _PlanFile, scan: Volume, labels: Labels) -> list[str]:
    """Return what has changed since a plan was made; refuse what does not fit."""
    if plan.made_of is None:
        return ["the plan does not say what CT and labels it was made of: not checked"]
    entry_m = np.array(plan.entry_m)
    target_m = np.array(plan.target_m)
    path_sum = path_sha256(
        entry_m,
        target_m,
        [(layer.name, layer.exit_m) for layer in plan.layers],
        plan.needle_radius_m,
        plan.margin_m,
    )
    return check_files(
        plan.made_of,
        scan,
        labels,
        path_sum=path_sum,
        path=(entry_m, target_m),
        layers=_planned_layers(plan),
    )


def crop_scan(scan: Volume, entry_m: Array, target_m: Array) -> Volume | None:
    """Return the part of a CT around a path; None where the CT does not reach it."""
    crop_margin_m = 0.1  # The scene keeps the CT up to here from the path [m]
    corners_m = np.array([entry_m, target_m])
    low_m = corners_m.min(axis=0) - crop_margin_m
    high_m = corners_m.max(axis=0) + crop_margin_m
    corners = np.array(list(product(*zip(low_m, high_m, strict=True))))
    indices = scan.grid.indices(corners)
    first = np.clip(np.floor(indices.min(axis=0)), 0, scan.grid.shape).astype(int)
    end = np.clip(np.ceil(indices.max(axis=0)) + 1, 0, scan.grid.shape).astype(int)
    part = scan.values[tuple(map(slice, first.tolist(), end.tolist()))]
    if not part.size:
        return None
    origin_m = scan.grid.points_m(first)
    return Volume(part.copy(), Grid(part.shape, origin_m, scan.grid.axes_m))


def _find_labels(plan: _PlanFile, folder: Path) -> Path | None:
    """Return the segmentation that a plan names, or the one beside it, if any."""
    if plan.labels:
        return folder / plan.labels
    beside = [*sorted(folder.glob("labels*.n*")), *sorted(folder.glob("*.seg.nrrd"))]
    return beside[0] if beside else None


def _checked_rotation(plan: _PlanFile) -> Array:
    """Return the rotation of a plan, shape (3, 3)."""
    rotation = np.array(plan.rotation or NO_ROTATION)
    is_orthonormal = np.allclose(
        rotation @ rotation.T, np.eye(3), atol=ROTATION_TOLERANCE
    )
    if not is_orthonormal or np.linalg.det(rotation) < 0.0:
        raise ValueError(
            f"rotation is {rotation.tolist()}: expected orthonormal rows, no mirror "
            "image"
        )
    return rotation


def large_structures(labels: Labels) -> list[str]:
    """Return the names of the structures that are large enough to be shown."""
    return [item.name for item in labels.structures if item.voxels >= MIN_VOXELS]


def _large_surfaces(
    labels: Labels, progress: Callable[[float], None]
) -> Sequence[object]:
    """Return the surfaces of the structures that are shown."""
    names = large_structures(labels)
    return tuple(labels.surfaces(names, progress, voxel_m=SHOWN_VOXEL_m).values())


def _planned_layers(plan: _PlanFile) -> list[Layer]:
    """Return the layers that stand in the file itself."""
    layers: list[Layer] = []
    entry_m = plan.start_m
    entry_std_m = 0.0
    for planned in plan.layers:
        if not planned.exit_m > entry_m:
            raise ValueError(
                f"{planned.name!r} ends at {planned.exit_m} m, not below where it "
                "begins"
            )
        layer = Layer(
            planned.name,
            entry_m,
            planned.exit_m,
            entry_std_m,
            planned.exit_std_m,
            planned.is_obstacle,
        )
        layers.append(layer)
        entry_m = planned.exit_m
        entry_std_m = planned.exit_std_m
    return layers
