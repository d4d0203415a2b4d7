"""A force reading against the true force: error, bias, lag, and whether its doubts are fair."""

import numpy as np

from benchmarks.methods.force_reading import ForceReading
from benchmarks.metrics.force_lag import force_lag_s
from benchmarks.metrics.measurement import Measurement
from benchmarks.signals.force_truth import ForceTruth


def wrench_metrics(reading: ForceReading, truth: ForceTruth) -> list[Measurement]:
    """Measure one reading over the judged part of a run.

    Args:
        reading: Force over the whole run.
        truth: Of the same samples.

    Returns:
        rmse, bias, coverage, all nan when no sample is judged; and the lag, where the true force
        changes.
    """
    judged = truth.judged
    estimate, true = reading.axial_N[judged], truth.axial_N[judged]
    error = estimate - true
    inside = np.abs(error) <= 2.0 * reading.std_N[judged]
    some = error.size > 0
    values = {
        "wrench_rmse_N": np.sqrt(np.mean(error**2)) if some else np.nan,
        "wrench_bias_N": np.mean(error) if some else np.nan,
        "wrench_coverage_2sigma": np.mean(inside) if some else np.nan,
    }
    if some and np.ptp(true) > 0.0:
        values["wrench_lag_ms"] = 1e3 * force_lag_s(truth.t_s[judged], estimate, true)
    return [
        Measurement(reading.source, reading.method, name, float(value))
        for name, value in values.items()
    ]
