"""Strict priorities within hard limits: a hierarchical quadratic program.

    lexmin_dq (|J_1 dq - v_1|, |J_2 dq - v_2|, ..., |dq - w|)   subject to  l <= dq <= u

with limits l and u of the joints, and a velocity w of theirs that comes last, zero or
towards a posture (Kanoun et al., IEEE T-RO 2011). Norms are of rows scaled to length
one: a row counts by how far joints move for it.
"""

import itertools
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.arrays import Array, Matrix, Vector, WrittenVector
from foundation.jit import compiled, compiled_inside
from foundation.linear_algebra import dot
from needleforce.control.errors import SettingError
from needleforce.control.joint_limits import SLACK_rad_s
from needleforce.control.tasks import JointTask, Task, ToolState

MIN_NEW_PART = 0.15
"""Where less than that part of a row is new, it depends too much on those above it for
a step that meets all of them: the levels are then solved one by one, and damped where
that is needed."""

WEAK_MOTION = 0.02
"""A direction of a level that moves its rows, of length one, by less is damped."""

MAX_DAMPING = 0.02
"""Damping of a direction that hardly moves its level: a rate asks joints for at most 25
times itself."""

DETOUR_MOTION = 0.01
"""Along a direction that moves the rows by so little, or less, joints are slowed to
`MAX_DETOUR_rad_s`."""

MAX_DETOUR_rad_s = 0.4
"""Speed of the joints together along such a direction, at most: far motion for a small
gain, which surprises those who stand beside the arm."""

INEFFECTIVE_MOTION = 0.1
"""Along a direction that moves the rows by less a level does not make up for what the
levels above ask for, nor joints for others that are held."""

MIN_ROW_LENGTH = 1e-9
"""Shorter rows are not scaled to length one: joints hardly move what they ask for."""

MIN_MOTION = 1e-13
"""A direction that moves a row of length one by less does not move it."""

RANK_TOLERANCE = 1e-8
"""Singular values of a level, relative to the largest, below which it counts as
singular: there joints would move far for a gain that is rounding."""

PUSH_TOLERANCE = 1e-12
"""The same where pushes of bounds are found; these rows are nearly orthonormal."""

AT_LIMIT_rad_s = 1e-6
"""A joint so near to a bound counts as being at it."""

BEYOND_rad_s = 1e-8
"""By so much a joint may pass its bound, within `SLACK_rad_s`."""

MAX_CHANGES = 60
"""Changes of the set of held joints in one level; then the velocity at hand is kept."""

STAND_IN_DAMPING = 0.1
"""Damping of joints that stand in for others at a bound: along a direction that moves
the rows by 0.01 they make up for a hundredth of what is lacking."""

MAX_STAND_IN_SOLUTIONS = 3
"""Solutions of a level at most, each with more joints known to be at a bound."""

MIN_GAIN = 1e-12
"""A joint that gains less by being released stays held: that is rounding."""


class Stack:
    """The numbers of a stack of tasks, in arrays that are used over and over.

    Args:
        tasks: The first one is the most important.
        joints: Number n of joints.

    Attributes:
        rows: J of all tasks but a last one that asks for joint velocities, shape
            (m, n).
        rates: v of them, shape (m,).
        joint_velocity: w, shape (n,): what a last task of this kind asks for, which
            needs no rows; else zero.
        bounds: l and u, shape (2, n), for its user to fill in.
        levels: Rows and rates of each task, views of the above.
        is_damped: Whether the solver has damped a direction; for it to fill in.

    Raises:
        SettingError: A task is for another number of joints.
    """

    def __init__(self, tasks: Sequence[Task], joints: int) -> None:
        for task in tasks:
            if isinstance(task, JointTask) and task.size != joints:
                raise SettingError(
                    f"a task of {task.size} joints, the robot has {joints}"
                )
        has_joint_task = bool(tasks) and isinstance(tasks[-1], JointTask)
        sizes = [task.size for task in (tasks[:-1] if has_joint_task else tasks)]
        self.rows = np.zeros((sum(sizes), joints))
        self.rates = np.zeros(sum(sizes))
        self.joint_velocity = np.zeros(joints)
        self.bounds = np.zeros((2, joints))
        self.is_damped = False
        ends = itertools.pairwise(itertools.accumulate(sizes, initial=0))
        self.levels = [
            (self.rows[start:end], self.rates[start:end]) for start, end in ends
        ]

    def fill(self, tasks: Sequence[Task], tool: ToolState) -> None:
        """Fill in rows, rates and velocities of tasks of the same sizes."""
        for task, (rows, rates) in zip(tasks, self.levels, strict=False):
            task.write(tool, rows, rates)
        if tasks and isinstance(lowest := tasks[-1], JointTask):
            self.joint_velocity = lowest.velocity_at(tool.q_rad)


