"""The plan of an insertion from a file, for a session and the scene.

    plan = read_plan("plan")
    plan.follow_with(session)

The file is `plan.json`, see docs/how-to/scene.md; a segmentation may lie beside it.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

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
from needleforce.scene import PlanScene

if TYPE_CHECKING:
    from needleforce.session import InsertionSession

PLAN = "plan.json"

PLAN_VERSION = 3
"""Of the file that `needleforce plan` writes."""

GIVE_PLAN = "Give plan.json, or the folder that holds it beside labels.nii.gz."

Point = Annotated[tuple[float, ...], msgspec.Meta(min_length=3, max_length=3)]
"""Three numbers."""

Sextuple = Annotated[tuple[float, ...], msgspec.Meta(min_length=6, max_length=6)]
"""Six numbers."""


class PlanFileError(NeedleforceError, ValueError):
    """A plan's file that cannot be read, or whose plan cannot be followed."""

    usual_advice = GIVE_PLAN


class LoadedPlan(NamedTuple):
    """A plan as a session and the scene take it.

    Attributes:
        scene: Anatomy and plan for the viewer.
        match: The layers with which ruptures are matched.
        warnings: What is wrong with the plan, or could not be checked.
        path: The planned path in the robot's base; None without entry and target, where
            depths count as the session's.
        surroundings: The structures at risk around it; None where there are no labels.
    """

    scene: PlanScene
    match: PlanMatch
    warnings: tuple[str, ...] = ()
    path: PlannedPath | None = None
    surroundings: NeedleSurroundings | None = None

    def follow_with(self, session: "InsertionSession") -> None:
        """Let a session follow the plan."""
        session.follow(self.match, path=self.path, surroundings=self.surroundings)


