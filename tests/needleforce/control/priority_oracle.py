"""Strict priority and hard limits, for random stacks of tasks and hostile input.

Half of the postures are within 1e-9 to 1e-2 rad of a singular one. *Leak*: how far the
tasks below change what a task above gets. *Cascade*: each level again as a QP of its
own, set up by pink and solved through qpsolvers, in what the levels above leave free;
how much better it is than the level of our solution, as far as bounds let it.
*Hostile*: ticks with leaps of measured positions, late samples, goals out of reach and
numbers that are none; an ideal arm integrates what was commanded before.
"""

from collections.abc import Iterator, Sequence

import numpy as np
import pink  # pyright: ignore[reportMissingImports]
import qpsolvers  # pyright: ignore[reportMissingImports]
from pink.tasks import Task as PinkTask  # pyright: ignore[reportMissingImports]
from scipy.optimize import nnls

from foundation.arrays import Array
from groundtruth.arm_motion import LWR_POSTURE_rad
from groundtruth.rig_arm import ArmSample
from needleforce.control.controller import Controller
from needleforce.control.joint_limits import Limits, SLACK_rad_s
from needleforce.control.priority_solver import (
    Stack,
    hierarchical,
    solve_level,
)
from needleforce.control.tasks import (
    AxialSpeed,
    Fixture,
    MAX_STEP_s,
    Posture,
    RemoteCentre,
    Task,
    TipVelocity,
    ToolState,
)
from needleforce.devices.rate_limiter import write_velocity_bounds
from urdf import Robot


class RandomStacks:
    """Postures, stacks of tasks and boxes, drawn without end."""

    def __init__(self, robot: Robot, rng: np.random.Generator) -> None:
        self.robot = robot
        self.rng = rng
        self.limits = Limits(robot)
        self.tool = ToolState(robot)

    def posture(self, is_singular: bool) -> Array:
        """Draw joint positions within limits."""
        rng = self.rng
        joints = self.limits.joints
        q = rng.uniform(joints.position_lower_rad, joints.position_upper_rad)
        if is_singular:
            # Near zero the LWR is stretched, or two of its axes are one.
            joint = rng.choice((1, 3, 5))
            q[joint] = rng.choice((-1.0, 1.0)) * 10.0 ** rng.uniform(-9.0, -2.0)
        return q

    def tasks(self) -> list[Task]:
        """Draw two to four tasks around the tool, in any order, then a posture."""
        rng = self.rng
        tool = self.tool
        near = tool.tip_m + 1e-3 * rng.standard_normal(3)
        speed = 10.0 ** rng.uniform(-3.0, 0.0)
        kinds: list[Task] = [
            RemoteCentre(near - rng.uniform(0.02, 0.2) * tool.axis),
            Fixture(near, tool.rotation),
            TipVelocity(speed * rng.standard_normal(3)),
            AxialSpeed(speed * rng.standard_normal()),
        ]
        chosen = rng.permutation(len(kinds))[: rng.integers(2, 5)]
        joints = self.limits.joints
        goal = rng.uniform(
            joints.position_lower_rad - 0.5, joints.position_upper_rad + 0.5
        )
        return [*(kinds[k] for k in chosen), Posture(goal)]

    def draw(self, is_singular: bool) -> tuple[list[Task], Array]:
        """Draw tasks at a new posture, and the velocity commanded last."""
        q = self.posture(is_singular)
        self.tool.update(q)
        fraction = self.rng.choice((0.0, 0.01, 0.3, 1.0))
        speed_rad_s = self.limits.joints.speed_rad_s
        last_rad_s = fraction * speed_rad_s * self.rng.uniform(-1.0, 1.0, q.size)
        return self.tasks(), last_rad_s


def solved(
    stacks: RandomStacks,
    tasks: Sequence[Task],
    last: Array,
) -> tuple[Stack, Array]:
    """Return the first levels of a stack, and the velocity that serves them."""
    stack = Stack(tasks, last.size)
    stack.fill(tasks, stacks.tool)
    joints = stacks.limits.joints
    write_velocity_bounds(
        np.array((*joints, joints.acceleration_rad_s2)),
        stacks.tool.q_rad,
        last,
        np.zeros_like(last),
        1e-3,
        SLACK_rad_s,
        stack.bounds,
    )
    return stack, hierarchical(stack)[0]


