"""A segmented torso, and a straight path into one of its organs."""

from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial.transform import Rotation

from foundation.arrays import Array
from groundtruth.torso import analytic_torso
from needleforce import anatomy
from needleforce.anatomy import (
    Grid,
    Labels,
    Layer,
    PlanError,
    Structure,
    Volume,
    VolumeError,
)
from needleforce.anatomy.path_layers import UNLABELLED
from needleforce.simulation.torso_case import draw_scan

FRONT = np.array([0.0, -1.0, 0.0])
"""Direction out of the front of the body, in the model."""


LENGTHS_m = (0.05, 0.1)
"""Least and largest length of the path [m]."""

ORGAN = "liver"
"""Structure in which the target lies where there is no lesion."""

CROSSABLE = ("lean", "fat", "muscle", "cavity", ORGAN, "lesion", UNLABELLED)
"""What a needle may cross to its target: neither lung nor bowel nor large vessel."""

CLEARANCE_m = 6e-3
"""So far beside the path nothing else may lie [m]."""

MIN_LAYER_m = 6.5e-3
"""Thinner layers are not simulated: they join the one before [m]."""


class ScannedTorso(NamedTuple):
    """CT and labels of the demonstration.

    Attributes:
        scan: The CT.
        labels: The segmentation.
        origin: Where they come from, in words.
    """

    scan: Volume
    labels: Labels
    origin: str

    @property
    def target(self) -> str:
        """Name of the structure in which the target lies: a lesion if there is one."""
        words = ("lesion", "tumor", "tumour")
        names = (structure.name for structure in self.labels.structures)
        lesions = (
            name for name in names if any(word in name.lower() for word in words)
        )
        return next(lesions, ORGAN)


class StraightPath(NamedTuple):
    """A straight path of the needle, in the model.

    Attributes:
        entry_m: Where it meets the skin, shape (3,) [m].
        target_m: Where it ends, shape (3,) [m].
        layers: What it crosses, without what is too thin to be simulated.
    """

    entry_m: Array
    target_m: Array
    layers: list[Layer]

    @property
    def length_m(self) -> float:
        """From entry to target [m]."""
        return float(np.linalg.norm(self.target_m - self.entry_m))

    @property
    def axis(self) -> Array:
        """Direction from entry to target, shape (3,)."""
        return (self.target_m - self.entry_m) / np.linalg.norm(
            self.target_m - self.entry_m
        )


def read_torso(folder: Path | None, rng: np.random.Generator) -> ScannedTorso:
    """Return a CT with labels from a folder, or a built-in analytic torso.

    Raises:
        VolumeError: The folder has no CT, or no labels beside it.
    """
    if folder is None:
        return _analytic_torso(rng)
    scans = [*sorted(folder.glob("ct.n*")), *sorted(folder.glob("*/ct.n*"))]
    beside = scans[0].parent if scans else folder
    files = [*sorted(beside.glob("labels*.n*")), *sorted(beside.glob("*.seg.nrrd"))]
    if not files or not scans:
        raise VolumeError(
            f"{folder}: expected ct.nii.gz (or .nrrd) and labels.nii.gz beside it, "
            "there or one folder down"
        )
    scan = anatomy.read_volume(scans[0])
    labels = anatomy.read_labels(files[0]).with_body(scan, fat=True)
    return ScannedTorso(scan, labels, f"{scans[0].name} of {folder}")


def _analytic_torso(rng: np.random.Generator) -> ScannedTorso:
    """Return CT and labels of an analytic torso drawn at random."""
    voxel_m = 2e-3  # Spacing of the analytic torso's scan [m]
    torso = analytic_torso(rng)
    skin = torso["fat"]
    half = np.ceil(skin.reach_m / voxel_m).astype(int) + 4  # voxels of air
    shape = tuple((2 * half + 1).tolist())
    corner_m = skin.centre_m - voxel_m * half
    grid = Grid(shape, corner_m, voxel_m * np.eye(3))
    structures = [
        Structure.named(body.name, number)
        for number, body in enumerate(torso.shapes, 1)
    ]
    voxels = torso.voxels(grid.shape, grid.origin_m, grid.axes_m)
    labels = Labels.of([voxels], grid, structures)
    noise = np.random.default_rng(int(rng.integers(2**32)))
    scan = Volume(draw_scan(torso, voxels, noise), grid)
    return ScannedTorso(scan, labels, "analytic torso, built in")


def inside_body(labels: Labels) -> NDArray[np.bool_]:
    """Return which voxels any structure covers."""
    return np.any([volume != 0 for volume in labels.volumes], axis=0)


