"""A segmented torso, and a straight way into an organ of it."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial.transform import Rotation

from groundtruth.torso import analytic_torso
from needleforce import anatomy
from needleforce.anatomy import (
    Grid,
    Labels,
    Layer,
    Structure,
)
from needleforce.anatomy.path_layers import UNLABELLED
from needleforce.cli.terminal import CommandError

Array = NDArray[np.float64]


VOXEL_m = 2e-3  # Of the analytic torso's scan


FRONT = np.array([0.0, -1.0, 0.0])


STEEPEST_deg = 35.0


DRAWS = 1000


LENGTHS_m = (0.05, 0.1)


CROSSABLE = ("lean", "fat", "muscle", "cavity", "lesion", UNLABELLED)
"""What a needle may cross on its way into an organ: neither lung nor bowel nor large
vessel."""


CLEARANCE_m = 6e-3


LEAST_LAYER_m = (
    6.5e-3  # Thinner layers are no tissue of the simulation's: they join the one before
)


def read_torso(folder: Path | None, rng: np.random.Generator) -> Labels:
    """A CT with labels from a folder, or a built-in analytic torso."""
    if folder is None:
        torso = analytic_torso(rng)
        skin = torso["fat"]
        half = np.ceil(skin.reach_m / VOXEL_m).astype(int) + 4
        shape = tuple((2 * half + 1).tolist())
        corner_m = skin.centre_m - VOXEL_m * half
        grid = Grid(shape, corner_m, VOXEL_m * np.eye(3))
        structures = [
            Structure.named(body.name, n) for n, body in enumerate(torso.shapes, 1)
        ]
        return Labels.of(
            [torso.voxels(grid.shape, grid.origin_m, grid.axes_m)], grid, structures
        )
    scans = [*sorted(folder.glob("ct.n*")), *sorted(folder.glob("*/ct.n*"))]
    beside = scans[0].parent if scans else folder
    files = [*sorted(beside.glob("labels*.n*")), *sorted(beside.glob("*.seg.nrrd"))]
    if not files or not scans:
        what = "expected ct.nii.gz (or .nrrd) and labels.nii.gz beside it, there or one folder down"
        raise CommandError(f"{folder}: {what}")
    return anatomy.read_labels(files[0]).with_body(
        anatomy.read_volume(scans[0]), fat=True
    )


def inside_body(labels: Labels) -> NDArray[np.bool_]:
    """Which voxels any structure covers."""
    return np.any([volume != 0 for volume in labels.volumes], axis=0)


def plan_path(
    labels: Labels, organ: str, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Entry on the skin and a target inside an organ: the way through the most tissues.

    Of straight ways through what is `CROSSABLE`, also so far aside as `CLEARANCE_m`,
    and of `LENGTHS_m`; of as many tissues the shortest. `CommandError` if there is none
    from the front.
    """
    organ_mask = labels.mask(organ)
    corner = [part.start for part in labels[organ].box]
    core = ndimage.binary_erosion(organ_mask, iterations=3)
    places = labels.grid.points_m(
        np.argwhere(core if core.any() else organ_mask) + corner
    )
    body = inside_body(labels)
    best: tuple[tuple[int, float], Array, Array] | None = None
    for _ in range(DRAWS):
        target = places[rng.integers(len(places))]
        turn = np.radians(STEEPEST_deg) * rng.uniform(-1.0, 1.0, 2)
        axis = Rotation.from_euler("xz", turn).apply(FRONT)
        found = _skin_along(labels.grid, body, target, axis)
        if found is None or not LENGTHS_m[0] < found < LENGTHS_m[1]:
            continue
        entry = target + found * axis
        layers = thick_layers(labels.layers_along(entry, target))
        rank = -len(layers), found
        ends_inside = len(layers) > 1 and layers[-1].name == organ
        is_better = best is None or rank < best[0]
        if ends_inside and is_better and _is_clear(labels, entry, target, organ):
            best = rank, entry, target
    if best is None:
        raise CommandError(
            f"no straight way from the front into {organ!r} through soft tissue"
        )
    return best[1], best[2]


def _is_clear(labels: Labels, entry: Array, target: Array, organ: str) -> bool:
    """Whether a way, and those beside it, cross only what a needle may."""
    axis = (target - entry) / np.linalg.norm(target - entry)
    side = np.cross(axis, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    turns = np.radians(np.arange(0.0, 360.0, 60.0))[:, None]
    around = np.cos(turns) * side + np.sin(turns) * np.cross(axis, side)
    return all(
        layer.name in (*CROSSABLE, organ)
        for aside in (np.zeros(3), *(CLEARANCE_m * around))
        for layer in labels.layers_along(entry + aside, target + aside)
    )


def _skin_along(
    grid: Grid, body: NDArray[np.bool_], start: Array, axis: Array
) -> float | None:
    """Distance at which a ray from inside leaves the body; None where the volume
    ends first.
    """
    step = 0.5 * float(grid.spacing_m.min())
    distance = step * np.arange(1, int(0.3 / step))
    index = np.rint(grid.indices(start + distance[:, None] * axis)).astype(int)
    valid: Any = ((index >= 0) & (index < grid.shape)).all(axis=1)
    is_body = valid & body[tuple(np.where(valid[:, None], index, 0).T)]
    outside = np.flatnonzero(~is_body)
    return float(distance[outside[0]]) if len(outside) and valid[outside[0]] else None


def thick_layers(layers: list[Layer]) -> list[Layer]:
    """The same without layers thinner than `LEAST_LAYER_m`, and without gaps."""
    found: list[Layer] = []
    for layer in layers:
        is_thin = layer.exit_m - layer.entry_m < LEAST_LAYER_m
        if found and (is_thin or layer.name == found[-1].name):
            found[-1] = replace(
                found[-1], exit_m=layer.exit_m, exit_std_m=layer.exit_std_m
            )
        elif not is_thin:
            start = {"entry_m": 0.0, "entry_std_m": 0.0} if not found else {}
            found.append(replace(layer, **start))
    return found
