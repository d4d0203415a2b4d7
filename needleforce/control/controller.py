"""One tick: joint velocities for a sample of the arm and a stack of tasks in strict
priority.

    lexmin_dq (|J_1 dq - v_1|, |J_2 dq - v_2|, ..., |dq - w|)   subject to   l <= dq <= u

with limits of the joints and a wish w of theirs that comes last, zero or a posture
(Kanoun et al., IEEE T-RO 2011). Norms are of rows scaled to length one: a row counts by
how far joints move for it.
"""

import itertools
import math
from collections.abc import Callable, Sequence
from enum import StrEnum
from operator import is_
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from foundation.arrays import Matrix, Vector, WrittenMatrix, WrittenVector
from foundation.jit import compiled
from foundation.linear_algebra import dot
from needleforce.control.errors import SettingError, require_positive
from needleforce.control.ports import ArmSample, Array
from needleforce.control.tasks import (
    JointVelocity,
    LONGEST_STEP_s,
    Task,
    ToolState,
    vector,
)
from urdf import Robot

SLACK_rad_s = 1e-7
"""Speeds and their changes stay this far inside, and a solver may exceed the box by
as much."""
# Rows of `Limits.table`
LOWEST = 0
HIGHEST = 1
SPEED = 2
ACCELERATION = 3

_REGULAR = 1e-6  # Where less than that of a row is new, it counts as dependent on those above it
_AT_LIMIT_rad_s = 1e-6
_NO_WAY = 1e-13  # A direction that moves a row of length one by less does not move it
_BEYOND_rad_s = 1e-8  # By so much a joint may pass its bound, within the slack
_MOST_CHANGES = (
    60  # Of the joints held at a bound, in one level; what is found by then is kept
)
_GAIN = 1e-12  # Letting go of a joint that gains less by it is not worth while


class Limits:
    """What the joints may do.

    Args:
        robot: Its model names positions and speeds.
        velocity_rad_s: Slower speeds, one or one per joint; the robot's where None.
        acceleration_rad_s2: One or one per joint. A low one lengthens every stop.
        margin_rad: Kept from the position limits, for what moves the arm besides the
            command.

    Attributes:
        table: Lowest, highest position [rad], speed [rad/s], acceleration [rad/s^2],
            shape (4, n).

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
        require_positive({"margin_rad": margin_rad}, or_zero=("margin_rad",))
        own = robot.velocity_limit_rad_s
        ends = (
            robot.position_lower_rad + margin_rad,
            robot.position_upper_rad - margin_rad,
        )
        rows = (*ends, own if velocity_rad_s is None else velocity_rad_s)
        try:
            same = [
                np.broadcast_to(row, robot.nv) for row in (*rows, acceleration_rad_s2)
            ]
        except ValueError:
            raise SettingError(
                f"limits must be one number or {robot.nv}, one per joint"
            ) from None
        table = np.array(same, dtype=np.float64)
        for wrong, what in (
            (
                ~np.isfinite(table[:2]).all(axis=0),
                "no position limits; name them in its model",
            ),
            (
                ~(table[LOWEST] < table[HIGHEST]),
                f"no room within a margin of {margin_rad:g} rad",
            ),
            (
                ~np.isfinite(table[2:]).all(axis=0),
                "no limit of speed or acceleration; give one",
            ),
            (
                ~(table[2:] > 0.0).all(axis=0),
                "a speed or acceleration that is not positive",
            ),
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

    and l alike. The root is the fastest speed from which the arm, braking at a after
    this tick of T, stops before q_max: u^2 / 2a + u T = q_max - q. From anywhere in the
    box the next tick has such a speed within reach of a again. Where noise or a push
    has moved the arm too close, the clip lets it brake as hard as it may; l <= u.
    Limits are a `Limits.table`, bounds of shape (2, n), and nan where a position is.
    """
    speed = limits[SPEED]
    rate = limits[ACCELERATION]
    change = rate * step_s - SLACK_rad_s
    square = change * change
    way = 2.0 * rate
    low = last - change
    high = last + change
    most = np.sqrt(square + way * np.maximum(limits[HIGHEST] - q, 0.0)) - change
    least = change - np.sqrt(square + way * np.maximum(q - limits[LOWEST], 0.0))
    bounds[0] = np.minimum(np.maximum(np.maximum(least, -speed), low), high)
    bounds[1] = np.minimum(np.maximum(np.minimum(most, speed), low), high)


