"""Strict priority and hard limits, over random stacks of tasks and against hostile
input.

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
from numpy.typing import NDArray
from pink.tasks import Task as PinkTask  # pyright: ignore[reportMissingImports]
from scipy.optimize import nnls

from benchmarks.control.published import solve_published
from benchmarks.results import Measurement, Method, our_measurement
from groundtruth.arm_motion import LWR_POSTURE_rad
from groundtruth.rig_arm import ArmSample
from needleforce.control.controller import Controller
from needleforce.control.joint_limits import Limits, write_velocity_bounds
from needleforce.control.priority_solver import (
    Solver,
    Stack,
    hierarchical,
    solve_level,
)
from needleforce.control.tasks import (
    AxialSpeed,
    DecoupledMotion,
    Fixture,
    MAX_STEP_s,
    Posture,
    RemoteCentre,
    Task,
    TipVelocity,
    ToolState,
)
from urdf import NeedleTool, Robot, load_lwr

Array = NDArray[np.float64]
CASES = ("leak", "cascade", "hostile")
STACKS = 5_000
CASCADES = 250
TICKS = 50_000
"""Of one seed: with 20 seeds 1e5 stacks and 1e6 ticks."""
POSTURES = ("regular", "singular")
"""Kinds of drawn postures, in this order; the second is within 0.01 rad of one."""
SINGULAR_JOINTS = (1, 3, 5)
"""Near zero the LWR is stretched, or two of its axes are one."""


def measure(case: str, plant: str, seed: int) -> Iterator[Measurement]:
    """Yield the numbers of one case and seed; no plant plays a part."""
    del plant
    rng = np.random.default_rng(seed)
    robot = load_lwr(payload=NeedleTool())
    measures = {"leak": leaks, "cascade": cascades, "hostile": hostile_ticks}
    return measures[case](robot, rng)


class RandomStacks:
    """Postures, stacks of tasks and boxes, drawn without end."""

    def __init__(self, robot: Robot, rng: np.random.Generator) -> None:
        self.robot = robot
        self.rng = rng
        self.limits = Limits(robot)
        self.tool = ToolState(robot)

    def posture(self, is_singular: bool) -> Array:
        """Joint positions within limits."""
        rng = self.rng
        joints = self.limits.joints
        q = rng.uniform(joints.position_lower_rad, joints.position_upper_rad)
        if is_singular:
            joint = rng.choice(SINGULAR_JOINTS)
            q[joint] = rng.choice((-1.0, 1.0)) * 10.0 ** rng.uniform(-9.0, -2.0)
        return q

    def tasks(self) -> list[Task]:
        """Two to four tasks, in any order, then a posture, around where the tool is."""
        rng = self.rng
        tool = self.tool
        near = tool.tip_m + 1e-3 * rng.standard_normal(3)
        speed = 10.0 ** rng.uniform(-3.0, 0.0)
        turn = DecoupledMotion(tool)
        turn.move(tool, np.zeros(3), speed * rng.standard_normal(3), 1e-3)
        kinds: list[Task] = [
            RemoteCentre(near - rng.uniform(0.02, 0.2) * tool.axis),
            Fixture(near, tool.rotation),
            TipVelocity(speed * rng.standard_normal(3)),
            turn,
            AxialSpeed(speed * rng.standard_normal()),
        ]
        chosen = rng.permutation(len(kinds))[: rng.integers(2, 5)]
        joints = self.limits.joints
        goal = rng.uniform(
            joints.position_lower_rad - 0.5, joints.position_upper_rad + 0.5
        )
        return [*(kinds[k] for k in chosen), Posture(goal)]

    def draw(self, is_singular: bool) -> tuple[list[Task], Array]:
        """Tasks at a new posture, and the velocity commanded last."""
        q = self.posture(is_singular)
        self.tool.update(q)
        fraction = self.rng.choice((0.0, 0.01, 0.3, 1.0))
        speed_rad_s = self.limits.joints.speed_rad_s
        last = fraction * speed_rad_s * self.rng.uniform(-1.0, 1.0, q.size)
        return self.tasks(), last


def solved(
    stacks: RandomStacks,
    tasks: Sequence[Task],
    last: Array,
    solve: Solver = hierarchical,
) -> tuple[Stack, Array]:
    """Numbers of the first levels of a stack, and the velocity that serves them."""
    stack = Stack(tasks, last.size)
    stack.fill(tasks, stacks.tool)
    write_velocity_bounds(
        stacks.limits.joints, stacks.tool.q_rad, last, 1e-3, stack.bounds
    )
    return stack, solve(stack)[0]


def leaks(robot: Robot, rng: np.random.Generator) -> Iterator[Measurement]:
    """How far lower tasks move what higher ones get."""
    solvers: dict[Method, Solver] = {"ours": hierarchical, "published": solve_published}
    for method, solver in solvers.items():
        stacks = RandomStacks(robot, np.random.default_rng(rng.integers(2**32)))
        worst = [0.0, 0.0]
        for index in range(STACKS):
            is_singular = bool(index % 2)
            tasks, last = stacks.draw(is_singular)
            _, full = solved(stacks, tasks, last, solver)
            for count in range(1, len(tasks)):
                stack, alone = solved(stacks, tasks[:count], last, solver)
                leak = float(
                    np.abs(stack.rows[: stack.rates.size] @ (full - alone)).max()
                )
                worst[is_singular] = max(worst[is_singular], leak)
        for posture, leak in zip(POSTURES, worst, strict=True):
            yield Measurement("virtual", method, f"task_leak_{posture}_rad_per_s", leak)


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
        """What is missing, which pink's sign convention makes -v."""
        return -self.rates

    def compute_jacobian(self, configuration: pink.Configuration) -> Array:
        """The rows."""
        return self.jacobian


