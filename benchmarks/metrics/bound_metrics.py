"""What the noise of a reading would have allowed in one insertion, beside what was reached."""

import math

import numpy as np

from benchmarks.bounds.delay_bound import delay_bounds_s
from benchmarks.bounds.friction_bound import friction_bounds
from benchmarks.bounds.noise_colour import reading_error_N
from benchmarks.metrics.force_lag import force_lag_s
from benchmarks.metrics.transition import is_visible
from benchmarks.signals.insertion_truth import InsertionTruth
from benchmarks.signals.needle_signal import NeedleSignal

MEAN_ABSOLUTE = float(np.sqrt(2.0 / np.pi))
"""Of a standard normal variable: the mean error of an estimator that reaches its bound."""


def bound_metrics(signal: NeedleSignal, truth: InsertionTruth, noise_N: float) -> dict[str, float]:
    """Least errors by name; nothing for a run without ruptures.

    Args:
        signal: Reading of one source.
        truth: Of the run.
        noise_N: Of the source: it decides which transitions are ruptures.
    """
    visible = [rupture for rupture in truth.ruptures if is_visible(rupture, noise_N)]
    lag_s = 0.0
    if signal.source == "virtual":
        lag_s = max(force_lag_s(truth.t_s, signal.force_N, truth.axial_N), 0.0)
    error = reading_error_N(signal, truth, lag_s)
    values: dict[str, float] = {}
    if any(rupture.layer > 0 for rupture in visible):
        for name, is_white in (("", False), ("_white", True)):
            bounds = [
                bound
                for bound, rupture in zip(
                    friction_bounds(truth, error, is_white=is_white),
                    (item for item in truth.ruptures if item.layer > 0),
                    strict=True,
                )
                if rupture in visible
            ]
            values[f"friction_bound{name}_pct"] = 100.0 * MEAN_ABSOLUTE * float(np.mean(bounds))
    if visible:
        delays = [each for each in delay_bounds_s(truth, visible, error, lag_s) if each < math.inf]
        if delays:
            values["rupture_delay_bound_ms"] = 1e3 * float(np.median(delays))
    return values
