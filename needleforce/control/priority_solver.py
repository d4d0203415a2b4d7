"""Strict priorities within hard limits: a hierarchical quadratic program.

    lexmin_dq (|J_1 dq - v_1|, |J_2 dq - v_2|, ..., |dq - w|)   subject to  l <= dq <= u

with limits l and u of the joints, and a velocity w of theirs that comes last, zero or
towards a posture (Kanoun et al., IEEE T-RO 2011). Norms are of rows scaled to length
one: a row counts by how far joints move for it.
"""

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple, cast

import numpy as np

from foundation.arrays import Array, Matrix, Vector, WrittenMatrix, WrittenVector
from foundation.jit import compiled, compiled_inside
from foundation.linear_algebra import (
    dot,
    find_complement,
    make_rows_orthogonal,
    multiply,
    multiply_transposed,
    multiply_vector,
    remove_parts,
    solve_least_squares,
)
from needleforce.control.errors import SettingError
from needleforce.control.joint_limits import SLACK_rad_s
from needleforce.control.tasks import JointTask, Task, ToolState

INEFFECTIVE_MOTION = 0.1
"""Along a direction that moves the rows by less a level does not make up for what the
levels above ask for, nor joints for others that are held."""

MIN_MOTION = 1e-13
"""A direction that moves a row of length one by less does not move it."""

AT_LIMIT_rad_s = 1e-6
"""A joint so near to a bound counts as being at it."""