class Stack:
    """The numbers of a stack of tasks, in arrays that are used over and over.

    Attributes:
        rows: J of the other tasks, shape (m, n).
        rates: v of them, shape (m,).
        wish: w, shape (n,): a joint velocity as the last task, which needs no rows;
            else zero.
        bounds: l and u, shape (2, n), for its user to fill in.
        levels: Rows and rates of each task, views of the above.
    """

    def __init__(self, tasks: Sequence[Task], joints: int) -> None:
        for task in tasks:
            if isinstance(task, JointVelocity) and task.size != joints:
                raise SettingError(
                    f"a task of {task.size} joints, the robot has {joints}"
                )
        last = tasks[-1] if tasks else None
        sizes = [
            task.size
            for task in (tasks[:-1] if isinstance(last, JointVelocity) else tasks)
        ]
        self.rows = np.zeros((sum(sizes), joints))
        self.rates = np.zeros(sum(sizes))
        self.wish = np.zeros(joints)
        self.bounds = np.zeros((2, joints))
        ends = itertools.pairwise(itertools.accumulate(sizes, initial=0))
        self.levels = [
            (self.rows[first:end], self.rates[first:end]) for first, end in ends
        ]

    def fill(self, tasks: Sequence[Task], tool: ToolState) -> None:
        """Take rows and rates of tasks of the same sizes."""
        for task, (rows, rates) in zip(tasks, self.levels, strict=False):
            task.write(tool, rows, rates)
        if tasks and isinstance(last := tasks[-1], JointVelocity):
            self.wish = last.velocity(tool.q_rad)


Solver = Callable[[Stack], tuple[Array, bool]]
"""Joint velocities for a stack, in an array of their own, and whether one is at a
limit."""


@compiled
def all_met(
    rows: Matrix, rates: Vector, bounds: Matrix, velocity: WrittenVector
) -> bool:
    """Change a velocity as little as meets all rows; whether it is then within bounds.

    Gram-Schmidt steps, twice for accuracy, make a basis of the rows; moving along its
    i-th direction meets row i and leaves the rows before it met.
    """
    joints = velocity.size
    if rates.size > joints:
        return False
    basis = np.empty((joints, joints))
    for i in range(rates.size):
        new = basis[i]
        new[:] = rows[i]
        for j in range(2 * i):
            part = dot(new, basis[j % i])
            for k in range(joints):
                new[k] -= part * basis[j % i, k]
        size = math.sqrt(dot(new, new))
        if size < _REGULAR:
            return False
        new /= size
        part = (rates[i] - dot(rows[i], velocity)) / dot(rows[i], new)
        for k in range(joints):
            velocity[k] += part * new[k]
    is_met = True
    for k in range(joints):
        is_met = is_met and bounds[0, k] < velocity[k] < bounds[1, k]
    return is_met


def hierarchical(stack: Stack) -> tuple[Array, bool]:
    """Strict priorities within hard limits, level by level; see `Solver`.

    Each level moves within the null space N of the rows above it, which therefore keep
    what they
    have got:  dq_k = dq_{k-1} + N y,  min_y |J_k N y - (v_k - J_k dq_{k-1})|,  l <= dq_k <= u.
    """
    velocity = stack.wish.copy()
    if all_met(
        stack.rows, stack.rates, stack.bounds, velocity
    ):  # then no level needs to give way
        return velocity, False
    if not (
        np.isfinite(stack.rows).all() and np.isfinite((*stack.rates, *stack.wish)).all()
    ):
        raise SettingError("positions or goals are not finite")
    lower, upper = stack.bounds
    # From where no lower task has a say, so that it cannot matter to a higher one.
    velocity = np.minimum(np.maximum(0.0, lower), upper)
    free = np.eye(velocity.size)
    for rows, rates in [*stack.levels, (free, stack.wish)]:
        if free.size:
            length = np.maximum(np.sqrt((rows * rows).sum(axis=1)), 1e-9)
            level = rows / length[:, None], rates / length
            velocity, free = serve_level(*level, free, stack.bounds, velocity)
    velocity = np.minimum(
        np.maximum(velocity, lower - SLACK_rad_s), upper + SLACK_rad_s
    )
    room = np.minimum(velocity - lower, upper - velocity)
    return velocity, bool(room.min() <= _AT_LIMIT_rad_s)


