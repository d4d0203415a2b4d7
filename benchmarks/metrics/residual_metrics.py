"""The momentum residual against the filter it ought to be."""

import numpy as np
from scipy.signal import lfilter

from benchmarks.methods.joint_residual import joint_residual
from benchmarks.metrics.measurement import Measurement
from benchmarks.signals.joint_signals import JointSignals
from groundtruth import Run

GAIN_per_s = 50.0
"""As in the comparison with other people's observers."""


def residual_metrics(run: Run, signals: JointSignals) -> list[Measurement]:
    """Error of a plain observer on a textbook arm; nothing on any other.

    The ideal is r' = K (external torque - r) with the true torque's mean over each tick, solved
    exactly: row k of the truth, the tick from sample k to the next, gives the value at k + 1.
    """
    if run.arm != "textbook":
        return []
    residual = joint_residual(run.robot, signals, GAIN_per_s, alignment="hold")
    decay = np.exp(-GAIN_per_s * np.median(signals.dt_s))
    ideal = lfilter([0.0, 1.0 - decay], [1.0, -decay], run.truth.external_torque_Nm, axis=0)
    worst = np.sqrt(np.mean((residual - ideal) ** 2, axis=0)).max()
    return [Measurement("virtual", "default", "residual_rms_Nm", float(worst))]