def cascades(robot: Robot, rng: np.random.Generator) -> Iterator[Measurement]:
    """How much better than ours each level can be, given what the levels above leave to
    it.

    Each is judged where it ends. The levels below keep what it has got, see `leaks`,
    but may pass a bound by 1e-8 rad/s; where a level would gain 1e6 times as much, a QP
    that starts from there takes that for room.
    """
    stacks = RandomStacks(robot, rng)
    worst = [0.0, 0.0]
    bound = [0.0, 0.0]
    unsolved = 0
    for index in range(CASCADES):
        tasks, last = stacks.draw(bool(index % 2))
        stack, whole = solved(stacks, tasks, last)
        configuration = pink.Configuration(
            robot.model, robot.create_data(), stacks.tool.q_rad
        )
        above = np.zeros((0, whole.size))
        for rows, rates, velocity in _levels(stack, whole):
            free = _free(above)
            level = Rows(rows, rates)
            above = np.vstack((above, rows))
            if not free.size:
                break
            room = np.array(
                [np.fmin(stack.bounds[0] - velocity, 0.0), stack.bounds[1] - velocity]
            )
            room[1] = np.fmax(room[1], 0.0)
            qp = pink.build_ik(configuration, [level], 1.0, 1e-12, [])
            problem = qpsolvers.Problem(
                free.T @ qp.P @ free,
                free.T @ (qp.P @ velocity + qp.q),
                np.vstack((free, -free)),
                np.concatenate((room[1], -room[0])),
            )
            found = qpsolvers.solve_problem(problem, "daqp", primal_tol=1e-9)
            missing = rates - rows @ velocity
            if found.x is not None:
                better = missing - rows @ _within(room, free @ found.x)
                gain = float(np.linalg.norm(missing) - np.linalg.norm(better))
                worst[index % 2] = max(worst[index % 2], gain)
            unsolved += found.x is None
            bound[index % 2] = max(
                bound[index % 2], _most_gain(missing, rows, free, room)
            )
    for k, posture in enumerate(POSTURES):
        yield our_measurement(f"cascade_gain_{posture}_rad_per_s", worst[k])
        yield our_measurement(f"duality_gain_{posture}_rad_per_s", bound[k])
    yield our_measurement("cascade_levels_unsolved", unsolved)


def _levels(stack: Stack, velocity: Array) -> Iterator[tuple[Array, Array, Array]]:
    """Rows of length one and rates of each level, and the velocity at its end."""
    end = np.clip(0.0, *stack.bounds)
    free = np.eye(velocity.size)
    all_met = np.linalg.norm(stack.rows @ velocity - stack.rates) < 1e-9
    for rows, rates in (*stack.levels, (np.eye(velocity.size), stack.wish)):
        length = np.maximum(np.linalg.norm(rows, axis=1), 1e-9)
        level = rows / length[:, None], rates / length
        if free.size and not all_met:
            end, free = solve_level(*level, free, stack.bounds, end)
        yield *level, velocity if all_met else end