@compiled
def null_space(rows: Matrix) -> Matrix:
    """Orthonormal directions that no row sees, in columns."""
    if rows.size == 0:
        return np.eye(rows.shape[1])
    _, sizes, turned = np.linalg.svd(rows)
    return np.ascontiguousarray(turned[(sizes > _NO_WAY).sum() :].T)


@compiled
def blocking(
    velocity: Vector, step: Vector, bounds: Matrix, is_held: Vector
) -> tuple[float, int]:
    """The part of a step that bounds allow, 0 to 1, and the joint that ends it; -1 for
    none.

    Of joints that meet their bounds almost at once the one that moves most, so that
    near a singular posture none is held for a motion that is rounding (Harris, Math.
    Programming 1973).
    """
    part = 1.0
    joint = -1
    most = 0.0
    ends = np.where(step > 0.0, bounds[1], bounds[0]) - velocity
    for k in range(step.size):
        if is_held[k] == 0.0 and step[k] != 0.0:
            part = min(part, max(ends[k] / step[k] + _BEYOND_rad_s / abs(step[k]), 0.0))
    for k in range(step.size if part < 1.0 else 0):
        if is_held[k] == 0.0 and abs(step[k]) > most and ends[k] / step[k] <= part:
            joint = k
            most = abs(step[k])
    return (max(ends[joint] / step[joint], 0.0) if joint >= 0 else 1.0), joint


@compiled
def serve_level(
    rows: Matrix, rates: Vector, free: Matrix, bounds: Matrix, start: Vector
) -> tuple[Array, Array]:
    """One level by a primal active-set method: its velocity, and the N of the levels
    below.

    On the joints that are held at a bound the nearest velocity is a least-squares
    solution. The way there ends where another joint meets its bound, which is then held
    too. At its end that joint is let go which gains most from it, the first of them
    after many changes, so that no circle can form; with none the level is served. Rows
    are of length one, N is orthonormal, the levels above are content with the start.
    """
    velocity = start.copy()
    is_held = np.zeros(start.size)
    seen = rows @ free
    for change in range(_MOST_CHANGES):
        held = free[is_held != 0.0]
        ways = np.ascontiguousarray(free @ null_space(held))
        if ways.shape[1]:
            found = np.linalg.lstsq(rows @ ways, rates - rows @ velocity, 1e-8)[0]
            step = ways @ found
            part, joint = blocking(velocity, step, bounds, is_held)
            velocity += part * step
            if joint >= 0:
                is_held[joint] = 1.0 if step[joint] > 0.0 else -1.0
                continue
        if not len(held):
            break
        gain = seen.T @ (rates - rows @ velocity)
        push = np.linalg.lstsq(np.ascontiguousarray(held.T), gain, 1e-12)[0]
        joints = np.flatnonzero(is_held)
        inwards = push * is_held[joints]
        wrong = np.flatnonzero(inwards < -_GAIN)
        if not wrong.size:
            break
        worst = wrong[0] if change > _MOST_CHANGES // 2 else np.argmin(inwards)
        is_held[joints[worst]] = 0.0
    return velocity, np.ascontiguousarray(free @ null_space(seen))


class CommandStatus(StrEnum):
    """How a command came about."""

    OK = "ok"  # the tasks in order of priority, no limit in the way
    SATURATED = "saturated"  # the same, with at least one joint at a limit
    BRAKING = "braking"  # no task: as slow as the limits allow
    SKIPPED = (
        "skipped"  # sample or task no good, see `Command.reason`: braking without them
    )


class Command(NamedTuple):
    """Joint velocities for the coming cycle.

    Attributes:
        dq_rad_s: To be sent to the arm, shape (n,).
        reason: Why it was skipped; empty otherwise.
    """

    dq_rad_s: Array
    status: CommandStatus
    reason: str = ""


