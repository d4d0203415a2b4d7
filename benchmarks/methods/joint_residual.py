"""The plain residual of a stream of joint signals, without tare or wrench."""

import numpy as np
from numpy.typing import NDArray

from benchmarks.errors import DataError
from benchmarks.signals.joint_signals import JointSignals
from residual import FrictionModel, MomentumObserver
from residual.momentum_step import Alignment
from urdf import Robot

Array = NDArray[np.float64]


def joint_residual(
    robot: Robot,
    signals: JointSignals,
    gain_per_s: float,
    *,
    alignment: Alignment = "trapezoid",
    friction: FrictionModel | None = None,
) -> Array:
    """Run a `MomentumObserver` over all samples.

    Args:
        robot: The arm.
        signals: What it sent, velocities included.
        gain_per_s: Observer gain K.
        alignment: How torque fills a tick.
        friction: Joint friction, if any is modelled.

    Returns:
        Residual after every sample [Nm], shape (n, j).

    Raises:
        DataError: The arm sent no velocities.
    """
    if signals.dq_rad_s is None:
        raise DataError("a plain observer needs joint velocities, and these signals have none")
    observer = MomentumObserver(robot, gain_per_s, alignment=alignment, friction=friction)
    samples = zip(signals.q_rad, signals.dq_rad_s, signals.tau_Nm, signals.dt_s, strict=True)
    return np.array([observer.update(q, dq, tau, float(dt)) for q, dq, tau, dt in samples])
