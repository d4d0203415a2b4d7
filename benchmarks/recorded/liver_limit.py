"""``liver-limit``: how well an insertion into real liver can predict the pull-out force at all.

Regressions of the pull-out force on features of the insertion, each judged on insertions left out
of its training; and how good a reference the pull-out force is. No method of ours is judged here.
The regressions learn from pull-out forces of the same livers, which an estimator in use does not
have.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.ndimage import uniform_filter1d
from scipy.optimize import minimize
from scipy.spatial.distance import cdist

from benchmarks.benchmark import Findings, Job, Progress
from benchmarks.recorded.liver import (
    NUMBERS,
    DEPTHS_mm,
    LiverInsertion,
    force_drops,
    liver_estimates,
    liver_reference,
    mean_at_depth,
    read_liver,
)
from benchmarks.rows import Measurement

Array = NDArray[np.float64]

STEP_m = 0.25e-3
FIRST_m = 1e-3
SMOOTHING = 41
FINE = 51
LEAST = 1e-2
"""Features of force enter as logarithms; below 10 mN they are noise."""
EARLY_mm = (5, 10, 20)
RECENT_mm = (5, 10, 20)


def liver_features(
    depth_m: Array, force_N: Array, at_m: float, friction_N: float
) -> dict[str, float]:
    """Features by name, forces as logarithms, of what is not deeper than `at_m`.

    Depth of the advancing needle and force as recorded, shape (n,); friction as our identification
    estimates it there.
    """
    depth = np.arange(FIRST_m, at_m + STEP_m / 2.0, STEP_m)
    smooth = uniform_filter1d(force_N, SMOOTHING)
    force = np.interp(depth, np.maximum.accumulate(depth_m), smooth)
    found = {
        "force": mean_at_depth(depth_m, force_N, at_m),
        "half": float(np.interp(at_m / 2.0, depth, force)),
        "mean": float(force.mean()),
        "most": float(force.max()),
        "estimated friction": friction_N,
    }
    for mm in EARLY_mm:
        found[f"force at {mm} mm"] = float(np.interp(1e-3 * mm, depth, force))
    for mm in RECENT_mm:
        found[f"least of {mm} mm"] = float(force[depth > at_m - 1e-3 * mm].min())
    found = {name: float(np.log(max(value, LEAST))) for name, value in found.items()}
    drops = [drop.drop_N for drop in force_drops(depth_m, force_N) if drop.to_m <= at_m]
    fine = force_N - uniform_filter1d(force_N, FINE)
    return {
        "depth": at_m,
        **found,
        **_shape(depth, force),
        "drops": float(len(drops)),
        "dropped": float(sum(drops)),
        "largest drop": float(max(drops, default=0.0)),
        "vibration": float(np.std(fine[depth_m <= at_m])),
    }


def _shape(depth_m: Array, force_N: Array) -> dict[str, float]:
    """Lines through the force and through its lower envelope, and what they leave."""
    envelope = np.minimum.accumulate(force_N[::-1])[::-1]
    slope, level = np.polyfit(depth_m, force_N, 1)
    low_slope, low_level = np.polyfit(depth_m, envelope, 1)
    end = depth_m[-1]
    return {
        "line": float(np.log(max(level + slope * end, LEAST))),
        "envelope line": float(np.log(max(low_level + low_slope * end, LEAST))),
        "envelope mean": float(np.log(max(envelope.mean(), LEAST))),
        "slope": float(slope),
        "envelope slope": float(low_slope),
        "usual slope": float(np.median(np.gradient(force_N, depth_m))),
        "roughness": float(np.std(force_N - level - slope * depth_m)),
    }


class Seen(NamedTuple):
    """What a regression learns from: n rows of p features."""

    features: Array  # shape (n, p)
    target: Array  # shape (n,)
    group: NDArray[np.int64]  # rows of one group are not independent; shape (n,)

    def only(self, rows: NDArray[np.bool_]) -> "Seen":
        """Some of the rows."""
        return Seen(self.features[rows], self.target[rows], self.group[rows])


Fit = Callable[[Seen, Array], Array]
"""Takes what to learn from and features (m, p) to predict, gives predictions (m,)."""

PENALTIES = tuple(float(10.0**k) for k in range(-2, 4))
NOISE_LEAST = 1e-3


def left_out(fit: Fit, seen: Seen) -> Array:
    """Prediction of every target by a fit that has not seen its group, shape (n,)."""
    found = np.empty(len(seen.target))
    for each in np.unique(seen.group):
        out = seen.group == each
        found[out] = fit(seen.only(~out), seen.features[out])
    return found


def level(seen: Seen, asked: Array) -> Array:
    """Median of the targets with the same first feature: what knowing nothing else gives."""
    return np.array([np.median(seen.target[seen.features[:, 0] == row[0]]) for row in asked])


def linear(seen: Seen, asked: Array) -> Array:
    """Ordinary least squares."""
    return _ridge(seen, asked, 1e-9)


def ridge(seen: Seen, asked: Array) -> Array:
    """Least squares with a penalty chosen by leaving out one group once more, of what is seen."""
    scores = [
        float(np.sum((left_out(partial(_ridge, penalty=penalty), seen) - seen.target) ** 2))
        for penalty in PENALTIES
    ]
    return _ridge(seen, asked, PENALTIES[int(np.argmin(scores))])


def gaussian_process(seen: Seen, asked: Array) -> Array:
    """Squared-exponential process; size, length and noise of greatest likelihood."""
    known, wanted = _standardised(seen.features, asked)
    target = seen.target
    mean, spread = float(target.mean()), float(target.std()) or 1.0
    values = (target - mean) / spread
    apart, across = (cdist(each, known, "sqeuclidean") for each in (known, wanted))

    def covariance(logs: Array) -> Array:
        size, length, noise = np.exp(logs)
        return size * np.exp(-0.5 * apart / length) + (noise + NOISE_LEAST) * np.eye(len(values))

    def negative_log_likelihood(logs: Array) -> float:
        factor = cho_factor(covariance(logs), lower=True)
        fit = float(values @ cho_solve(factor, values))
        return 0.5 * fit + float(np.sum(np.log(np.diag(factor[0]))))

    start, bounds = np.log([1.0, float(known.shape[1]), 0.5]), [(-5.0, 5.0)] * 3
    best = minimize(negative_log_likelihood, start, bounds=bounds, method="L-BFGS-B").x
    size, length, _ = np.exp(best)
    cross = size * np.exp(-0.5 * across / length)
    return mean + spread * np.asarray(cross @ np.linalg.solve(covariance(best), values))


def _ridge(seen: Seen, asked: Array, penalty: float) -> Array:
    known, wanted = _standardised(seen.features, asked)
    mean = seen.target.mean()
    normal = known.T @ known + penalty * np.eye(known.shape[1])
    return np.asarray(mean + wanted @ np.linalg.solve(normal, known.T @ (seen.target - mean)))


def _standardised(features: Array, asked: Array) -> tuple[Array, Array]:
    """Both by mean and deviation of what is seen."""
    mean, spread = features.mean(axis=0), features.std(axis=0) + 1e-12
    return (features - mean) / spread, (asked - mean) / spread


FEW = ("depth", "force", "force at 10 mm", "usual slope")
"""The three best of the features beside the depth, picked knowing all pull-out forces."""
REGRESSIONS: Mapping[str, tuple[Fit, tuple[str, ...]]] = MappingProxyType(
    {
        "depth": (level, ("depth",)),
        "force": (linear, ("depth", "force")),
        "friction": (linear, ("depth", "estimated friction")),
        "few": (linear, FEW),
        "ridge": (ridge, ()),
        "gp_few": (gaussian_process, FEW),
        "gp": (gaussian_process, ()),
    }
)
"""By name: the regression, and its features; none for all."""
SHALLOW_mm = 20
PEAK_FROM_mm = 60


def run_liver_limit(job: Job, progress: Progress) -> Findings:
    """Regressions over all insertions, and the reference."""
    data = job.recordings
    features: list[dict[str, float]] = []
    insertions: list[LiverInsertion] = []
    for index in range(len(NUMBERS)):
        progress(index / len(NUMBERS))
        insertion = read_liver(data, index)
        inside = insertion.insertion
        depth, force = insertion.depth_m[inside], insertion.force_N[inside]
        reference = liver_reference(insertion, depth, force)
        found = liver_estimates(insertion.t_s[inside], depth, force, "default", reference)
        features += [
            liver_features(depth, force, 1e-3 * mm, friction)
            for mm, friction in zip(DEPTHS_mm, found.friction_N, strict=True)
        ]
        insertions.append(insertion)
    pullouts = [each for insertion in insertions for each in insertion.pullout_N]
    values = regression_values(features, pullouts) | reference_values(insertions)
    return Findings([Measurement("ft", "default", name, value) for name, value in values.items()])


def regression_values(
    features: Sequence[Mapping[str, float]], pullout_N: Sequence[float]
) -> dict[str, float]:
    """Errors on insertions left out, by name; one entry per insertion and depth in both lists."""
    true = np.array(pullout_N)
    group = np.arange(len(true)) // len(DEPTHS_mm)
    values: dict[str, float] = {}
    for name, (fit, wanted) in REGRESSIONS.items():
        table = np.array([[row[key] for key in wanted or row] for row in features])
        predicted = np.exp(left_out(fit, Seen(table, np.log(true), group)))
        errors = 100.0 * np.abs(predicted - true) / true
        values[f"pullout_left_out_{name}_median_pct"] = float(np.median(errors))
        values[f"pullout_left_out_{name}_p90_pct"] = float(np.percentile(errors, 90.0))
    return values


def reference_values(insertions: Sequence[LiverInsertion]) -> dict[str, float]:
    """How the pull-out force contradicts itself, and how it scatters between insertions."""
    deepest, over, peaks = DEPTHS_mm[-1], [], []
    for each in insertions:
        shallow = each.force_at_N(each.insertion, SHALLOW_mm)
        over.append(-each.force_at_N(each.withdrawal, SHALLOW_mm) / shallow)
        out = [each.force_at_N(each.withdrawal, mm) for mm in range(PEAK_FROM_mm, deepest + 1)]
        peaks.append(min(out) / out[-1])
    at = np.array([each.pullout_N for each in insertions])
    next_to = np.abs(np.diff(at, axis=0)) / (0.5 * (at[1:] + at[:-1]))
    return {
        "pullout_above_insertion_fraction": float(np.mean(np.array(over) > 1.0)),
        "pullout_over_insertion_most": max(over),
        "pullout_shallower_peak_median_pct": 100.0 * float(np.median(peaks) - 1.0),
        "pullout_shallower_peak_p90_pct": 100.0 * float(np.percentile(peaks, 90.0) - 1.0),
        "pullout_neighbour_median_pct": 100.0 * float(np.median(next_to)),
        "pullout_neighbour_p90_pct": 100.0 * float(np.percentile(next_to, 90.0)),
    }
