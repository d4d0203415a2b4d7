"""Paths among thin ribs, slices of 1 to 10 mm: none through bone is reported clear.

Ribs as thin as a voxel wind around a chest in any orientation. A row of points on
a path, 0.2 mm apart, shows by brute force whether it runs through bone and how near it
comes to it.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.stats import special_ortho_group

from benchmarks.jobs import Job, Progress
from benchmarks.results import Figure
from foundation.arrays import Array
from needleforce.anatomy import FreeSpace, Grid, Labels, Structure, VoxelBoxes

SLICES_mm = (1.0, 2.0, 3.0, 5.0, 10.0)
PATHS = 1000
"""For each distance of the slices."""
SPACE = FreeSpace(needle_radius_m=0.8e-3, margin_m=2e-3, std_m=1e-3)
SAMPLING_m = 0.2e-3
"""Distance of points on a path; by so much distances measured with them err."""


def run(job: Job, progress: Progress) -> Iterator[Figure]:
    """Yield the numbers of every distance of slices."""
    for number, slices_mm in enumerate(SLICES_mm):
        rng = np.random.default_rng([job.seed, 21, number])
        labels = draw_chest(1e-3 * np.array([1.5, 1.5, slices_mm]), rng)
        name = f"slices {slices_mm:g} mm"
        yield from _judge_paths(labels, name, rng)
        progress((number + 1) / len(SLICES_mm))


def draw_chest(spacing_m: Array, rng: np.random.Generator) -> Labels:
    """Label thin ribs around a lung, on a grid that lies anyhow."""
    extent_m = np.full(3, 0.14)
    chest_m = 0.05  # radius on which the ribs lie
    pitch_m = 0.024  # from rib to rib
    shape = tuple(np.ceil(extent_m / spacing_m).astype(int).tolist())
    places = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1)
    places_m = places * spacing_m - 0.5 * extent_m + spacing_m * rng.uniform(size=3)
    radius_m = np.linalg.norm(places_m[..., :2], axis=-1)
    angle = np.arctan2(places_m[..., 1], places_m[..., 0])
    height_m = places_m[..., 2] - rng.uniform(-0.02, 0.02) * angle
    thickness_m = rng.uniform(1e-3, 4e-3)
    width_m = rng.uniform(3e-3, 9e-3)
    values = (radius_m < chest_m - thickness_m).astype(np.uint8)
    is_rib = np.abs(radius_m - chest_m) < 0.5 * thickness_m
    is_rib &= np.mod(height_m, pitch_m) < width_m
    values[is_rib] = 2
    rotation = special_ortho_group.rvs(3, random_state=rng)
    grid = Grid(shape, rng.normal(0.0, 0.1, 3), rotation * spacing_m)
    names = ("lung_left", "rib_left_8")
    structures = [Structure.named(name, k) for k, name in enumerate(names, 1)]
    return Labels.of([values], grid, structures)


def _judge_paths(
    labels: Labels, name: str, rng: np.random.Generator
) -> Iterator[Figure]:
    """Judge paths from outside the ribs to the middle of the chest."""
    boxes = VoxelBoxes(labels, labels["rib_left_8"])
    ribs = np.argwhere(labels.volumes[0] == labels["rib_left_8"].value)
    last = np.array(labels.grid.shape) - 1.0
    through = missed = free = near = wrong = 0
    for _ in range(PATHS):
        fractions = np.array([rng.uniform(size=3), rng.uniform(0.35, 0.65, 3)])
        entry_m, target_m = labels.grid.points_m(fractions * last)
        distance_m = sampled_distance_m(labels, ribs, entry_m, target_m)
        is_refused = boxes.nearest(entry_m, target_m, SPACE.needed_m) is not None
        if distance_m == 0.0:
            through += 1
            layers = labels.layers_along(entry_m, target_m)
            has_layer = any(layer.is_obstacle for layer in layers)
            missed += not (has_layer and is_refused)
        else:
            free += 1
            near += is_refused
            wrong += is_refused and distance_m > SPACE.needed_m + SAMPLING_m
    yield Figure("bone_paths", through, name)
    yield Figure("bone_paths_missed", missed, name)
    yield Figure("near_paths_refused_pct", 100.0 * near / free, name)
    yield Figure("clear_paths_refused_pct", 100.0 * wrong / free, name)


def sampled_distance_m(
    labels: Labels, ribs: NDArray[np.intp], entry_m: Array, target_m: Array
) -> float:
    """Return the distance of close points on a path from voxels that may be near it.

    Args:
        labels: The segmentation.
        ribs: Indices of the voxels, (n, 3).
        entry_m: First point of the path, (3,).
        target_m: Last point, (3,).
    """
    spacing_m = labels.grid.spacing_m
    length_m = float(np.linalg.norm(target_m - entry_m))
    count = int(length_m / SAMPLING_m) + 2
    fractions = np.linspace(0.0, 1.0, count)[:, None]
    path = labels.grid.indices(entry_m + fractions * (target_m - entry_m)) * spacing_m
    centres_m = ribs * spacing_m
    axis = (path[-1] - path[0]) / length_m
    along_m = np.clip((centres_m - path[0]) @ axis, 0.0, length_m)
    across_m = np.linalg.norm(centres_m - path[0] - along_m[:, None] * axis, axis=1)
    reach_m = 2.0 * SPACE.needed_m + np.linalg.norm(spacing_m)
    near_m = centres_m[across_m < reach_m]
    if not len(near_m):
        return np.inf
    gaps_m = np.abs(path[:, None] - near_m) - 0.5 * spacing_m
    return float(np.linalg.norm(np.maximum(gaps_m, 0.0), axis=-1).min())
