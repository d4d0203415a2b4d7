"""Limits of position, velocity and acceleration as bounds on the joint velocity of one tick."""

import numpy as np
from numpy.typing import ArrayLike

from needleforce.control.errors import SettingError
from needleforce.control.ports import Array
from needleforce.jit import Matrix, Vector, WrittenMatrix, compiled
from urdf import Robot

LONGEST_STEP_s = 0.02
"""A sample that comes later gives the arm no more acceleration than this one."""
SLACK_rad_s = 1e-7
"""Speeds and their changes stay this far inside, and a solver may exceed the box by as much."""
LOWEST, HIGHEST, SPEED, ACCELERATION = 0, 1, 2, 3
"""Rows of `Limits.table`."""


class Limits:
    """What the joints may do.

    Args:
        robot: Its model names positions and speeds.
        velocity_rad_s: Slower speeds, one or one per joint; the robot's where None.
        acceleration_rad_s2: One or one per joint. The arm brakes at the same rate, so a low one
            lengthens every stop.
        margin_rad: Distance kept from the position limits, for what moves the arm besides the
            command.

    Attributes:
        table: Lowest and highest position [rad], speed [rad/s] and acceleration [rad/s^2] of
            every joint, shape (4, n).

    Raises:
        SettingError: A limit is missing, not positive, or above the robot's.
    """

    def __init__(
        self,
        robot: Robot,
        velocity_rad_s: ArrayLike | None = None,
        acceleration_rad_s2: ArrayLike = 10.0,
        margin_rad: float = 0.02,
    ) -> None:
        own = robot.velocity_limit_rad_s
        ends = (robot.position_lower_rad + margin_rad, robot.position_upper_rad - margin_rad)
        rows = (*ends, own if velocity_rad_s is None else velocity_rad_s)
        try:
            same = [np.broadcast_to(row, robot.nv) for row in (*rows, acceleration_rad_s2)]
        except ValueError:
            raise SettingError(f"limits must be one number or {robot.nv}, one per joint") from None
        table = np.array(same, dtype=np.float64)
        for wrong, what in (
            (~np.isfinite(table[:2]).all(axis=0), "no position limits; name them in its model"),
            (~(table[LOWEST] < table[HIGHEST]), f"no room within a margin of {margin_rad:g} rad"),
            (~np.isfinite(table[2:]).all(axis=0), "no limit of speed or acceleration; give one"),
            (~(table[2:] > 0.0).all(axis=0), "a speed or acceleration that is not positive"),
            (table[SPEED] > own, f"a speed above the robot's own {own.tolist()} rad/s"),
        ):
            if wrong.any():
                joints = ", ".join(np.array(robot.joint_names)[wrong])
                raise SettingError(f"joints {joints}: {what}")
        table[SPEED] -= SLACK_rad_s
        table.setflags(write=False)
        self.table: Array = table


@compiled
def joint_bounds(
    limits: Matrix, q: Vector, last: Vector, step_s: float, bounds: WrittenMatrix
) -> None:
    """Bounds l <= dq <= u of the coming tick.

        u = min(v, sqrt((a T)^2 + 2 a (q_max - q)) - a T),   clipped to dq_last -+ a T

    and l alike. The root is the fastest speed from which the arm, braking at a after this tick of
    T, stops before q_max: u^2 / 2a + u T = q_max - q. From anywhere in the box the next tick has
    such a speed within reach of a again. Where noise or a push has moved the arm too close, the
    clip lets the acceleration win: it brakes as hard as it may. Clipping keeps l <= u. Limits are
    a `Limits.table`, bounds of shape (2, n), and nan where a position is.
    """
    speed, rate = limits[SPEED], limits[ACCELERATION]
    change = rate * step_s - SLACK_rad_s
    square, way, low, high = change * change, 2.0 * rate, last - change, last + change
    most = np.sqrt(square + way * np.maximum(limits[HIGHEST] - q, 0.0)) - change
    least = change - np.sqrt(square + way * np.maximum(q - limits[LOWEST], 0.0))
    bounds[0] = np.minimum(np.maximum(np.maximum(least, -speed), low), high)
    bounds[1] = np.minimum(np.maximum(np.minimum(most, speed), low), high)
