"""Swivel of the elbow: the motion of a redundant arm that leaves its tip at rest.

    dq = w d,    J d = 0,    max |d_j| = 1

so w is the speed of the joint that moves most. An arm of six joints has no such motion.
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from foundation.arrays import Array
from needleforce.control.setting_checks import require_positive
from needleforce.control.tasks import JointTask, ToolState
from urdf import Robot

TIP_ROWS = 6
"""Rows of the tip's Jacobian: more joints than these leave a motion free."""

SWIVEL_GAIN_PER_S = 3.0
"""Gain with which the elbow keeps to its angle: slow enough for arms that follow late
and for positions that are rounded."""


class ElbowSwivel(JointTask):
    """Turns the elbow to an angle; put it last in a stack.

        dq = d (w + K (angle_wanted - angle)),    angle = sum of (d . dq) / (d . d)

    Args:
        tool: Of the controller that runs the stack; the elbow's angle is zero where it
            is now.
        gain_per_s: K.

    Attributes:
        angle_rad: Turn of the joint that moves most since the start.
    """

    def __init__(self, tool: ToolState, gain_per_s: float = SWIVEL_GAIN_PER_S) -> None:
        require_positive({"gain_per_s": gain_per_s}, or_zero=("gain_per_s",))
        self.size = tool.q_rad.size
        self.angle_rad = 0.0
        self._gain_per_s = float(gain_per_s)
        self._tool = tool
        self._q_rad = tool.q_rad.copy()
        self._wanted_rad = 0.0
        self._rate_rad_s = 0.0
        self._direction = find_self_motion(tool.jacobian)

    def turn(self, angle_rad: float, rate_rad_s: float) -> None:
        """Ask for an angle of the elbow, and for the rate that it has there."""
        self._wanted_rad = angle_rad
        self._rate_rad_s = rate_rad_s

    def velocity_at(self, q_rad: Array) -> Array:
        """Return the velocity asked for, shape (n,); zero without a free motion."""
        direction = find_self_motion(self._tool.jacobian, self._direction)
        if not direction.any():
            return np.zeros(self.size)
        moved_rad = q_rad - self._q_rad
        self.angle_rad += float(direction @ moved_rad / (direction @ direction))
        self._q_rad = np.array(q_rad)
        self._direction = direction
        error_rad = self._wanted_rad - self.angle_rad
        return direction * (self._rate_rad_s + self._gain_per_s * error_rad)

    def room_after(self, robot: Robot, turn_rad: float) -> tuple[float, str]:
        """Return the room that a turn leaves to the limits of the joints, and of which.

        It is judged by the self-motion at the present posture [rad]; infinite without
        one.
        """
        if not self._direction.any():
            return math.inf, ""
        q_rad = self._q_rad + turn_rad * self._direction
        to_lower_rad = q_rad - robot.position_lower_rad
        to_upper_rad = robot.position_upper_rad - q_rad
        rooms_rad = np.minimum(to_lower_rad, to_upper_rad)
        nearest = int(rooms_rad.argmin())
        return float(rooms_rad[nearest]), robot.joint_names[nearest]


def find_self_motion(jacobian: Array, near: ArrayLike | None = None) -> Array:
    """Return the direction d of joints that leaves the tip at rest, shape (n,).

    Args:
        jacobian: Of the tip, shape (6, n).
        near: Direction that it goes on from, shape (n,); None for any.

    Returns:
        d, its largest entry one; zero where no motion is free.
    """
    joints = jacobian.shape[1]
    if joints <= TIP_ROWS:
        return np.zeros(joints)
    free = np.linalg.svd(jacobian)[2][TIP_ROWS:]
    direction = free[0] if near is None else free.T @ (free @ np.asarray(near))
    largest = float(np.abs(direction).max())
    return direction / largest if largest > 0.0 else direction