class Level(NamedTuple):
    """A level to be solved, with rows J dq = v that damp it beside its own.

    Attributes:
        rows: J, shape (m, n).
        rates: v, shape (m,).
        free: N, orthonormal directions in columns, that move no row of the levels
            above, shape (n, k).
        unbounded: What this level and those above ask for without bounds, shape (n,).
    """

    rows: Array
    rates: Array
    free: Array
    unbounded: Array


Solver = Callable[[Stack], tuple[Array, bool]]
"""Joint velocities for a stack, in an array of their own, and whether one is at a
limit."""


def hierarchical(stack: Stack) -> tuple[Array, bool]:
    """Return joint velocities in strict priority within hard limits; see `Solver`.

    If all rows can be met within the limits, they are. Otherwise each level moves
    within the null space N of the rows above it, which therefore keep what they have
    achieved:

        dq_k = dq_{k-1} + N y,  min_y |J_k N y - (v_k - J_k dq_{k-1})|,  l <= dq_k <= u

    Directions that hardly move a level are damped, see `find_damping`, and go along
    with the levels above, see `plan_levels`; all others are exact.
    """
    stack.is_damped = False
    velocity = stack.joint_velocity.copy()
    if meet_all_rows(stack.rows, stack.rates, stack.bounds, velocity):
        return velocity, False
    velocities = (*stack.rates, *stack.joint_velocity)
    if not (np.isfinite(stack.rows).all() and np.isfinite(velocities).all()):
        raise SettingError("positions or goals are not finite")
    levels, unbounded = plan_levels(stack)
    lower, upper = stack.bounds
    if (lower < unbounded).all() and (unbounded < upper).all():
        return unbounded, False
    # The start depends on no lower task, so that none can matter to a higher one.
    velocity = np.minimum(np.maximum(0.0, lower), upper)
    for level in levels:
        velocity = solve_bounded_level(level, stack.bounds, velocity)
    velocity = np.minimum(
        np.maximum(velocity, lower - SLACK_rad_s), upper + SLACK_rad_s
    )
    return velocity, bool(find_held_joints(velocity, stack.bounds).any())


def plan_levels(stack: Stack) -> tuple[list[Level], Array]:
    """Return levels to be solved within bounds, and the velocity without bounds, (n,).

    A level can hardly make up for what those above ask for, x, where that takes far
    motion, and goes along with it. By a left singular vector u of J N, with the
    singular value σ, it asks for

        u^T v + (1 - b) u^T J x,    b = min(σ/σ₁, 1)²    (σ₁: `INEFFECTIVE_MOTION`)

    Else an error of an entry, K e, turns a needle whose tip is at a small depth d by
    K e/d, and the loop swings: joints that are late by some time and a lever L move the
    entry by L K e/d times that.
    """
    joints = stack.joint_velocity.size
    asked = np.zeros(joints)
    free = np.eye(joints)
    levels = list[Level]()
    for rows, rates in [*stack.levels, (free, stack.joint_velocity)]:
        if not free.size:
            break
        length = np.maximum(np.sqrt((rows * rows).sum(axis=1)), MIN_ROW_LENGTH)
        rows = rows / length[:, None]
        rates = rates / length
        parts, motion, directions = np.linalg.svd(rows @ free)
        parts = parts[:, : motion.size]
        joint_directions = directions[: motion.size] @ free.T
        compensated = np.minimum(motion / INEFFECTIVE_MOTION, 1.0) ** 2
        asked_above = rows @ asked
        rates = rates + parts @ ((1.0 - compensated) * (parts.T @ asked_above))
        errors = parts.T @ (rates - asked_above)
        damping = find_damping(motion, errors)
        gain = np.zeros(motion.size)
        np.divide(motion, motion**2 + damping**2, out=gain, where=motion > MIN_MOTION)
        asked = asked + (gain * errors) @ joint_directions
        is_damped = damping > 0.0
        stack.is_damped = stack.is_damped or bool(is_damped.any())
        damping_rows = damping[is_damped, None] * joint_directions[is_damped]
        all_rows = np.vstack((rows, damping_rows))
        all_rates = np.concatenate((rates, np.zeros(len(damping_rows))))
        levels.append(Level(all_rows, all_rates, free, asked))
        rank = np.count_nonzero(motion > MIN_MOTION)
        free = np.ascontiguousarray(free @ directions[rank:].T)
    return levels, asked


