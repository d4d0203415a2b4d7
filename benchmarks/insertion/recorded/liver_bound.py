"""How well friction in real liver can be known before the needle is pulled out.

What is predicted is the pull-out force, which `liver-real` compares friction with.
Every prediction is fitted to the other recordings only.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.insertion.methods import IDENTIFIERS
from benchmarks.insertion.recorded.liver import (
    NUMBERS,
    force_drops,
    mean_at_depth,
    read_liver,
)
from benchmarks.jobs import Job, Progress
from benchmarks.results import Figure
from foundation.arrays import Array
from identification import replay

COMPARED_mm = {
    "42, 78 mm": np.array([42, 78]),
    "42, 60 mm": np.array([42, 60]),
    "10 to 70 mm": np.arange(10, 71),
}
"""Depths at which predictions are compared: as in `liver-real`, and two others."""
GRID_mm = np.arange(84)
"""Depths at which forces are known; the needle turns round at 85 mm."""


def run(job: Job, progress: Progress) -> Iterator[Figure]:
    """Run ``liver-bound``: how well the pull-out force can be predicted, from what.

    The source of a figure says where, and from what: the mean of the other recordings
    at that depth; a line in the force, in our friction, or in both; mean and friction
    by their deviations; the pull-out force itself, but elsewhere.
    """
    force_N, pullout_N, friction_N, std_N = read_curves(job.recordings, progress)
    known = (force_N, friction_N, std_N, pullout_N)
    for name, depths_mm in COMPARED_mm.items():
        predictions = predict_at_depths(*known, depths_mm)
        yield from compare(predictions, pullout_N[:, depths_mm], name)
    yield from predict_at_drops(job.recordings)
    yield from describe_reference(force_N, pullout_N)
    for mm in (20, 42, 60, 78):
        error_N = np.mean(friction_N[:, mm] - pullout_N[:, mm])
        yield Figure("pullout_error_mean_N", error_N, f"{mm} mm: our friction")


def read_curves(data: Path, progress: Progress) -> tuple[Array, Array, Array, Array]:
    """Return force, pull-out force, our friction, its deviation; (recordings, depths).

    They are means over a millimetre around each of `GRID_mm`.
    """
    curves = np.full((4, len(NUMBERS), GRID_mm.size), np.nan)
    for index in range(len(NUMBERS)):
        progress(index / len(NUMBERS))
        whole = read_liver(data, index)
        inside = whole.insertion
        depth_m = whole.depth_m[inside]
        force_N = whole.force_N[inside]
        course = whole.t_s[inside], depth_m, force_N
        estimates = replay(*course, config=IDENTIFIERS["ours"]).estimates
        friction_N = np.array([row.shaft_friction_N for row in estimates], dtype=float)
        std_N = np.array([row.shaft_friction_std_N for row in estimates], dtype=float)
        pulled_m = whole.depth_m[whole.withdrawal]
        pullout_N = -whole.force_N[whole.withdrawal]
        for mm in GRID_mm.tolist():
            curves[:, index, mm] = (
                mean_at_depth(depth_m, force_N, 1e-3 * mm),
                mean_at_depth(pulled_m, pullout_N, 1e-3 * mm),
                mean_at_depth(depth_m, friction_N, 1e-3 * mm),
                mean_at_depth(depth_m, std_N, 1e-3 * mm),
            )
    force_N, pullout_N, friction_N, std_N = curves
    return force_N, pullout_N, friction_N, std_N


def predict_at_depths(
    force_N: Array,
    friction_N: Array,
    std_N: Array,
    pullout_N: Array,
    depths_mm: NDArray[np.intp],
) -> dict[str, Array]:
    """Return predictions of the pull-out force by what is known, (recordings, depths).

    Args:
        force_N: Of the insertion, at `GRID_mm`, as all others.
        friction_N: What we estimate during the insertion.
        std_N: Its standard deviation.
        pullout_N: What is predicted.
        depths_mm: Where.
    """
    at = depths_mm
    truth_N = pullout_N[:, at]
    others_N = [np.delete(truth_N, row, axis=0) for row in range(len(truth_N))]
    mean_N = np.array([others.mean(axis=0) for others in others_N])
    spread_N = np.array([others.std(axis=0, ddof=1) for others in others_N])
    ours_weight = spread_N**2 / (spread_N**2 + std_N[:, at] ** 2)
    predictions = {
        "force times 0.7": 0.7 * force_N[:, at],
        "our friction": friction_N[:, at],
        "mean of the others": mean_N,
        "mean of the others and our friction": mean_N
        + ours_weight * (friction_N[:, at] - mean_N),
        "line in the force": predict_by_line(truth_N, force_N[:, at]),
        "line in our friction": predict_by_line(truth_N, friction_N[:, at]),
        "line in force and our friction": predict_by_line(
            truth_N, force_N[:, at], friction_N[:, at]
        ),
        "line in the pull-out force 10 mm nearer": predict_by_line(
            truth_N, pullout_N[:, at - 10]
        ),
    }
    if at.size == 2:
        elsewhere_N = truth_N[:, ::-1]
        name = "line in the pull-out force at the other depth"
        predictions[name] = predict_by_line(truth_N, elsewhere_N)
    return predictions


def predict_by_line(truth_N: Array, *known: Array) -> Array:
    """Return the best line in what is known, fitted without the row that it predicts.

    It is another line in each column; squares of relative errors are least.

    Args:
        truth_N: What is predicted, shape (recordings, depths).
        known: From what, each of that shape.
    """
    predicted_N = np.empty_like(truth_N)
    for row, column in np.ndindex(truth_N.shape):
        is_other = np.arange(len(truth_N)) != row
        predicted_N[row, column] = predict_left_out(
            truth_N[:, column], [values[:, column] for values in known], is_other
        )[row]
    return predicted_N


def predict_left_out(
    truth_N: Array, known: list[Array], is_other: NDArray[np.bool_]
) -> Array:
    """Return a line in what is known, fitted to the others alone; all shape (n,)."""
    columns = np.column_stack([np.ones(truth_N.size), *known])
    relative = columns / truth_N[:, None]
    ones = np.ones(int(is_other.sum()))
    return columns @ np.linalg.lstsq(relative[is_other], ones, rcond=None)[0]


def predict_at_drops(data: Path) -> Iterator[Figure]:
    """Yield what the drops of the force say of the pull-out force at their feet.

    Those in the first 12 mm, and within 3 mm of where the needle turns, are left out.
    """
    rows: list[tuple[float, ...]] = []
    for index in range(len(NUMBERS)):
        whole = read_liver(data, index)
        depth_m = whole.depth_m[whole.insertion]
        force_N = whole.force_N[whole.insertion]
        for drop in force_drops(depth_m, force_N):
            if not 12e-3 < drop.to_m < 82e-3:
                continue
            foot_N = mean_at_depth(depth_m, force_N, drop.to_m)
            pullout_N = -whole.force_at_N(whole.withdrawal, 1e3 * drop.to_m)
            row = (index, drop.to_m, foot_N, foot_N + drop.drop_N, pullout_N)
            rows.append(row)
    number, depth, foot_N, top_N, truth_N = np.array(rows).T
    known = {
        "depth": [depth],
        "depth and force at the foot": [depth, foot_N],
        "depth and force at the top": [depth, top_N],
        "depth, force at top and foot": [depth, top_N, foot_N],
    }
    predictions = {}
    for name, columns in known.items():
        predicted_N = np.empty_like(truth_N)
        for index in set(number.tolist()):
            own = number == index
            predicted_N[own] = predict_left_out(truth_N, columns, ~own)[own]
        predictions[name] = predicted_N
    yield from compare(predictions, truth_N, "feet of drops")
    ratio = truth_N / foot_N
    yield Figure("pullout_per_foot", np.median(ratio), "median")
    yield Figure("pullout_per_foot", np.percentile(ratio, 10.0), "10th percentile")
    yield Figure("pullout_per_foot", np.percentile(ratio, 90.0), "90th percentile")


def compare(
    predictions: Mapping[str, Array], truth_N: Array, where: str
) -> Iterator[Figure]:
    """Yield the errors of predictions of the pull-out force."""
    for known, predicted_N in predictions.items():
        source = f"{where}: {known}"
        error_pct = 100.0 * np.abs(predicted_N - truth_N) / truth_N
        yield Figure("pullout_error_median_pct", np.median(error_pct), source)
        yield Figure("pullout_error_p90_pct", np.percentile(error_pct, 90.0), source)


def describe_reference(force_N: Array, pullout_N: Array) -> Iterator[Figure]:
    """Yield how far the pull-out force is from being the friction of the insertion.

    Args:
        force_N: At `GRID_mm`, shape (recordings, depths).
        pullout_N: The same.
    """
    settled_mm = np.arange(10, 71)
    # A force is a mean over 200 samples: an excess of 0.02 N is no noise.
    is_above = pullout_N[:, settled_mm] > force_N[:, settled_mm] + 0.02
    yield Figure("pullout_above_force", is_above.mean(), "10 to 70 mm")
    yield Figure("pullout_above_force", is_above.any(axis=1).mean(), "recordings")
    yield Figure("pullout_at_2mm_N", pullout_N[:, 2].mean(), "mean")
    yield Figure("force_at_2mm_N", force_N[:, 2].mean(), "mean")
    line_mm = np.arange(15, 66)
    for at_mm in (42, 60, 78):
        lines = np.polyfit(line_mm, pullout_N[:, line_mm].T, 1)
        ratio = pullout_N[:, at_mm] / (lines[0] * at_mm + lines[1])
        yield Figure("pullout_of_line", ratio.mean(), f"{at_mm} mm, mean")
        yield Figure("pullout_of_line", ratio.std(ddof=1), f"{at_mm} mm, spread")
    at_mm = np.array([42, 60, 78])
    for name, quantity in (
        ("pull-out force", pullout_N),
        ("over the force", pullout_N / force_N),
    ):
        at_depths = quantity[:, at_mm]
        spread = at_depths.std(axis=0, ddof=1) / at_depths.mean(axis=0)
        for mm, value in zip(at_mm.tolist(), spread.tolist(), strict=True):
            yield Figure("pullout_spread_pct", 100.0 * value, f"{name}, {mm} mm")
