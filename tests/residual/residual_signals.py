"""Poses, Jacobians and joint signals of an ideal arm: rigid-body torque minus J' F."""

from functools import lru_cache

import numpy as np
import pinocchio as pin

JOINTS = 7
BIAS = np.array([0.3, -0.8, 0.4, 0.5, -0.2, 0.1, -0.05])
MIDDLE = np.array([0.1, 0.5, -0.2, -1.5, 0.3, 1.0, 0.2])


def pose_of(robot, q, frame=None):
    """Placement of a frame, the tool's if none is named, in base axes."""
    data = robot.create_data()
    pin.framesForwardKinematics(robot.model, data, np.array(q, dtype=float))
    return data.oMf[robot.tool_frame_id if frame is None else robot.frame_id(frame)]


def jacobian_of(robot, q, frame=None):
    """Jacobian of such a frame in base axes, shape (6, n)."""
    frame_id = robot.tool_frame_id if frame is None else robot.frame_id(frame)
    return pin.computeFrameJacobian(
        robot.model, robot.create_data(), q, frame_id, pin.LOCAL_WORLD_ALIGNED
    ).reshape(6, -1)


def gravity_of(robot, q):
    """Torques at rest, one row per pose."""
    data = robot.create_data()
    return np.array(
        [pin.computeGeneralizedGravity(robot.model, data, one).copy() for one in q]
    )


def external_torque_of(robot, q, force_at_tip_in_base):
    """J' F of a force on the tool frame, in base axes."""
    return jacobian_of(robot, q)[:3].T @ np.asarray(force_at_tip_in_base)


def swing(
    robot, *, amplitude=0.2, middle=None, force_at_tip_in_base=(0.0, 0.0, 0.0), **span
):
    """Times, q, dq and link-side torque of a smooth joint motion under a constant
    tip force."""
    middle = np.asarray(MIDDLE if middle is None else middle)[: robot.nv]
    force = tuple(map(float, force_at_tip_in_base))
    made = _swing(robot, amplitude, tuple(middle.tolist()), force, **span)
    return tuple(values.copy() for values in made)


@lru_cache(maxsize=50)
def _swing(
    robot,
    amplitude,
    middle,
    force_at_tip_in_base,
    *,
    seconds,
    rate_hz=1000.0,
    start=0.0,
):
    times = start + np.arange(round(seconds * rate_hz)) / rate_hz
    omega = 1.0 + 0.3 * np.arange(robot.nv)
    phase = np.outer(times, omega)
    q = np.array(middle) + amplitude * (1 - np.cos(phase))
    dq = amplitude * omega * np.sin(phase)
    ddq = amplitude * omega**2 * np.cos(phase)
    data = robot.create_data()
    motion = [
        pin.rnea(robot.model, data, *one).copy() for one in zip(q, dq, ddq, strict=True)
    ]
    pushed = [external_torque_of(robot, one, force_at_tip_in_base) for one in q]
    return times, q, dq, np.array(motion) - pushed
