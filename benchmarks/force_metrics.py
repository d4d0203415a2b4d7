"""A force reading against the true force: error, bias, lag, and coverage."""

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.signal import lfilter

from benchmarks.methods import ForceReading, joint_residual
from benchmarks.rows import Measurement
from benchmarks.signals import ForceTruth, JointSignals
from groundtruth import Run

Array = NDArray[np.float64]

EARLIEST_S, LATEST_S = -0.1, 0.6
"""Delays that are searched; the published sensor lags by 0.2 s."""
COARSE_S = 0.01


def force_lag_s(t_s: Array, estimate: Array, truth: Array) -> float:
    """Delay of the estimate: the shift of the truth that leaves the least variance of the error.

    A constant difference between the two is not counted.

    Returns:
        The delay [s], positive when the estimate is late; nan where the truth does not change, or
        for less than a second of data.
    """
    inner = (t_s >= t_s[0] + LATEST_S) & (t_s <= t_s[-1] + EARLIEST_S) if len(t_s) else t_s > 0
    if np.count_nonzero(inner) < 2 or np.ptp(truth) == 0.0:
        return float("nan")
    seen, when = estimate[inner], t_s[inner]

    def left(delay_s: float) -> float:
        return float(np.var(seen - np.interp(when - delay_s, t_s, truth)))

    coarse = np.arange(EARLIEST_S, LATEST_S + COARSE_S / 2, COARSE_S)
    best = float(coarse[np.argmin([left(delay) for delay in coarse])])
    around = (max(best - COARSE_S, EARLIEST_S), min(best + COARSE_S, LATEST_S))
    found = minimize_scalar(left, bounds=around, method="bounded", options={"xatol": 1e-5})
    return float(found.x)


def wrench_metrics(reading: ForceReading, truth: ForceTruth) -> list[Measurement]:
    """Measure one reading over the judged part of a run.

    RMSE, bias, coverage, all nan when no sample is judged; and the lag, where the true force
    changes.
    """
    judged = truth.judged
    estimate, true = reading.axial_N[judged], truth.axial_N[judged]
    error = estimate - true
    names = ("wrench_rmse_N", "wrench_bias_N", "wrench_coverage_2sigma")
    values: dict[str, float] = dict.fromkeys(names, np.nan)
    if error.size > 0:
        inside = np.abs(error) <= 2.0 * reading.std_N[judged]
        numbers = (np.sqrt(np.mean(error**2)), np.mean(error), np.mean(inside))
        values = dict(zip(values, map(float, numbers), strict=True))
    if error.size > 0 and np.ptp(true) > 0.0:
        values["wrench_lag_ms"] = 1e3 * force_lag_s(truth.t_s[judged], estimate, true)
    return [Measurement(reading.source, reading.method, *item) for item in values.items()]


GAIN_per_s = 50.0
"""As in comparisons with other momentum observers."""


def residual_metrics(run: Run, signals: JointSignals) -> list[Measurement]:
    """Error of a plain observer on an ideal arm; nothing on any other.

    The ideal is r' = K (external torque - r) with the true torque's mean over each tick, solved
    exactly: row k of the truth, the tick from sample k to the next, gives the value at k + 1.
    """
    if run.plant != "ideal":
        return []
    residual = joint_residual(run.robot, signals, GAIN_per_s, alignment="hold")
    decay = np.exp(-GAIN_per_s * np.median(signals.dt_s))
    ideal = lfilter([0.0, 1.0 - decay], [1.0, -decay], run.truth.external_torque_Nm, axis=0)
    worst = np.sqrt(np.mean((residual - ideal) ** 2, axis=0)).max()
    return [Measurement("virtual", "default", "residual_rms_Nm", float(worst))]