def _most_gain(missing: Array, rows: Array, free: Array, room: Array) -> float:
    """By how much a level's norm can fall, from above, by the dual of its QP.

    Any pushes p >= 0 of the bounds on the joints bound it: what they leave of the
    gradient can at most move every joint through its box. The pushes are the best of
    `nnls`.
    """
    gradient = free.T @ (rows.T @ missing)
    ends = np.concatenate((room[1], -room[0]))
    sides = np.hstack((free.T, -free.T))
    pushes, _ = nnls(np.vstack((sides, 1e-3 * ends)), np.append(gradient, 0.0))
    left = np.abs(free @ (sides @ pushes - gradient)) @ (room[1] - room[0])
    return float(left + pushes @ ends) / max(float(np.linalg.norm(missing)), 1e-9)


def _free(rows: Array) -> Array:
    """Orthonormal directions that no row sees, in columns."""
    _, sizes, turned = np.linalg.svd(rows)
    return turned[np.count_nonzero(sizes > 1e-12 * sizes.max(initial=0.0)) :].T


def _within(room: Array, way: Array) -> Array:
    """The part of a way that bounds allow but for rounding.

    Near singular postures a way along which a joint passes its bound by 1e-13 gains
    0.001 rad/s.
    """
    room = room + np.array([[-1e-16], [1e-16]])
    ends = np.where(way > 0.0, room[1], room[0])
    parts = ends[way != 0.0] / way[way != 0.0]
    return min(float(parts.min(initial=1.0)), 1.0) * way


def hostile_ticks(robot: Robot, rng: np.random.Generator) -> Iterator[Measurement]:
    """How far commands pass a limit, and how many ticks go without an answer."""
    stacks = RandomStacks(robot, rng)
    control = Controller(robot, stacks.limits)
    q = np.array(LWR_POSTURE_rad)
    tasks = []
    before = np.zeros(robot.nv)
    over = np.full(3, -np.inf)
    silent = 0
    step_s = 1e-3
    for tick in range(TICKS):
        if tick % 200 == 0:
            stacks.tool.update(q)
            tasks = stacks.tasks()
        elapsed_s, dt_s, seen = _hostile_sample(q, rng)
        last_step_s, step_s = (
            step_s,
            min(dt_s, MAX_STEP_s) if dt_s > 0.0 else step_s,
        )
        q = q + elapsed_s * before
        dq = control.update(ArmSample(dt_s, seen, None, seen), tasks).dq_rad_s
        silent += not np.isfinite(dq).all()
        change = np.abs(dq - before) - stacks.limits.joints.acceleration_rad_s2 * max(
            step_s, last_step_s
        )
        beyond = np.maximum(robot.position_lower_rad - q, q - robot.position_upper_rad)
        speed = np.abs(dq) - robot.velocity_limit_rad_s
        over = np.maximum(over, [beyond.max(), speed.max(), change.max()])
        before = dq
    yield our_measurement("hostile_position_excess_rad", over[0])
    yield our_measurement("hostile_speed_excess_rad_per_s", over[1])
    yield our_measurement("hostile_speed_change_excess_rad_per_s", over[2])
    yield our_measurement("hostile_ticks_without_answer", silent)


def _hostile_sample(q: Array, rng: np.random.Generator) -> tuple[float, float, Array]:
    """Time that passes, time that is reported, positions that are reported."""
    elapsed_s = float(rng.choice((1e-3, 5e-3, 0.02), p=(0.99, 0.007, 0.003)))
    dt_s = elapsed_s
    seen = q + 1e-5 * rng.standard_normal(q.size)
    kind = rng.random()
    if kind < 0.005:
        dt_s = float(rng.choice((0.0, -1.0, 1e3, np.nan)))
    elif kind < 0.01:
        seen = seen + 0.05 * rng.standard_normal(q.size)
    elif kind < 0.015:
        seen = seen[:3] if kind < 0.0125 else np.full(q.size, np.nan)
    return elapsed_s, dt_s, seen
