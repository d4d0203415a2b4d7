"""Depth and speed of the needle as the robot's own kinematics tell them."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.signals.joint_signals import JointSignals
from insertion import TipTravel
from residual import VelocityEstimator
from residual.tool_kinematics import ToolKinematics
from urdf import Robot

Array = NDArray[np.float64]


class MeasuredTravel(NamedTuple):
    """Travel of the tip along the needle's axis, and its rate.

    Attributes:
        depth_m: Zero where the tare ended, shape (n,).
        speed_m_s: Its rate, shape (n,).
    """

    depth_m: Array
    speed_m_s: Array


def measured_travel(robot: Robot, signals: JointSignals, zero_s: float) -> MeasuredTravel:
    """Forward kinematics of measured positions, Jacobian of measured velocities.

    Where the arm sends no velocity it is estimated as the virtual sensor does it, causally.

    Args:
        robot: The arm as the estimator knows it; its tool frame's z axis is the needle.
        signals: What the arm sent.
        zero_s: The tip's place and axis at that time are the zero and the direction of depth.
    """
    kinematics = ToolKinematics(robot)
    kinematics.update(signals.q_rad[int(np.searchsorted(signals.t_s, zero_s))])
    travel = TipTravel(kinematics)
    found = np.zeros((len(signals.t_s), 2))
    for k, (q, dq) in enumerate(zip(signals.q_rad, _velocities(signals), strict=True)):
        kinematics.update(q)
        found[k] = travel.read(dq)
    return MeasuredTravel(found[:, 0].copy(), found[:, 1].copy())


def smoothed(travel: MeasuredTravel, dt_s: Array, time_constant_s: float) -> MeasuredTravel:
    """The same travel, its speed through a causal first-order low-pass.

    Args:
        travel: As measured.
        dt_s: Time since the previous sample, shape (n,).
        time_constant_s: Of the low-pass.
    """
    speed = travel.speed_m_s.tolist()
    shares = (1.0 - np.exp(-dt_s / time_constant_s)).tolist()
    for k in range(1, len(speed)):
        speed[k] = speed[k - 1] + shares[k] * (speed[k] - speed[k - 1])
    return travel._replace(speed_m_s=np.array(speed))


def _velocities(signals: JointSignals) -> Array:
    """Measured joint velocities, or estimates of them, shape (n, j)."""
    if signals.dq_rad_s is not None:
        return signals.dq_rad_s
    estimator = VelocityEstimator(signals.q_rad.shape[1])
    found = np.zeros_like(signals.q_rad)
    for k, dt in enumerate(signals.dt_s.tolist()):
        matched = estimator.update(signals.q_rad[k], signals.tau_Nm[k], dt)
        if matched.settled:
            found[k] = matched.dq
    return found
