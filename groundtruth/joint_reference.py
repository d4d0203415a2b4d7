"""What the arm is told to do, tick by tick, and the dynamics along that motion."""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from groundtruth.insertion_path import InsertionPath

Array = NDArray[np.float64]

MASS_TICKS = 10
"""The mass matrix is refreshed every so many ticks: the arm turns by 5 mrad meanwhile at most."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointMotion:
    """Joint motion at equally spaced ticks, arrays of shape (n + 1, 7)."""

    q_rad: Array
    dq_rad_s: Array

    def then(self, other: "JointMotion") -> "JointMotion":
        """Continue with another motion that starts where this one ends."""
        return JointMotion(
            q_rad=np.concatenate([self.q_rad, other.q_rad[1:]]),
            dq_rad_s=np.concatenate([self.dq_rad_s, other.dq_rad_s[1:]]),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointReference:
    """A motion of n ticks and the dynamics along it."""

    motion: JointMotion
    feed_forward_Nm: Array
    """Torque to hold over each tick so that the arm follows the motion, shape (n, 7)."""
    mass_matrix: Array
    """Shape (ceil(n / MASS_TICKS), 7, 7)."""


def motion_along(path: InsertionPath, travel_m: Array, speed_m_s: Array) -> JointMotion:
    """Follow a straight path with a given travel over time.

    Args:
        path: The line in joint space, q(s).
        travel_m: s at each tick, shape (n + 1,).
        speed_m_s: Its rate at each tick, shape (n + 1,).

    Returns:
        q(s(t)) and dq/ds ds/dt.
    """
    slope = path.spline(travel_m, nu=1)
    return JointMotion(q_rad=path.spline(travel_m), dq_rad_s=slope * speed_m_s[:, None])


def joint_reference(model: pin.Model, motion: JointMotion, tick_s: float) -> JointReference:
    """Work out the dynamics along a motion.

    The feed-forward is the inverse dynamics at the middle of each tick with the mean acceleration
    over it: a torque held over a tick sets the mean, not the value at its start.

    Args:
        model: The true arm.
        motion: Motion at the ticks.
        tick_s: Spacing of the ticks.
    """
    q, dq = motion.q_rad, motion.dq_rad_s
    middles = zip(
        0.5 * (q[1:] + q[:-1]), 0.5 * (dq[1:] + dq[:-1]), np.diff(dq, axis=0) / tick_s, strict=True
    )
    data = model.createData()
    return JointReference(
        motion=motion,
        feed_forward_Nm=np.array([pin.rnea(model, data, *middle) for middle in middles]),
        mass_matrix=np.array([pin.crba(model, data, row).copy() for row in q[:-1:MASS_TICKS]]),
    )
