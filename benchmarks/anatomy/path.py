"""Layers along 1,000 paths through analytic torsos, against the exact crossings."""

from collections.abc import Iterator, Sequence
from itertools import groupby, pairwise
from time import perf_counter
from typing import NamedTuple, SupportsFloat

import numpy as np
from numpy.typing import NDArray

from benchmarks.jobs import Figure, Job, make_figures
from groundtruth.torso import Stretch, Torso, analytic_torso
from needleforce.anatomy import Grid, Labels, Layer, Structure
from needleforce.anatomy.path_layers import UNLABELLED

SPACINGS_MM = {
    "3 mm": (3.0, 3.0, 3.0),
    "1 mm": (1.0, 1.0, 1.0),
    "0.98 x 0.98 x 2 mm": (0.98, 0.98, 2.0),
}
TORSOS = 5
PATHS = 200
HALF_M = np.array([0.20, 0.145, 0.19])
"""Half the edges of the scan around the torso."""
THICK_VOXELS = 1.5
"""Layers thinner than this may be missed."""


class Measured(NamedTuple):
    """One path.

    Attributes:
        errors_voxels: Of the depth of every crossing found.
        scores: Errors over the stated standard deviation.
        is_right: Whether the sequence of layers that are thick enough is.
        has_gaps: Whether layers leave gaps or overlap.
        crossings: How many true ones there are.
        seconds: Time it took.
    """

    errors_voxels: list[float]
    scores: list[float]
    is_right: bool
    has_gaps: bool
    crossings: int
    seconds: float


def run(job: Job) -> Iterator[Figure]:
    """Yield the numbers of every spacing."""
    for number, (name, spacing_mm) in enumerate(SPACINGS_MM.items()):
        paths: list[Measured] = []
        for turn in range(TORSOS):
            rng = np.random.default_rng([job.seed, number, turn])
            torso = analytic_torso(rng)
            labels = scan_of(torso, spacing_mm, rng)
            labels.layers_along(*random_path(torso, rng))  # the first call imports
            paths += [
                measure_path(torso, labels, *random_path(torso, rng))
                for _ in range(PATHS)
            ]
        yield from make_figures(path_metrics(paths), name)


def path_metrics(paths: Sequence[Measured]) -> dict[str, SupportsFloat]:
    """Return the numbers of many paths by name."""
    errors = np.array([error for path in paths for error in path.errors_voxels])
    scores = np.abs([score for path in paths for score in path.scores])
    crossings = sum(path.crossings for path in paths)
    return {
        "path_depth_error_rms_voxel": np.sqrt(np.mean(errors**2)),
        "path_sequence_right_pct": 100.0 * np.mean([path.is_right for path in paths]),
        "paths_with_gaps": sum(path.has_gaps for path in paths),
        "path_time_median_ms": 1e3 * np.median([path.seconds for path in paths]),
        # Half the width of the 95 % interval of a normal deviate is 1.96.
        "path_within_95_interval_pct": 100.0 * np.mean(scores < 1.96),
        "path_within_one_sigma_pct": 100.0 * np.mean(scores < 1.0),
        "path_crossings_found_pct": 100.0 * len(errors) / crossings,
    }


def scan_of(
    torso: Torso, spacing_mm: Sequence[float], rng: np.random.Generator
) -> Labels:
    """Label the torso on a grid that begins anywhere in a voxel."""
    spacing = 1e-3 * np.array(spacing_mm)
    shape = tuple(int(n) for n in np.ceil(2.0 * HALF_M / spacing))
    grid = Grid(shape, -HALF_M + rng.uniform(size=3) * spacing, np.diag(spacing))
    structures = [
        Structure.named(body.name, n) for n, body in enumerate(torso.shapes, 1)
    ]
    return Labels.of(
        [torso.voxels(shape, grid.origin_m, grid.axes_m)], grid, structures
    )


def random_path(
    torso: Torso, rng: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return an entry in air, in front or on the right, and a target in the liver."""
    liver = torso["liver"]
    ball = rng.normal(size=3)
    ball *= 0.8 * np.cbrt(rng.uniform()) / np.linalg.norm(ball)
    target = liver.centre_m + liver.axes @ (ball * liver.radii_m)
    turn = rng.uniform(-2.6, -0.8)
    away = np.array([np.cos(turn), np.sin(turn), rng.uniform(-0.5, 0.5)])
    return target + rng.uniform(0.12, 0.2) * away / np.linalg.norm(away), target


def measure_path(
    torso: Torso, labels: Labels, entry_m: NDArray, target_m: NDArray
) -> Measured:
    """Compare one path with the truth.

    Every crossing counts that was found between the same two layers.
    """
    begin = perf_counter()
    layers = labels.layers_along(entry_m, target_m)
    seconds = perf_counter() - begin
    truth = [
        item._replace(name=item.name or UNLABELLED)
        for item in torso.crossings(entry_m, target_m)
    ]
    voxel_m = float(np.cbrt(labels.grid.voxel_m3))
    errors = []
    scores = []
    for error_m, std_m in matched(truth, layers):
        errors.append(error_m / voxel_m)
        scores.append(error_m / std_m)
    ends = [layers[0].entry_m, *(layer.exit_m for layer in layers)]
    begins = [
        *(layer.entry_m for layer in layers),
        float(np.linalg.norm(target_m - entry_m)),
    ]
    gaps = not np.allclose(ends, begins, rtol=0.0, atol=1e-12) or bool(
        np.any(np.diff(ends) < 0.0)
    )
    return Measured(
        errors_voxels=errors,
        scores=scores,
        is_right=in_order(truth, layers, THICK_VOXELS * voxel_m),
        has_gaps=gaps,
        crossings=len(truth) - 1,
        seconds=seconds,
    )


def in_order(truth: Sequence[Stretch], layers: Sequence[Layer], thick_m: float) -> bool:
    """Return whether thick layers all appear in order, in the truth and as found.

    Where a thin layer may be missed, what lies on both of its sides counts once.
    """

    def appear(few: list[str], many: list[str]) -> bool:
        """Return whether the names appear in this order."""
        remaining = iter(many)
        return all(name in remaining for name in few)

    def names(items: Sequence[Stretch] | Sequence[Layer], least_m: float) -> list[str]:
        thick = (item.name for item in items if item.exit_m - item.entry_m > least_m)
        return [name for name, _ in groupby(thick)]

    return appear(names(truth, thick_m), names(layers, 0.0)) and appear(
        names(layers, thick_m), names(truth, 0.0)
    )


def matched(
    truth: Sequence[Stretch], layers: Sequence[Layer]
) -> Iterator[tuple[float, float]]:
    """Yield error and stated deviation [m] of crossings between the same two layers.

    Of several such crossings the nearest counts.
    """
    for previous, after in pairwise(truth):
        same = [
            (follower.entry_m - after.entry_m, follower.entry_std_m)
            for leader, follower in pairwise(layers)
            if (leader.name, follower.name) == (previous.name, after.name)
        ]
        if same:
            yield min(same, key=lambda pair: abs(pair[0]))