class Controller:
    """Turns samples and stacks of tasks into joint velocities; see `update`.

    Args:
        robot: The arm; the z axis of its tool frame is the needle.
        limits: What its joints may do; `SettingError` for those of another robot.
        solve: Strict priority within limits; another one to compare with, not to move
            an arm.

    Attributes:
        tool: Pose and Jacobian of the tip at the last valid sample.
        last_rad_s: What was commanded last, shape (n,).
    """

    def __init__(
        self, robot: Robot, limits: Limits, solve: Solver = hierarchical
    ) -> None:
        if (joints := limits.table.shape[1]) != robot.nv:
            raise SettingError(f"limits of {joints} joints, the robot has {robot.nv}")
        self.tool = ToolState(robot)
        self._limits = limits.table
        self._joints = joints
        self._solve = solve
        self._stacks: dict[tuple[int, ...], Stack] = {}
        self._tasks = list[Task]()
        self._numbers = Stack((), robot.nv)
        self._step_s = 1e-3
        self.reset()

    def reset(self, dq_rad_s: Array | None = None) -> None:
        """Begin from the velocity that the arm has, shape (n,), within its limits, or
        from rest.

        Call it when the arm has not followed: its commands were refused, or it has
        stopped itself. `SettingError` for anything but n finite numbers.
        """
        rest = np.zeros(self._joints)
        now = rest if dq_rad_s is None else vector(dq_rad_s, self._joints, "dq_rad_s")
        self.last_rad_s = np.clip(now, -self._limits[SPEED], self._limits[SPEED])

    def update(self, sample: ArmSample, stack: Sequence[Task]) -> Command:
        """The command for the coming cycle. It never raises and always answers.

        Errors of tasks are of the measured positions, and the command starts from the
        last one: that keeps noise of measured velocities out of it, and the
        accelerations within limits.

        Args:
            sample: What the arm reports.
            stack: Tasks, the most important first; with none the arm brakes and rests.
        """
        try:
            q = np.ascontiguousarray(sample.q_rad, np.float64)
            dt_s = float(sample.dt_s)
            if q.shape != (self._joints,) or not 0.0 < dt_s < math.inf:
                return self._skip(f"{q.size} positions, dt_s = {dt_s:g}")
            if not math.isfinite(q.dot(q)):
                return self._skip("positions are not finite")
            self._step_s = min(dt_s, LONGEST_STEP_s)
            self.tool.update(q)
            tasks = (
                self._tasks
            )  # the same tasks are known, whatever has changed in them
            if len(stack) != len(tasks) or not all(map(is_, stack, tasks)):
                has_wish = bool(stack) and isinstance(stack[-1], JointVelocity)
                key = (has_wish, *[task.size for task in stack])
                if key not in self._stacks:
                    self._stacks[key] = Stack(stack, self._joints)
                self._tasks = list(stack)
                self._numbers = self._stacks[key]
            numbers = self._numbers
            numbers.fill(stack, self.tool)
            joint_bounds(self._limits, q, self.last_rad_s, self._step_s, numbers.bounds)
            if not stack:
                return self._send(np.clip(0.0, *numbers.bounds), CommandStatus.BRAKING)
            velocity, is_limited = self._solve(numbers)
        except Exception as error:  # whatever a sample or a stranger's task brings
            return self._skip(f"{type(error).__name__}: {error}")
        return self._send(
            velocity, CommandStatus.SATURATED if is_limited else CommandStatus.OK
        )

    def _skip(self, reason: str) -> Command:
        """Brake from the last command at the rate that limits allow."""
        change = self._limits[ACCELERATION] * self._step_s - SLACK_rad_s
        velocity = self.last_rad_s - np.clip(self.last_rad_s, -change, change)
        return self._send(velocity, CommandStatus.SKIPPED, reason)

    def _send(
        self, velocity: Array, status: CommandStatus, reason: str = ""
    ) -> Command:
        velocity.setflags(write=False)
        self.last_rad_s = velocity
        return Command(velocity, status, reason)