def leaks(robot: Robot, rng: np.random.Generator, count: int) -> list[float]:
    """Return how far lower tasks move what higher ones get, by kind of posture."""
    stacks = RandomStacks(robot, rng)
    worst = [0.0, 0.0]
    for index in range(count):
        is_singular = bool(index % 2)
        tasks, last_rad_s = stacks.draw(is_singular)
        _, full = solved(stacks, tasks, last_rad_s)
        for levels in range(1, len(tasks)):
            stack, alone = solved(stacks, tasks[:levels], last_rad_s)
            moved = stack.rows[: stack.rates.size] @ (full - alone)
            worst[is_singular] = max(worst[is_singular], float(np.abs(moved).max()))
    return worst


class Rows(PinkTask):
    """Rows J dq = v as a task of pink, for displacements of one second."""

    def __init__(self, rows: Array, rates: Array) -> None:
        super().__init__(cost=1.0, gain=1.0)
        self.jacobian = rows
        self.rates = rates

    def __repr__(self) -> str:  # pyright: ignore[reportIncompatibleMethodOverride]
        """For pink's messages."""
        return f"Rows(size={len(self.rates)})"

    def compute_error(self, configuration: pink.Configuration) -> Array:
        """Return what is missing, which pink's sign convention makes -v."""
        return -self.rates

    def compute_jacobian(self, configuration: pink.Configuration) -> Array:
        """Return the rows."""
        return self.jacobian


def cascades(
    robot: Robot, rng: np.random.Generator, count: int
) -> tuple[list[float], list[float]]:
    """Return how much better each level could be within what is left to it.

    By a QP of its own, and at most, by duality; for each kind of posture.

    Each is judged where it ends. The levels below keep what it has got, see `leaks`,
    but may pass a bound by 1e-8 rad/s; where a level would gain 1e6 times as much, a QP
    that starts from there takes that for room.
    """
    stacks = RandomStacks(robot, rng)
    gains = [0.0, 0.0]
    bounds = [0.0, 0.0]
    for index in range(count):
        kind = index % 2
        tasks, last_rad_s = stacks.draw(bool(kind))
        stack, velocity = solved(stacks, tasks, last_rad_s)
        configuration = pink.Configuration(
            robot.model, robot.create_data(), stacks.tool.q_rad
        )
        for by_qp, at_most in level_gains(stack, velocity, configuration):
            if by_qp is not None:
                gains[kind] = max(gains[kind], by_qp)
            bounds[kind] = max(bounds[kind], at_most)
    return gains, bounds


def level_gains(
    stack: Stack, velocity: Array, configuration: pink.Configuration
) -> Iterator[tuple[float | None, float]]:
    """Yield how much better each level could be, as long as anything is free.

    By how much the norm of what it misses falls by a QP of its own, None where that was
    not solved, and at most, by duality.
    """
    above = np.zeros((0, velocity.size))
    for level in solved_levels(stack, velocity):
        rows, rates, end = level
        free = _free(above)
        above = np.vstack((above, rows))
        if not free.size:
            return
        lower = np.fmin(stack.bounds[0] - end, 0.0)
        upper = np.fmax(stack.bounds[1] - end, 0.0)
        room = np.array([lower, upper])
        missing = rates - rows @ end
        change = solve_level_by_qp(level, free, room, configuration)
        by_qp = None
        if change is not None:
            better = missing - rows @ _within(room, change)
            by_qp = float(np.linalg.norm(missing) - np.linalg.norm(better))
        yield by_qp, _most_gain(missing, rows, free, room)


def solve_level_by_qp(
    level: "tuple[Array, Array, Array]",
    free: Array,
    room: Array,
    configuration: pink.Configuration,
) -> Array | None:
    """Return the change of velocity that serves a level best; None if unsolved."""
    rows, rates, velocity = level
    task = Rows(rows, rates)
    qp = pink.build_ik(configuration, [task], 1.0, 1e-12, [])
    problem = qpsolvers.Problem(
        free.T @ qp.P @ free,
        free.T @ (qp.P @ velocity + qp.q),
        np.vstack((free, -free)),
        np.concatenate((room[1], -room[0])),
    )
    solution = qpsolvers.solve_problem(problem, "daqp", primal_tol=1e-9)
    return None if solution.x is None else free @ solution.x


Level = tuple[Array, Array, Array]
"""Rows of a level, of length one, what they are to give, and the joint velocities at
its end."""


