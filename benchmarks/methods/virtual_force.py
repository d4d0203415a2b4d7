"""The virtual sensor on a stream of joint signals."""

import numpy as np

from benchmarks.job import Progress
from benchmarks.methods.force_reading import ForceReading
from benchmarks.row import Method
from benchmarks.signals.joint_signals import JointSignals
from residual import SensorConfig, VirtualForceSensor
from urdf import Robot

TELL_EVERY = 1000
"""Samples between two reports of progress."""


def virtual_force(
    robot: Robot,
    signals: JointSignals,
    config: SensorConfig,
    method: Method,
    tare_s: float,
    progress: Progress,
) -> ForceReading:
    """Axial force from joint signals, tared once as a user would.

    Args:
        robot: The arm as the estimator knows it.
        signals: What the arm sent.
        config: Settings of the sensor.
        method: Under which name the reading is reported.
        tare_s: Time of the tare: nothing has been touched before it.
        progress: Told the share done.

    Raises:
        TareError: The sensor sees contact at that time.
    """
    sensor = VirtualForceSensor(robot, config)
    axial, std = np.zeros(len(signals.t_s)), np.zeros(len(signals.t_s))
    dt_s = signals.dt_s
    waiting = True
    for k, now in enumerate(signals.t_s):
        if k % TELL_EVERY == 0:
            progress(k / len(signals.t_s))
        if waiting and now >= tare_s:
            sensor.tare()
            waiting = False
        estimate = sensor.update(
            signals.q_rad[k], signals.velocity(k), signals.tau_Nm[k], float(dt_s[k])
        )
        axial[k], std[k] = estimate.axial, estimate.axial_std
    return ForceReading(source="virtual", method=method, axial_N=axial, std_N=std)