def find_damping(motion: Array, errors: Array) -> Array:
    """Return damping that keeps joints from moving far for a gain that is small.

    Along a right singular vector v of J N, with the singular value σ and the part e of
    the errors, a level asks joints for e/σ. One more row λ (N v)ᵀ, which asks for rest,
    makes that e σ/(σ² + λ²), with the larger of

        λ = λ_max (1 - (σ/σ₀)²)      below σ₀ (`WEAK_MOTION`)
        λ² = |e| σ/w - σ²            where |e|/σ exceeds w
        w = w_max max(1, σ/σ_d)²     with `MAX_DETOUR_rad_s` and `DETOUR_MOTION`

    (Nakamura and Hanafusa, ASME J. Dyn. Syst. 1986; Chiaverini, IEEE T-RA 1997). Both
    are zero, and the level exact, elsewhere.

    Args:
        motion: σ, shape (k,).
        errors: e, shape (k,).

    Returns:
        λ, shape (k,).
    """
    weakness = np.maximum(1.0 - (motion / WEAK_MOTION) ** 2, 0.0)
    highest_rad_s = MAX_DETOUR_rad_s * np.maximum(motion / DETOUR_MOTION, 1.0) ** 2
    too_fast = np.abs(errors) * motion / highest_rad_s - motion**2
    excess = np.sqrt(np.maximum(too_fast, 0.0))
    return np.where(motion > MIN_MOTION, np.maximum(MAX_DAMPING * weakness, excess), 0)


def solve_bounded_level(level: Level, bounds: Array, start: Array) -> Array:
    """Solve a level, see `solve_level`, and keep joints from standing in for others.

    Where joints are held at a bound, the rest might move far to make up for them: a
    joint about the needle, for a hub that is nearly on its axis. So rows are added that
    ask for the motion without bounds along what is free then and hardly moves the
    level: by v, with the singular value σ, λ (N v)ᵀ with

        λ = λ_s (1 - (σ/σ₁)²)      below σ₁ (`INEFFECTIVE_MOTION`)
    """
    rows, rates, free, unbounded = level
    velocity = start
    is_held = (unbounded <= bounds[0]) | (unbounded >= bounds[1])
    for _ in range(MAX_STAND_IN_SOLUTIONS):
        remaining = free @ null_space(free[is_held])
        _, motion, directions = np.linalg.svd(rows @ remaining, full_matrices=False)
        damping = STAND_IN_DAMPING * (1.0 - (motion / INEFFECTIVE_MOTION) ** 2)
        is_damped = (damping > 0.0) & (motion > MIN_MOTION)
        held_back = damping[is_damped, None] * (directions[is_damped] @ remaining.T)
        rows = np.vstack((rows, held_back))
        rates = np.concatenate((rates, held_back @ unbounded))
        velocity, _ = solve_level(rows, rates, free, bounds, start)
        now_held = is_held | find_held_joints(velocity, bounds)
        if (now_held == is_held).all():
            break
        is_held = now_held
    return velocity


def find_held_joints(velocity: Array, bounds: Array) -> NDArray[np.bool_]:
    """Return which joints are at a bound, shape (n,)."""
    room = np.minimum(velocity - bounds[0], bounds[1] - velocity)
    return room <= AT_LIMIT_rad_s


@compiled
def meet_all_rows(
    rows: Matrix, rates: Vector, bounds: Matrix, velocity: WrittenVector
) -> bool:
    """Change a velocity as little as meets all rows; return whether bounds allow it.

    Gram-Schmidt steps, twice for accuracy, make a basis of the rows; moving along its
    i-th direction meets row i and leaves the rows before it met. False where rows
    nearly depend on each other.
    """
    joints = velocity.size
    if rates.size > joints:
        return False
    basis = np.empty((joints, joints))
    for i in range(rates.size):
        direction = basis[i]
        direction[:] = rows[i]
        row_length = math.sqrt(dot(rows[i], rows[i]))
        for j in range(2 * i):
            overlap = dot(direction, basis[j % i])
            for k in range(joints):
                direction[k] -= overlap * basis[j % i, k]
        length = math.sqrt(dot(direction, direction))
        if length < MIN_ROW_LENGTH or length < MIN_NEW_PART * row_length:
            return False
        direction /= length
        step = (rates[i] - dot(rows[i], velocity)) / dot(rows[i], direction)
        for k in range(joints):
            velocity[k] += step * direction[k]
    is_within = True
    for k in range(joints):
        is_within = is_within and bounds[0, k] < velocity[k] < bounds[1, k]
    return is_within