def solved_levels(stack: Stack, velocity: Array) -> Iterator[Level]:
    """Yield each level of a stack with the velocity at its end."""
    end = np.clip(0.0, *stack.bounds)
    free = np.eye(velocity.size)
    all_met = np.linalg.norm(stack.rows @ velocity - stack.rates) < 1e-9
    for rows, rates in (*stack.levels, (np.eye(velocity.size), stack.joint_velocity)):
        length = np.maximum(np.linalg.norm(rows, axis=1), 1e-9)
        level = rows / length[:, None], rates / length
        if free.size and not all_met:
            end, free = solve_level(*level, free, stack.bounds, end)
        yield *level, velocity if all_met else end


def _most_gain(missing: Array, rows: Array, free: Array, room: Array) -> float:
    """Return by how much a level's norm can fall at most, by the dual of its QP.

    Any pushes p >= 0 of the bounds on the joints bound it: what they leave of the
    gradient can at most move every joint through its box. The pushes are the best of
    `nnls`.
    """
    gradient = free.T @ (rows.T @ missing)
    ends = np.concatenate((room[1], -room[0]))
    sides = np.hstack((free.T, -free.T))
    pushes, _ = nnls(np.vstack((sides, 1e-3 * ends)), np.append(gradient, 0.0))
    remaining = np.abs(free @ (sides @ pushes - gradient)) @ (room[1] - room[0])
    return float(remaining + pushes @ ends) / max(float(np.linalg.norm(missing)), 1e-9)


def _free(rows: Array) -> Array:
    """Return orthonormal directions that no row sees, in columns."""
    _, sizes, turned = np.linalg.svd(rows)
    return turned[np.count_nonzero(sizes > 1e-12 * sizes.max(initial=0.0)) :].T


def _within(room: Array, way: Array) -> Array:
    """Return the part of a way that bounds allow but for rounding.

    Near singular postures a way along which a joint passes its bound by 1e-13 gains
    0.001 rad/s.
    """
    room = room + np.array([[-1e-16], [1e-16]])
    ends = np.where(way > 0.0, room[1], room[0])
    parts = ends[way != 0.0] / way[way != 0.0]
    return min(float(parts.min(initial=1.0)), 1.0) * way


def hostile_ticks(
    robot: Robot, rng: np.random.Generator, count: int
) -> tuple[Array, int]:
    """Return how far commands pass limits, and how many ticks have no answer.

    The limits are those of position, speed and change of speed.
    """
    stacks = RandomStacks(robot, rng)
    control = Controller(robot, stacks.limits)
    q = np.array(LWR_POSTURE_rad)
    tasks = []
    last_rad_s = np.zeros(robot.nv)
    over = np.full(3, -np.inf)
    silent = 0
    step_s = 1e-3
    for tick in range(count):
        if tick % 200 == 0:
            stacks.tool.update(q)
            tasks = stacks.tasks()
        elapsed_s, dt_s, seen_rad = hostile_sample(q, rng)
        last_step_s, step_s = (
            step_s,
            min(dt_s, MAX_STEP_s) if dt_s > 0.0 else step_s,
        )
        q = q + elapsed_s * last_rad_s
        dq = control.update(ArmSample(dt_s, seen_rad, None, seen_rad), tasks).dq_rad_s
        silent += not np.isfinite(dq).all()
        acceleration_rad_s2 = stacks.limits.joints.acceleration_rad_s2
        change = np.abs(dq - last_rad_s) - acceleration_rad_s2 * max(
            step_s, last_step_s
        )
        beyond = np.maximum(robot.position_lower_rad - q, q - robot.position_upper_rad)
        speed = np.abs(dq) - robot.velocity_limit_rad_s
        over = np.maximum(over, [beyond.max(), speed.max(), change.max()])
        last_rad_s = dq
    return over, silent


def hostile_sample(q: Array, rng: np.random.Generator) -> tuple[float, float, Array]:
    """Draw time that passes, time that is reported, and positions.

    They are late, leap, or are none.
    """
    elapsed_s = float(rng.choice((1e-3, 5e-3, 0.02), p=(0.99, 0.007, 0.003)))
    dt_s = elapsed_s
    seen_rad = q + 1e-5 * rng.standard_normal(q.size)
    kind = rng.random()
    if kind < 0.005:
        dt_s = float(rng.choice((0.0, -1.0, 1e3, np.nan)))
    elif kind < 0.01:
        seen_rad = seen_rad + 0.05 * rng.standard_normal(q.size)
    elif kind < 0.015:
        seen_rad = seen_rad[:3] if kind < 0.0125 else np.full(q.size, np.nan)
    return elapsed_s, dt_s, seen_rad
