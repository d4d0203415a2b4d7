"""Limits of position, velocity and acceleration as bounds on the joint velocity of one tick."""

import math

import numpy as np
from numpy.typing import ArrayLike

from needleforce.control.errors import SettingError
from needleforce.control.ports import Array
from needleforce.jit import Matrix, Vector, WrittenMatrix, WrittenVector, compiled
from urdf import Robot

LONGEST_STEP_s = 0.02
"""A sample that comes later gives the arm no more acceleration than this one."""
SOLVER_TOLERANCE = 1e-6
"""A solver may exceed bounds by this [rad/s]: limits are narrowed by it first."""
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
        table: Lowest position, highest position [rad], speed [rad/s] and acceleration [rad/s^2]
            of every joint, shape (4, n).

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
        lowest = robot.position_lower_rad + margin_rad
        highest = robot.position_upper_rad - margin_rad
        own = robot.velocity_limit_rad_s
        rows = (lowest, highest, own if velocity_rad_s is None else velocity_rad_s)
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
        table.setflags(write=False)
        self.table: Array = table


@compiled
def velocity_box(
    limits: Matrix, q: Vector, last: Vector, step_s: float, box: WrittenMatrix
) -> None:
    """Bounds l <= dq <= u of the coming tick, written into the rows of ``box``, shape (2, n).

        u = min(v, sqrt((a T)^2 + 2 a (q_max - q)) - a T),   clipped to dq_last -+ a T

    and l alike. The root is the fastest speed from which the arm, braking at a after this tick of
    T, stops before q_max: u^2 / 2a + u T = q_max - q. From anywhere in the box the next tick has
    such a speed within reach of a again. Where noise or a push has moved the arm too close, the
    clip lets the acceleration win: it brakes as hard as it may. Clipping keeps l <= u.

    Args:
        limits: `Limits.table`.
        q: Measured positions [rad], shape (n,).
        last: Velocities commanded last [rad/s], shape (n,).
        step_s: Length of the tick T.
        box: Takes the result.
    """
    for k in range(q.size):
        rate = limits[ACCELERATION, k]
        change = rate * step_s
        above = max(limits[HIGHEST, k] - q[k], 0.0)
        below = max(q[k] - limits[LOWEST, k], 0.0)
        most = math.sqrt(change * change + 2.0 * rate * above) - change
        least = change - math.sqrt(change * change + 2.0 * rate * below)
        low, high = last[k] - change, last[k] + change
        box[0, k] = min(max(least, -limits[SPEED, k], low), high)
        box[1, k] = max(min(most, limits[SPEED, k], high), low)


@compiled
def fill_bounds(
    limits: Matrix,
    q: Vector,
    last: Vector,
    step_s: float,
    box: WrittenMatrix,
    bounds: WrittenMatrix,
) -> bool:
    """`velocity_box`, and with it all bounds of a `Stack` whose rates stand in row 0.

    Rows are equalities. Limits are narrowed by what the solver may exceed them by.

    Returns:
        Whether all numbers are finite.
    """
    velocity_box(limits, q, last, step_s, box)
    joints, total = q.size, 0.0
    for k in range(joints):
        inside = min(SOLVER_TOLERANCE, 0.25 * (box[1, k] - box[0, k]))
        bounds[0, k], bounds[1, k] = box[0, k] + inside, box[1, k] - inside
        total += q[k]
    for k in range(joints, bounds.shape[1]):
        bounds[1, k] = bounds[0, k]
        total += bounds[0, k]
    return math.isfinite(total)


@compiled
def assess(
    velocity: WrittenVector,
    box: Matrix,
    rows: Matrix,
    rates: Vector,
    ends: Vector,
    missed: WrittenVector,
) -> bool:
    r"""Clip a solution to the box, and say what it leaves unmet.

    Args:
        velocity: Joint velocities [rad/s], shape (n,), clipped in place.
        box: See `velocity_box`.
        rows: J of all tasks, shape (m, n).
        rates: v of all tasks, shape (m,).
        ends: Index behind the last row of each task, shape (tasks,).
        missed: Takes the largest part of J dq - v that stays, of each task, shape (tasks,).

    Returns:
        Whether a joint is at a limit.
    """
    is_limited = False
    for k in range(velocity.size):
        velocity[k] = min(max(velocity[k], box[0, k]), box[1, k])
        room = min(velocity[k] - box[0, k], box[1, k] - velocity[k])
        is_limited = is_limited or room <= 2.0 * SOLVER_TOLERANCE
    row = 0
    for task in range(ends.size):
        worst = 0.0
        while row < int(ends[task]):
            left = -rates[row]
            for k in range(velocity.size):
                left += rows[row, k] * velocity[k]
            worst, row = max(worst, abs(left)), row + 1
        missed[task] = worst
    return is_limited