def plan_path(labels: Labels, target: str, rng: np.random.Generator) -> StraightPath:
    """Return the path into a structure that crosses the most tissues.

    It is the best of straight paths of `LENGTHS_m` through what is `CROSSABLE`, also
    `CLEARANCE_m` beside them; of paths through as many tissues the shortest.

    Args:
        labels: The segmentation.
        target: Name of the structure in which it ends.
        rng: Draws targets and directions.

    Raises:
        PlanError: There is no such path from the front.
    """
    # Largest angle between the path and that direction, about two axes [deg]
    max_angle_deg = 35.0
    targets_m = _points_inside(labels, target)
    body = inside_body(labels)
    best_path: StraightPath | None = None
    best_rank = (0, np.inf)
    for _ in range(1000):
        target_m = targets_m[rng.integers(len(targets_m))]
        angles = np.radians(max_angle_deg) * rng.uniform(-1.0, 1.0, 2)
        axis = Rotation.from_euler("xz", angles).apply(FRONT)
        length_m = _distance_to_skin(labels.grid, body, target_m, axis)
        if length_m is None or not LENGTHS_m[0] < length_m < LENGTHS_m[1]:
            continue
        entry_m = target_m + length_m * axis
        layers = thick_layers(labels.layers_along(entry_m, target_m))
        path = StraightPath(entry_m, target_m, layers)
        rank = (-len(layers), length_m)
        ends_inside = len(layers) > 1 and layers[-1].name == target
        is_better = best_path is None or rank < best_rank
        if ends_inside and is_better and _is_clear(labels, path, target):
            best_path = path
            best_rank = rank
    if best_path is None:
        raise PlanError(
            f"no straight way from the front into {target!r} through soft tissue"
        )
    return best_path


def _points_inside(labels: Labels, organ: str) -> Array:
    """Return places well inside an organ, shape (n, 3) [m]; of a thin one any."""
    mask = labels.mask(organ)
    corner = [extent.start for extent in labels[organ].box]
    core = ndimage.binary_erosion(mask, iterations=3)
    indices = np.argwhere(core if core.any() else mask) + corner
    return labels.grid.points_m(indices)


def _is_clear(labels: Labels, path: StraightPath, target: str) -> bool:
    """Return whether a path, and those beside it, cross only what a needle may."""
    axis = path.axis
    side = np.cross(axis, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    angles = np.radians(np.arange(0.0, 360.0, 60.0))[:, None]
    around = np.cos(angles) * side + np.sin(angles) * np.cross(axis, side)
    return all(
        layer.name in (*CROSSABLE, target)
        for offset_m in (np.zeros(3), *(CLEARANCE_m * around))
        for layer in labels.layers_along(
            path.entry_m + offset_m, path.target_m + offset_m
        )
    )


def _distance_to_skin(
    grid: Grid, body: NDArray[np.bool_], start_m: Array, axis: Array
) -> float | None:
    """Return within 0.3 m how far away a ray leaves the body; None if it does not.

    Args:
        grid: Grid of the volume.
        body: Which voxels are inside the body.
        start_m: Start of the ray, inside, shape (3,) [m].
        axis: Its direction, shape (3,).
    """
    step_m = 0.5 * float(grid.spacing_m.min())
    distances_m = step_m * np.arange(1, int(0.3 / step_m))
    points_m = start_m + distances_m[:, None] * axis
    index = np.rint(grid.indices(points_m)).astype(int)
    is_valid: Any = ((index >= 0) & (index < grid.shape)).all(axis=1)
    is_body = is_valid & body[tuple(np.where(is_valid[:, None], index, 0).T)]
    outside = np.flatnonzero(~is_body)
    if not len(outside) or not is_valid[outside[0]]:
        return None
    return float(distances_m[outside[0]])


def thick_layers(layers: list[Layer]) -> list[Layer]:
    """Return layers without those thinner than `MIN_LAYER_m`, and without gaps."""
    thick: list[Layer] = []
    for layer in layers:
        is_thin = layer.exit_m - layer.entry_m < MIN_LAYER_m
        if thick and (is_thin or layer.name == thick[-1].name):
            thick[-1] = replace(
                thick[-1], exit_m=layer.exit_m, exit_std_m=layer.exit_std_m
            )
        elif not thick and not is_thin:
            thick.append(replace(layer, entry_m=0.0, entry_std_m=0.0))
        elif not is_thin:
            thick.append(layer)
    return thick