@compiled_inside
def null_space(rows: Matrix) -> Matrix:
    """Return orthonormal directions that move no row, in columns."""
    if rows.size == 0:
        return np.eye(rows.shape[1])
    _, singular_values, right_vectors = np.linalg.svd(rows)
    rank = (singular_values > MIN_MOTION).sum()
    return np.ascontiguousarray(right_vectors[rank:].T)


@compiled_inside
def find_blocking_joint(
    velocity: Vector, step: Vector, bounds: Matrix, held_at: Vector
) -> tuple[float, int]:
    """Return the fraction of a step that bounds allow, and the joint that ends it.

    The fraction is 0 to 1; the joint -1 if none ends it. Of joints that meet their
    bounds almost at once it is the one that moves most, so that near a singular posture
    none is held for a motion that is rounding (Harris, Math. Programming 1973).
    """
    fraction = 1.0
    joint = -1
    largest_motion = 0.0
    room = np.where(step > 0.0, bounds[1], bounds[0]) - velocity
    for k in range(step.size):
        if held_at[k] == 0.0 and step[k] != 0.0:
            reach = room[k] / step[k] + BEYOND_rad_s / abs(step[k])
            fraction = min(fraction, max(reach, 0.0))
    for k in range(step.size if fraction < 1.0 else 0):
        if (
            held_at[k] == 0.0
            and abs(step[k]) > largest_motion
            and room[k] / step[k] <= fraction
        ):
            joint = k
            largest_motion = abs(step[k])
    return (max(room[joint] / step[joint], 0.0) if joint >= 0 else 1.0), joint


@compiled_inside
def find_joint_to_release(
    held_rows: Matrix, gradient: Vector, held_at: Vector, is_first_taken: bool
) -> int:
    """Return the held joint that gains most by being released, -1 if none gains.

    Args:
        held_rows: Rows of the free directions that belong to the held joints.
        gradient: By how much the level gains along each free direction.
        held_at: -1 at the lower bound, 1 at the upper, 0 for a free joint, shape (n,).
        is_first_taken: Take the first joint that gains, not the best one.
    """
    push = np.linalg.lstsq(np.ascontiguousarray(held_rows.T), gradient, PUSH_TOLERANCE)[
        0
    ]
    joints = np.flatnonzero(held_at)
    outwards_push = push * held_at[joints]
    gaining = np.flatnonzero(outwards_push < -MIN_GAIN)
    if not gaining.size:
        return -1
    index = gaining[0] if is_first_taken else np.argmin(outwards_push)
    return joints[index]


@compiled
def solve_level(
    rows: Matrix, rates: Vector, free: Matrix, bounds: Matrix, start: Vector
) -> tuple[Array, Array]:
    """Solve one level by a primal active-set method.

    With the joints that are held at a bound the nearest velocity is a least-squares
    solution. The way there ends where another joint meets its bound, which is then held
    too. At its end that joint is released which gains most from it, the first of them
    after many changes, so that no circle can form; if none gains, the level is solved.

    Args:
        rows: J of the level, of length one each, shape (m, n).
        rates: v, shape (m,).
        free: N, orthonormal directions in columns, that move no row of the levels
            above.
        bounds: l and u, shape (2, n).
        start: Velocity of the levels above, within bounds, shape (n,).

    Returns:
        The velocity of the level, and the N of the levels below.
    """
    velocity = start.copy()
    held_at = np.zeros(start.size)
    rows_of_free = rows @ free
    for change in range(MAX_CHANGES):
        held_rows = free[held_at != 0.0]
        directions = np.ascontiguousarray(free @ null_space(held_rows))
        if directions.shape[1]:
            coefficients = np.linalg.lstsq(
                rows @ directions, rates - rows @ velocity, RANK_TOLERANCE
            )[0]
            step = directions @ coefficients
            fraction, joint = find_blocking_joint(velocity, step, bounds, held_at)
            velocity += fraction * step
            if joint >= 0:
                held_at[joint] = 1.0 if step[joint] > 0.0 else -1.0
                continue
        if not len(held_rows):
            break
        gradient = rows_of_free.T @ (rates - rows @ velocity)
        is_first_taken = change > MAX_CHANGES // 2
        joint = find_joint_to_release(held_rows, gradient, held_at, is_first_taken)
        if joint < 0:
            break
        held_at[joint] = 0.0
    return velocity, np.ascontiguousarray(free @ null_space(rows_of_free))
