"""``liver-limit``: how much of the pull-out force an insertion into real liver tells at all.

Regressions of the pull-out force on everything we could think of in the insertion, each judged on
insertions it has not seen; and how good a yardstick the pull-out force is. No method of ours is
judged here. The regressions learn from pull-out forces of the same livers, which an estimator in
use does not have.
"""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.benchmark import Findings
from benchmarks.job import Job, Progress
from benchmarks.metrics.measurement import Measurement
from benchmarks.recorded.liver import NUMBERS, LiverInsertion, read_liver
from benchmarks.recorded.liver_features import liver_features
from benchmarks.recorded.liver_told import DEPTHS_mm, known_of, tell
from benchmarks.recorded.pullout import InAndOut, in_and_out
from benchmarks.recorded.regression import (
    Fit,
    Seen,
    gaussian_process,
    left_out,
    level,
    linear,
    ridge,
)

Array = NDArray[np.float64]

FEW = ("depth", "force", "force at 10 mm", "usual slope")
"""The three best of the features beside the depth, picked knowing all pull-out forces."""
REGRESSIONS: Mapping[str, tuple[Fit, tuple[str, ...]]] = MappingProxyType(
    {
        "depth": (level, ("depth",)),
        "force": (linear, ("depth", "force")),
        "told": (linear, ("depth", "friction told")),
        "few": (linear, FEW),
        "ridge": (ridge, ()),
        "gp_few": (gaussian_process, FEW),
        "gp": (gaussian_process, ()),
    }
)
"""By name: the regression, and its features; none for all."""
SHALLOW_mm = 20
PEAK_FROM_mm = 60


class _Pullout(NamedTuple):
    """Pull-out force of one insertion against itself.

    Attributes:
        over_insertion: At `SHALLOW_mm`, as a share of the whole insertion force there.
        peak: Largest beyond `PEAK_FROM_mm` but above the deepest of `DEPTHS_mm`, as a share of
            that at the latter.
        at_N: At each of `DEPTHS_mm`.
    """

    over_insertion: float
    peak: float
    at_N: tuple[float, ...]


def run_liver_limit(job: Job, progress: Progress) -> Findings:
    """Regressions over all insertions, and the yardstick.

    Raises:
        DataError: The recording is missing or broken.
    """
    data = job.recordings
    features: list[dict[str, float]] = []
    pullouts: list[_Pullout] = []
    for index in range(len(NUMBERS)):
        progress(index / len(NUMBERS))
        insertion = read_liver(data, index, as_recorded=True)
        parts = in_and_out(insertion.depth_m)
        out = _pullout(insertion, parts)
        depth, force = insertion.depth_m[parts.insertion], insertion.force_N[parts.insertion]
        told = tell(
            insertion.t_s[parts.insertion],
            depth,
            force,
            "default",
            known_of(out.at_N, depth, force),
        )
        features += [
            liver_features(depth, force, 1e-3 * mm, friction)
            for mm, friction in zip(DEPTHS_mm, told.friction_N, strict=True)
        ]
        pullouts.append(out)
    values = regression_values(features, [each for out in pullouts for each in out.at_N])
    values |= _yardstick_values(pullouts)
    return Findings([Measurement("ft", "default", name, value) for name, value in values.items()])


def regression_values(
    features: Sequence[Mapping[str, float]], pullout_N: Sequence[float]
) -> dict[str, float]:
    """Errors on insertions left out, by name.

    Args:
        features: One entry per insertion and depth, insertion by insertion.
        pullout_N: The same.
    """
    true = np.array(pullout_N)
    group = np.arange(len(true)) // len(DEPTHS_mm)
    values: dict[str, float] = {}
    for name, (fit, wanted) in REGRESSIONS.items():
        table = np.array([[row[key] for key in wanted or row] for row in features])
        told = np.exp(left_out(fit, Seen(table, np.log(true), group)))
        errors = 100.0 * np.abs(told - true) / true
        values[f"pullout_left_out_{name}_median_pct"] = float(np.median(errors))
        values[f"pullout_left_out_{name}_p90_pct"] = float(np.percentile(errors, 90.0))
    return values


def _pullout(insertion: LiverInsertion, parts: InAndOut) -> _Pullout:
    def out_N(mm: float) -> float:
        return -insertion.force_at_N(parts.withdrawal, mm)

    deepest = DEPTHS_mm[-1]
    peak = max(out_N(mm) for mm in range(PEAK_FROM_mm, deepest + 1))
    return _Pullout(
        out_N(SHALLOW_mm) / insertion.force_at_N(parts.insertion, SHALLOW_mm),
        peak / out_N(deepest),
        tuple(out_N(mm) for mm in DEPTHS_mm),
    )


def _yardstick_values(pullouts: Sequence[_Pullout]) -> dict[str, float]:
    """How the pull-out force contradicts itself, and how it scatters between insertions."""
    over = np.array([out.over_insertion for out in pullouts])
    peaks = np.array([out.peak for out in pullouts])
    at = np.array([out.at_N for out in pullouts])
    next_to = np.abs(np.diff(at, axis=0)) / (0.5 * (at[1:] + at[:-1]))
    return {
        "pullout_above_insertion_share": float(np.mean(over > 1.0)),
        "pullout_over_insertion_most": float(over.max()),
        "pullout_shallower_peak_median_pct": 100.0 * float(np.median(peaks) - 1.0),
        "pullout_shallower_peak_p90_pct": 100.0 * float(np.percentile(peaks, 90.0) - 1.0),
        "pullout_neighbour_median_pct": 100.0 * float(np.median(next_to)),
        "pullout_neighbour_p90_pct": 100.0 * float(np.percentile(next_to, 90.0)),
    }