class MadeOf(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What a plan was made of.

    Attributes:
        sha256: Of CT, labels and path, see `hash_sources`.
        avoided: Names of the structures that had to stay clear.
    """

    sha256: str
    avoided: tuple[str, ...]


def hash_sources(
    scan: Volume,
    labels: Labels,
    ends_m: Array,
    layers: Sequence[Layer],
    space: FreeSpace,
) -> str:
    """Return a SHA-256 of what a plan is made of: any change to it shows.

    Args:
        scan: The CT.
        labels: The segmentation, as in its file.
        ends_m: Entry and target in LPS, (2, 3).
        layers: What the path crosses.
        space: What must stay free around the needle.
    """
    digest = sha256()
    for grid, volumes in ((scan.grid, [scan.values]), (labels.grid, labels.volumes)):
        for values in (grid.shape, grid.origin_m, grid.axes_m, *volumes):
            digest.update(np.ascontiguousarray(values).tobytes())
    path = [
        [(item.name, item.value, item.volume) for item in labels.structures],
        [(layer.name, float(layer.exit_m)) for layer in layers],
        np.asarray(ends_m).tolist(),
        [float(space.needle_radius_m), float(space.margin_m)],
    ]
    digest.update(json.dumps(path).encode())
    return digest.hexdigest()


class _RegisteredPlace(msgspec.Struct):
    """Where registration has put the path.

    Attributes:
        entry_in_base_m: The entry in the robot's base.
        target_in_base_m: The target in the robot's base.
        entry_error_rms_m: Error to be expected at the entry.
        target_error_rms_m: At the target.
    """

    entry_in_base_m: Point
    target_in_base_m: Point
    entry_error_rms_m: float
    target_error_rms_m: float


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
    registration: _RegisteredPlace | None = None
    made_of: MadeOf | None = None
    rotation: tuple[Point, Point, Point] = ((1, 0, 0), (0, 1, 0), (0, 0, 1))
    translation_m: Point = (0.0, 0.0, 0.0)
    entry_m: Point | None = None
    target_m: Point | None = None
    offset_std_m: float = 3e-3
    covariance: tuple[Sextuple, ...] = ()
    pivot_m: Point = (0.0, 0.0, 0.0)
    start_m: float = 0.0
    layers: tuple[_PlannedLayer, ...] = ()
    needle_radius_m: float = NEEDLE_RADIUS_m
    margin_m: float = MARGIN_m
    accepted_obstacles: tuple[str, ...] = ()
    situs_inversus: bool = False


def read_plan(
    place: str | Path,
    *,
    is_past: bool = False,
    progress: Callable[[float], None] = lambda fraction: None,
) -> LoadedPlan:
    """Return a plan from its file, or from a folder with `plan.json`.

    Args:
        place: The file or folder.
        is_past: The insertion is over: obstacles on its path are a warning.
        progress: Takes the fraction of the surfaces that is made.

    Raises:
        PlanFileError: The file cannot be read, or holds no plan that can be followed.
    """
    path = Path(place)
    if path.is_dir():
        path /= PLAN
    try:
        plan = msgspec.json.decode(path.read_bytes(), type=_PlanFile)
        return _load_plan(plan, path.parent, is_past=is_past, progress=progress)
    except (OSError, ValueError, msgspec.MsgspecError, AnatomyError) as error:
        raise PlanFileError(f"{path}: {error}") from error


def _load_plan(
    plan: _PlanFile,
    folder: Path,
    *,
    is_past: bool,
    progress: Callable[[float], None],
) -> LoadedPlan:
    """Return the plan of a file in a folder; see `read_plan`."""
    ends_m = _checked_ends(plan)
    registration = _checked_registration(plan)
    if plan.version:
        _require_registered(plan, registration, ends_m)
    layers = _planned_layers(plan)
    space = FreeSpace(plan.needle_radius_m, plan.margin_m, plan.offset_std_m)
    labels = scan = path = surroundings = None
    warnings: list[str] = []
    if ends_m is None:
        warnings.append(
            "no entry and target in the plan: not checked whether the needle is on it"
        )
    else:
        if plan.covariance:
            std_m = registration.largest_std_m(ends_m)
            space = FreeSpace(plan.needle_radius_m, plan.margin_m, std_m)
        labels, scan = _read_anatomy(plan, folder, ends_m, layers, space)
        if scan is not None and plan.made_of is None:
            warnings.append("the plan does not say what it was made of: not checked")
        path = _path_of(plan, registration, ends_m)
    if labels is not None and ends_m is not None:
        layers = layers or labels.layers_along(*ends_m)
        leave_out = (plan.target, *plan.accepted_obstacles)
        surroundings = NeedleSurroundings(
            labels, registration, ends_m[0], ends_m[1], space, leave_out=leave_out
        )
        warnings += _check_obstacles(plan, labels, ends_m, space, is_past=is_past)
    else:
        warnings.append("no labels beside the plan: clearance of obstacles not checked")
        obstacles = [layer.name for layer in layers if layer.is_obstacle]
        warnings += [f"the path runs through {name}" for name in obstacles]
    if not layers:
        raise ValueError(
            "neither layers in it, nor entry_m and target_m with labels.nii.gz, .nrrd "
            "or a .seg.nrrd beside it"
        )
    accepted = [layer.name for layer in layers] if is_past else plan.accepted_obstacles
    match = PlanMatch(layers, plan.offset_std_m, accepted_obstacles=accepted)
    scene = PlanScene(
        surfaces=() if labels is None else _large_surfaces(labels, progress),
        layers=match.layers,
        entry_m=None if ends_m is None else ends_m[0],
        target_m=None if ends_m is None else ends_m[1],
        rotation=registration.rotation,
        translation_m=registration.translation_m,
        scan=None if scan is None or ends_m is None else crop_scan(scan, *ends_m),
        warnings=tuple(warnings),
        watched=() if surroundings is None else surroundings.names,
    )
    return LoadedPlan(scene, match, tuple(warnings), path, surroundings)


def _checked_ends(plan: _PlanFile) -> Array | None:
    """Return entry and target, (2, 3); None without them."""
    max_coordinate_m = 10.0  # A larger coordinate is not in metres [m]
    points_m = [*filter(None, (plan.translation_m, plan.entry_m, plan.target_m))]
    if np.abs(points_m).max() >= max_coordinate_m:
        raise ValueError(
            f"a place beyond {max_coordinate_m:g} m in it: expected metres, not "
            "millimetres"
        )
    if plan.entry_m is None and plan.target_m is None:
        return None
    if plan.entry_m is None or plan.target_m is None or plan.entry_m == plan.target_m:
        raise ValueError(
            f"entry_m is {plan.entry_m}, target_m {plan.target_m} in it: expected two "
            "places that are not the same, or neither"
        )
    return np.array([plan.entry_m, plan.target_m])


def _checked_registration(plan: _PlanFile) -> Registration:
    """Return where the patient lies in the robot's base."""
    rotation_tolerance = 1e-3  # by so much rows may miss being orthonormal
    max_rounding = 1e-12  # so negative a variance may be: it is written in decimals
    rotation = np.array(plan.rotation)
    covariance = np.array(plan.covariance)
    product_rows = rotation @ rotation.T
    is_orthonormal = np.allclose(product_rows, np.eye(3), atol=rotation_tolerance)
    if not is_orthonormal or np.linalg.det(rotation) < 0.0:
        raise ValueError(
            f"rotation is {rotation.tolist()}: expected orthonormal rows, no mirror "
            "image"
        )
    if plan.covariance and not (
        np.array_equal(covariance.shape, (6, 6))
        and np.allclose(covariance, covariance.T)
        and np.linalg.eigvalsh(covariance)[0] >= -max_rounding
    ):
        raise ValueError("covariance in it is not 6 x 6, symmetric and positive")
    return Registration(
        rotation=rotation,
        translation_m=np.array(plan.translation_m),
        covariance=covariance,
        pivot_m=np.array(plan.pivot_m),
        degrees=np.inf,
        residual_rms_m=np.nan,
    )


def _require_registered(
    plan: _PlanFile, registration: Registration, ends_m: Array | None
) -> None:
    """Refuse a plan of `needleforce plan` that is not registered as it stands."""
    if plan.version != PLAN_VERSION or plan.made_of is None:
        raise ValueError(
            f"it has version {plan.version}, or does not say what it was made of: "
            f"expected version {PLAN_VERSION}, as `needleforce plan` writes it"
        )
    place = plan.registration
    is_named = plan.ct and plan.labels
    if ends_m is None or place is None or not is_named or not plan.covariance:
        raise ValueError(
            "it does not say where the patient lies in the robot's base, or names no "
            "CT and labels: expected the plan that `needleforce register --plan` writes"
        )
    places_m = (place.entry_in_base_m, place.target_in_base_m)
    errors_m = (place.entry_error_rms_m, place.target_error_rms_m)
    is_there = np.allclose(registration.to_robot(ends_m), places_m, atol=1e-4)
    stated_m = [registration.tre_m(point_m) for point_m in ends_m]
    if not is_there or not np.allclose(stated_m, errors_m, rtol=0.01):
        raise ValueError(
            "its entry or target was registered elsewhere, or with another error: path "
            "or registration were changed; register again with `needleforce register`"
        )


def _path_of(plan: _PlanFile, registration: Registration, ends_m: Array) -> PlannedPath:
    """Return the planned path in the robot's base."""
    if plan.covariance:
        path = PlannedPath.of_registration(registration, *ends_m)
    else:
        entry_m, target_m = registration.to_robot(ends_m)
        path = PlannedPath.of_std(entry_m, target_m, plan.offset_std_m)
    return replace(path, tolerance_m=plan.margin_m)


def _check_obstacles(
    plan: _PlanFile, labels: Labels, ends_m: Array, space: FreeSpace, *, is_past: bool
) -> list[str]:
    """Return warnings of what the path comes near to; refuse obstacles.

    Args:
        plan: The plan.
        labels: The segmentation.
        ends_m: Entry and target of the path.
        space: What must stay free around the needle.
        is_past: The insertion is over: obstacles are a warning, too.

    Raises:
        PlanError: The path comes too near to an obstacle.
    """
    clearances = labels.clearances(*ends_m)
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
    return [*warnings, *filter(None, (labels.unchecked,))]


def _read_anatomy(
    plan: _PlanFile,
    folder: Path,
    ends_m: Array,
    layers: Sequence[Layer],
    space: FreeSpace,
) -> tuple[Labels | None, Volume | None]:
    """Return labels and CT beside a plan, if there are any.

    Args:
        plan: The plan.
        folder: Where it lies.
        ends_m: Its entry and target.
        layers: Those that it states.
        space: What must stay free around the needle.

    Raises:
        ValueError: They are not those that the plan was made of.
    """
    beside = [*sorted(folder.glob("labels*.n*")), *sorted(folder.glob("*.seg.nrrd"))]
    files = [folder / plan.labels] if plan.labels else beside
    scans = [folder / plan.ct] if plan.ct else sorted(folder.glob("ct.n*"))
    if not files:
        return None, None
    names = plan.structures or None
    if isinstance(names, str):
        names = folder / names
    labels = read_labels(files[0], names, situs_inversus=plan.situs_inversus)
    if not scans:
        return labels, None
    scan = read_volume(scans[0])
    if plan.made_of is not None and plan.made_of.sha256 != hash_sources(
        scan, labels, ends_m, layers, space
    ):
        raise ValueError(
            "CT, labels, path, layers or needle are not those that it was made of: "
            "plan again with `needleforce plan`, and register"
        )
    return labels.checked_against(scan).with_dense(scan), scan


def crop_scan(scan: Volume, entry_m: Array, target_m: Array) -> Volume | None:
    """Return the part of a CT around a path; None where the CT does not reach it."""
    crop_margin_m = 0.1  # The scene keeps the CT up to here from the path [m]
    margin = crop_margin_m / scan.grid.spacing_m
    ends = scan.grid.indices([entry_m, target_m])
    first = np.clip(np.floor(ends.min(axis=0) - margin), 0, scan.grid.shape).astype(int)
    stop = np.ceil(ends.max(axis=0) + margin) + 1
    end = np.clip(stop, 0, scan.grid.shape).astype(int)
    part = scan.values[tuple(map(slice, first.tolist(), end.tolist()))]
    if not part.size:
        return None
    origin_m = scan.grid.points_m(first)
    return Volume(part.copy(), Grid(part.shape, origin_m, scan.grid.axes_m))


def large_structures(labels: Labels) -> list[str]:
    """Return the names of the structures that are large enough to be shown."""
    min_voxels = 500
    return [item.name for item in labels.structures if item.voxels >= min_voxels]


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