MAX_CHANGES = 60
"""Changes of the set of held joints in one level; then the velocity at hand is kept."""


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
        level_ends: Number of rows of each task and those above it, shape (tasks,).
        is_damped: Whether the solver has damped a direction; for it to fill in.

    Raises:
        SettingError: A task is for another number of joints.
    """

    def __init__(self, tasks: Sequence[Task], joints: int) -> None:
        sizes = [task.size for task in tasks if isinstance(task, JointTask)]
        if any(size != joints for size in sizes):
            raise SettingError(f"tasks of {sizes} joints, the robot has {joints}")
        self._has_joint_task = bool(tasks) and isinstance(tasks[-1], JointTask)
        row_tasks = tasks[:-1] if self._has_joint_task else tasks
        sizes = [task.size for task in row_tasks]
        self.rows = np.zeros((sum(sizes), joints))
        self.rates = np.zeros(sum(sizes))
        self.joint_velocity = np.zeros(joints)
        self.bounds = np.zeros((2, joints))
        self.is_damped = False
        ends = list(itertools.accumulate(sizes, initial=0))
        self.level_ends = np.array(ends[1:], np.float64)
        self.levels = [
            (self.rows[start:end], self.rates[start:end])
            for start, end in itertools.pairwise(ends)
        ]

    def fill(self, tasks: Sequence[Task], tool: ToolState) -> None:
        """Fill in rows, rates and velocities of tasks of the same sizes."""
        for task, (rows, rates) in zip(tasks, self.levels, strict=False):
            task.write(tool, rows, rates)
        if self._has_joint_task:
            lowest = cast(JointTask, tasks[-1])
            self.joint_velocity[:] = lowest.velocity_at(tool.q_rad)


class PlannedLevel(NamedTuple):
    """A level without bounds, and what it leaves to those below.

    Attributes:
        rows: J of rows J dq = v, those that damp the level last, shape (m, n).
        rates: v, shape (m,).
        rank: Number of orthonormal directions, in the basis, that move this level or
            those above.
    """

    rows: Matrix
    rates: Vector
    rank: int


def hierarchical(stack: Stack) -> tuple[Array, bool]:
    """Return joint velocities in strict priority, and whether one is at a limit.

    Without bounds each level takes from what is asked for, see `plan_level`. If that is
    within the limits, it is the velocity. Otherwise each level moves within the null
    space N of the rows above it, which therefore keep what they have achieved:

        dq_k = dq_{k-1} + N y,  min_y |J_k N y - (v_k - J_k dq_{k-1})|,  l <= dq_k <= u

    Directions that hardly move a level are damped, see `find_damping`, and go along
    with the levels above; all others are exact.
    """
    velocity = np.empty(stack.joint_velocity.size)
    is_within, is_damped = solve_without_bounds(
        stack.rows,
        stack.rates,
        stack.level_ends,
        stack.joint_velocity,
        stack.bounds,
        velocity,
    )
    stack.is_damped = is_damped
    if is_within:
        return velocity, False
    if not (
        np.isfinite(stack.rows).all()
        and np.isfinite((*stack.rates, *stack.joint_velocity)).all()
    ):
        raise SettingError("positions or goals are not finite")
    is_limited = solve_within_bounds(
        stack.rows,
        stack.rates,
        stack.level_ends,
        stack.joint_velocity,
        stack.bounds,
        velocity,
    )
    return velocity, is_limited


@compiled
def solve_without_bounds(
    rows: Matrix,
    rates: Vector,
    level_ends: Vector,
    joint_velocity: Vector,
    bounds: Matrix,
    velocity: WrittenVector,
) -> tuple[bool, bool]:
    """Write what a stack asks for where no bound is in the way.

    Args:
        rows: J of all levels, shape (m, n).
        rates: v of them, shape (m,).
        level_ends: Rows of a level and those above it, shape (number of levels,).
        joint_velocity: w, what is asked for last, shape (n,).
        bounds: l and u, shape (2, n).
        velocity: To be written, shape (n,).

    Returns:
        Whether it is within the bounds, and whether a direction is damped.
    """
    basis = np.empty((velocity.size, velocity.size))
    rank = 0
    start = 0
    is_damped = False
    velocity[:] = 0.0
    for level_end in level_ends:
        end = int(level_end)
        if rank < velocity.size:
            level = plan_level(rows[start:end], rates[start:end], basis, rank, velocity)
            rank = level.rank
            is_damped = is_damped or level.rates.size > end - start
        start = end
    follow_where_free(joint_velocity, basis, rank, velocity)
    is_within = ((bounds[0] < velocity) & (velocity < bounds[1])).all()
    return bool(is_within), is_damped


@compiled
def solve_within_bounds(
    rows: Matrix,
    rates: Vector,
    level_ends: Vector,
    joint_velocity: Vector,
    bounds: Matrix,
    velocity: WrittenVector,
) -> bool:
    """Write the velocity of a stack of which bounds cut something.

    Args and what is written as of `solve_without_bounds`.

    Returns:
        Whether a joint is at a bound.
    """
    joints = velocity.size
    basis = np.empty((joints, joints))
    rank = 0
    start = 0
    asked = np.zeros(joints)
    # The start depends on no lower task, so that none can matter to a higher one.
    velocity[:] = np.minimum(np.maximum(0.0, bounds[0]), bounds[1])
    for level_end in level_ends:
        end = int(level_end)
        if rank < joints:
            free = np.ascontiguousarray(find_complement(basis, rank).T)
            planned = plan_level(rows[start:end], rates[start:end], basis, rank, asked)
            velocity[:] = solve_bounded_level(
                planned.rows, planned.rates, free, asked, bounds, velocity
            )
            rank = planned.rank
        start = end
    if rank < joints:
        free = np.ascontiguousarray(find_complement(basis, rank).T)
        follow_where_free(joint_velocity, basis, rank, asked)
        velocity[:] = solve_bounded_level(
            np.eye(joints), joint_velocity, free, asked, bounds, velocity
        )
    lowest = bounds[0] - SLACK_rad_s
    highest = bounds[1] + SLACK_rad_s
    velocity[:] = np.minimum(np.maximum(velocity, lowest), highest)
    room = np.minimum(velocity - bounds[0], bounds[1] - velocity)
    return bool((room <= AT_LIMIT_rad_s).any())


@compiled_inside
def plan_level(
    rows: Matrix,
    rates: Vector,
    basis: WrittenMatrix,
    rank: int,
    asked: WrittenVector,
) -> PlannedLevel:
    """Add to a velocity what a level asks for, and to a basis what moves its rows.

    It can hardly make up for what the levels above ask for, x, where that takes far
    motion, and goes along with it. By a left singular vector u of J N, with the
    singular value σ, it asks for

        u^T v + (1 - b) u^T J x,    b = min(σ/σ₁, 1)²    (σ₁: `INEFFECTIVE_MOTION`)

    Else an error of an entry, K e, turns a needle whose tip is at a small depth d by
    K e/d, and the loop swings: joints that are late by some time and a lever L move the
    entry by L K e/d times that. What joints hardly move is damped, see `find_damping`.

    Args:
        rows: J, shape (m, n).
        rates: v, shape (m,).
        basis: Orthonormal directions in rows, of which the first span the motion of the
            levels above, shape (n, n); those of this level are added.
        rank: Number of these directions.
        asked: x, shape (n,); becomes what this level and those above ask for.
    """
    size = rates.size
    joints = asked.size
    unit_rows, unit_rates = scale_to_unit_length(rows, rates)
    new_rows = unit_rows.copy()  # S V^T of J N N^T, once they are orthogonal
    for i in range(size):
        remove_parts(new_rows[i], basis, rank)
    # U^T of J, and of v in the last column: the level is the same after a rotation.
    rotated = np.empty((size, joints + 1))
    rotated[:, :joints] = unit_rows
    rotated[:, joints] = unit_rates
    make_rows_orthogonal(new_rows, rotated)
    above = asked.copy()
    first = rank
    damped = np.zeros(size)
    for i in range(size):
        unit_rows[i] = rotated[i, :joints]
        motion = math.sqrt(dot(new_rows[i], new_rows[i]))
        compensated = min(motion / INEFFECTIVE_MOTION, 1.0) ** 2
        asked_part = dot(unit_rows[i], above)
        unit_rates[i] = rotated[i, joints] + (1.0 - compensated) * asked_part
        if motion > MIN_MOTION and rank < joints:
            error = rotated[i, joints] - compensated * asked_part
            damping = find_damping(motion, error)
            add_direction(new_rows[i], motion, basis, rank)
            step_rad_s = motion / (motion**2 + damping**2) * error
            for k in range(joints):
                asked[k] += step_rad_s * basis[rank, k]
            damped[rank - first] = damping
            rank += 1
    dampings = damped[: rank - first]
    damping_rows = (dampings.reshape(-1, 1) * basis[first:rank])[dampings > 0.0]
    damping_rates = np.zeros(len(damping_rows))
    return PlannedLevel(
        np.vstack((unit_rows, damping_rows)),
        np.concatenate((unit_rates, damping_rates)),
        rank,
    )


@compiled_inside
def add_direction(row: Vector, length: float, basis: WrittenMatrix, rank: int) -> None:
    """Write a row of that length, scaled to one, after the first so many of a basis.

    Of a row that is hardly new the rounding counts: what it shares with them is removed
    once more.
    """
    direction = basis[rank]
    for k in range(row.size):
        direction[k] = row[k] / length
    remove_parts(direction, basis, rank)
    length = math.sqrt(dot(direction, direction))
    for k in range(row.size):
        direction[k] /= length


@compiled_inside
def follow_where_free(
    joint_velocity: Vector, basis: Matrix, rank: int, velocity: WrittenVector
) -> None:
    """Change a velocity to another where no row of the levels above moves.

    Args:
        joint_velocity: The other one, shape (n,).
        basis: Orthonormal directions in rows; the first are those of the levels.
        rank: Number of these.
        velocity: To be changed, shape (n,).
    """
    change = joint_velocity - velocity
    remove_parts(change, basis, rank)
    velocity += change


@compiled_inside
def scale_to_unit_length(rows: Matrix, rates: Vector) -> tuple[Array, Array]:
    """Return rows of length one each, and the rates that go with them, copies."""
    unit_rows = rows.copy()
    unit_rates = rates.copy()
    for i in range(rates.size):
        # Joints hardly move what a shorter row asks for.
        length = max(math.sqrt(dot(rows[i], rows[i])), 1e-9)
        unit_rates[i] /= length
        for k in range(rows.shape[1]):
            unit_rows[i, k] /= length
    return unit_rows, unit_rates


@compiled_inside
def find_damping(motion: float, error: float) -> float:
    """Return damping that keeps joints from moving far for a gain that is small.

    Along a right singular vector v of J N, with the singular value σ and the part e of
    the errors, a level asks joints for e/σ. One more row λ (N v)ᵀ, which asks for rest,
    makes that e σ/(σ² + λ²), with the larger of

        λ = λ_max (1 - (σ/σ₀)²)      below σ₀ = 0.02, with λ_max = 0.02
        λ² = |e| σ/w - σ²            where |e|/σ exceeds w, see `damp_detour`

    (Nakamura and Hanafusa, ASME J. Dyn. Syst. 1986; Chiaverini, IEEE T-RA 1997): a rate
    asks joints for at most 25 times itself. Both are zero, and the level exact,
    elsewhere.

    Args:
        motion: σ, positive.
        error: e.

    Returns:
        λ.
    """
    return max(0.02 * max(1.0 - (motion / 0.02) ** 2, 0.0), damp_detour(motion, error))


@compiled_inside
def damp_detour(motion: float, error: float) -> float:
    """Return the damping that keeps joints from moving far and fast for a small gain.

    Along a direction that moves the rows by 0.05 or less they are slowed together to
    0.3 rad/s: far motion for a small gain surprises those who stand beside the arm.
    Rows turn with the joints while a command is on its way, which moves an entry by the
    square of their speed: by 0.08 mm with a delay of 26 ms, at most, in 100 random
    poses. With more motion w grows by its square.

    Args as of `find_damping`.
    """
    highest_rad_s = 0.3 * max(motion / 0.05, 1.0) ** 2
    too_fast = abs(error) * motion / highest_rad_s - motion**2
    return math.sqrt(max(too_fast, 0.0))


@compiled_inside
def solve_bounded_level(
    rows: Matrix,
    rates: Vector,
    free: Matrix,
    unbounded: Vector,
    bounds: Matrix,
    start: Vector,
) -> Array:
    """Solve a level, see `solve_level`; damp what remains where bounds take joints.

    A joint that a bound keeps from what it is asked for is a lost freedom. The rest may
    then be as near to a singular posture as an arm that lacks this joint, and would
    move far to make up for it: two joints against each other, where the elbow between
    them is at its stop. So rows are added that ask for the motion without bounds along
    what remains and hardly moves the level.

    Args:
        rows: J of the level and of what damps it, shape (m, n).
        rates: v of them, shape (m,).
        free: N, orthonormal directions in columns, that move no row of the levels
            above, shape (n, k).
        unbounded: What this level and those above ask for without bounds, shape (n,).
        bounds: l and u, shape (2, n).
        start: Velocity of the levels above, within bounds, shape (n,).

    Returns:
        The velocity of the level, shape (n,).
    """
    velocity = start.copy()
    asked = np.minimum(np.maximum(unbounded, bounds[0]), bounds[1])
    lost = np.where(unbounded != asked, 1.0, 0.0)
    for solution in range(3):  # each with more joints known to be at a bound
        errors = rates - multiply_vector(rows, asked)
        damping_rows = damp_stand_ins(rows, errors, free, lost)
        if solution > 0 and not len(damping_rows):
            break
        rows = np.vstack((rows, damping_rows))
        rates = np.concatenate((rates, multiply_vector(damping_rows, unbounded)))
        velocity = solve_level(rows, rates, free, bounds, start)
        room = np.minimum(velocity - bounds[0], bounds[1] - velocity)
        # At the other bound it stands in for others.
        is_asked = np.abs(velocity - asked) <= AT_LIMIT_rad_s
        is_lost = (room <= AT_LIMIT_rad_s) & (is_asked | (asked == unbounded))
        if (is_lost == (lost != 0.0)).all():
            break
        lost = np.where(is_lost, 1.0, 0.0)
    return velocity


@compiled_inside
def damp_stand_ins(rows: Matrix, errors: Vector, free: Matrix, lost: Vector) -> Array:
    """Return rows λ (N v)ᵀ that damp directions v which hardly move a level, (r, n).

    With the singular value σ of the level along v, λ is the larger of that of
    `damp_detour` and

        λ = λ_s (1 - (σ/σ₁)²)      below σ₁ (`INEFFECTIVE_MOTION`), with λ_s = 0.1

    Along a direction that moves the rows by 0.01 joints then make up for a hundredth of
    what is lacking.

    Args:
        rows: Of the level, shape (m, n).
        errors: What its rates lack, shape (m,).
        free: N, shape (n, k).
        lost: 1 for a joint that cannot move, 0 for others, shape (n,).
    """
    remaining = multiply(free, null_space(free[lost != 0.0]))
    if not remaining.shape[1]:
        return np.zeros((0, len(free)))
    # Columns of J N, and with them the directions v in rows.
    effects = multiply_transposed(np.ascontiguousarray(remaining.T), rows)
    directions = np.ascontiguousarray(remaining.T)
    make_rows_orthogonal(effects, directions)
    dampings = np.zeros(len(effects))
    for i in range(len(effects)):
        motion = math.sqrt(dot(effects[i], effects[i]))
        if motion > MIN_MOTION:
            weakness = 1.0 - (motion / INEFFECTIVE_MOTION) ** 2
            error = dot(effects[i], errors) / motion
            dampings[i] = max(0.1 * weakness, damp_detour(motion, error))
    return (dampings.reshape(-1, 1) * directions)[dampings > 0.0]


@compiled_inside
def null_space(rows: Matrix) -> Matrix:
    """Return orthonormal directions that move no row, in columns."""
    size = rows.shape[1]
    basis = np.empty((size, size))
    rank = 0
    across = rows.copy()
    make_rows_orthogonal(across, np.empty((len(rows), 0)))
    for i in range(len(across)):
        length = math.sqrt(dot(across[i], across[i]))
        if length > MIN_MOTION and rank < size:
            add_direction(across[i], length, basis, rank)
            rank += 1
    return np.ascontiguousarray(find_complement(basis, rank).T)


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
    reach = (np.where(step > 0.0, bounds[1], bounds[0]) - velocity) / step
    is_free = (held_at == 0.0) & (step != 0.0)
    for k in range(step.size):
        if is_free[k]:
            # A joint may pass its bound by so much, within `SLACK_rad_s`.
            beyond = max(reach[k] + 1e-8 / abs(step[k]), 0.0)
            fraction = min(fraction, beyond)
    for k in range(step.size if fraction < 1.0 else 0):
        motion = abs(step[k])
        if is_free[k] and motion > largest_motion and reach[k] <= fraction:
            joint = k
            largest_motion = motion
    return (max(reach[joint], 0.0) if joint >= 0 else 1.0), joint


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
    push = solve_least_squares(np.ascontiguousarray(held_rows.T), gradient, 1e-12)
    joints = np.flatnonzero(held_at)
    outwards_push = push * held_at[joints]
    gaining = np.flatnonzero(outwards_push < -1e-12)  # a smaller gain is rounding
    if not gaining.size:
        return -1
    return joints[gaining[0] if is_first_taken else np.argmin(outwards_push)]


@compiled
def solve_level(
    rows: Matrix, rates: Vector, free: Matrix, bounds: Matrix, start: Vector
) -> Array:
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
        The velocity of the level, shape (n,).
    """
    velocity = start.copy()
    held_at = np.zeros(start.size)
    rows_of_free = multiply(rows, free)
    for change in range(MAX_CHANGES):
        held_rows = free[held_at != 0.0]
        directions = multiply(free, null_space(held_rows))
        if directions.shape[1]:
            errors = rates - multiply_vector(rows, velocity)
            # Below so much of the largest singular value joints would move far for a
            # gain that is rounding.
            coefficients = solve_least_squares(multiply(rows, directions), errors, 1e-8)
            step = multiply_vector(directions, coefficients)
            fraction, joint = find_blocking_joint(velocity, step, bounds, held_at)
            velocity += fraction * step
            if joint >= 0:
                held_at[joint] = 1.0 if step[joint] > 0.0 else -1.0
                continue
        if not len(held_rows):
            break
        errors = rates - multiply_vector(rows, velocity)
        gradient = multiply_vector(np.ascontiguousarray(rows_of_free.T), errors)
        is_first_taken = change > MAX_CHANGES // 2
        joint = find_joint_to_release(held_rows, gradient, held_at, is_first_taken)
        if joint < 0:
            break
        held_at[joint] = 0.0
    return velocity
