"""Strict task priority: joint velocities that serve a stack of tasks within limits.

    lexmin_dq (|J_1 dq - v_1|, |J_2 dq - v_2|, ..., |dq - w|)   subject to   l <= dq <= u

with a wish w of the joints that comes last, zero or a posture. `Hierarchical` solves that (Kanoun
et al., IEEE T-RO 2011). Norms are of rows scaled to length one, so rows of one task count by how
far joints move for them. `Published` is the recursion of Ferro et al., Section V.B, with the
damped inverses of the authors' code: it knows no limits, and a projector made of damped inverses
is none, so near singular postures lower tasks undo higher ones. It is here to compare with.
"""

import itertools
import math
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from needleforce.control.errors import SettingError
from needleforce.control.ports import Array
from needleforce.control.velocity_box import SLACK_rad_s
from needleforce.jit import COMPILER, Matrix, Vector, WrittenVector, compiled

daqp: Any
try:
    import daqp  # pyright: ignore[reportMissingImports]
except ImportError:
    daqp = None


REGULAR = 0.01
"""A row of length one counts as independent if this much of it is new."""


AT_LIMIT = 1e-6
"""Joint velocities this close to a limit are at it [rad/s]."""
MET = 1e-8
"""A row that misses by less is met but for the solver's digits."""


class Stack:
    """Room for the numbers of a stack of tasks, over and over.

    Attributes:
        rows: J of all tasks, shape (m, n), then one row for each joint's wish, shape (m + n, n).
        bounds: Lower bounds (row 0) and upper bounds (row 1) of joint velocities, then of rows,
            shape (2, n + m + n).
        rates: v of all tasks, shape (m,), a part of row 0 of the bounds.
        wish: w, shape (n,), the part behind them.
        ends: Index behind the last row of each task.
    """

    def __init__(self, sizes: Sequence[int], joints: int) -> None:
        self.ends = tuple(itertools.accumulate(sizes))
        total = sum(sizes)
        self.rows = np.vstack((np.zeros((total, joints)), np.eye(joints)))
        self.bounds = np.zeros((2, joints + total + joints))
        self.rates, self.wish = np.split(self.bounds[0, joints:], [total])


class Solver(Protocol):
    """Finds joint velocities for a stack that its user fills in."""

    def __init__(self, stack: Stack) -> None: ...

    def solve(self) -> tuple[Array | None, bool]:
        """Joint velocities, shape (n,), in an array of their own, and whether one is at a limit.

        None where it finds none.
        """
        ...


@compiled
def is_inside(velocity: Vector, bounds: Matrix) -> bool:
    """Whether joint velocities are within the first columns of the bounds of a stack."""
    inside = True
    for k in range(velocity.size):
        inside = inside and bounds[0, k] < velocity[k] < bounds[1, k]
    return inside


@compiled
def dot(one: Vector, other: Vector) -> float:
    """Scalar product."""
    total = 0.0
    for k in range(one.size):
        total += one[k] * other[k]
    return total


@compiled
def meet_rows(
    numbers: tuple[Matrix, Vector], free: Vector, within: float, velocity: WrittenVector
) -> int:
    """Change a velocity as little as possible so that rows are met to the last digit, in order.

    Gram-Schmidt steps, twice for accuracy, make a basis q_i of the rows; moving along q_i meets
    row i and leaves the rows before it met. In loops, for a compiler.

    Args:
        numbers: J, shape (>= m, n), and v, shape (m,).
        free: 1 for joints that may change, 0 for others, shape (n,).
        within: A row that misses by more stays as it is.
        velocity: Joint velocities, changed in place.

    Returns:
        Number of rows that are independent of those before them; others are passed over.
    """
    rows, rates = numbers
    joints, count = velocity.size, 0
    basis = np.empty((joints + 1, joints))
    for i in range(rates.size):
        new = basis[min(count, joints)]
        new[:] = rows[i] * free
        size = math.sqrt(dot(new, new))
        for j in range(2 * count):
            old = basis[j % count]
            new -= dot(new, old) * old
        rest = math.sqrt(dot(new, new))
        if rest > REGULAR * size:
            new /= rest
            left = rates[i] - dot(rows[i], velocity)
            if abs(left) <= within:
                velocity += (left / rest) * new
            count += 1
    return count


class Hierarchical:
    """Hierarchical QP: strict priorities within hard limits.

    Where all rows can be met within limits, `meet_rows` does so and no QP is needed: with a
    compiler that comes first. DAQP has the others, and what it meets is made exact.
    """

    # DAQP softens levels by a penalty, of which it corrects what exceeds the tolerance. A smaller
    # penalty costs digits.
    SETTINGS = {"rho_soft": 1e-6, "primal_tol": 1e-10}  # noqa: RUF012

    def __init__(self, stack: Stack) -> None:
        if daqp is None:
            raise SettingError("task priorities need daqp: pip install 'needleforce[control]'")
        self._stack, joints = stack, stack.wish.size
        self._all_free = np.ones(joints)
        self._sense = np.zeros(stack.bounds.shape[1], dtype=np.intc)
        levels = np.array([joints + end for end in (0, *stack.ends, len(stack.rows))], np.intc)
        lower, upper = stack.bounds
        cost = np.eye(joints), np.zeros(joints)
        self._model = daqp.Model()
        self._model.setup(*cost, stack.rows, upper, lower, self._sense, levels)
        self._model.settings = self.SETTINGS

    def solve(self) -> tuple[Array | None, bool]:
        """See `Solver`."""
        stack, model = self._stack, self._model
        numbers, velocity = (stack.rows, stack.rates), stack.wish.copy()
        if COMPILER:
            count = meet_rows(numbers, self._all_free, math.inf, velocity)
            if count == stack.rates.size and is_inside(velocity, stack.bounds):
                return velocity, False
        # The model looks at the arrays themselves: naming the rows renews the bounds too, and
        # naming the sense forgets the last active set, so that answers have no history.
        if model.update(A=stack.rows, sense=self._sense) < 0:
            return None, False
        velocity, _, flag, _ = model.solve()
        if flag < 0:
            return None, False
        lower, upper = stack.bounds[:, : velocity.size]
        velocity = np.minimum(np.maximum(velocity, lower - SLACK_rad_s), upper + SLACK_rad_s)
        room = np.minimum(velocity - lower, upper - velocity)
        if COMPILER:
            meet_rows(numbers, (room > AT_LIMIT).astype(np.float64), MET, velocity)
        return velocity, bool(np.minimum.reduce(room) <= AT_LIMIT)


class Published:
    """The published recursion: no limits, damped inverses.

    dq_k = dq_{k-1} + (J_k P_{k-1})^# (v_k - J_k dq_{k-1}),   P_k = P_{k-1} - (J_k P_{k-1})^# J_k P
    """

    DETERMINANT, DAMPING = 1e-10, 0.5
    """The authors' code adds the damping to A A^T where its determinant is this small."""

    def __init__(self, stack: Stack) -> None:
        self._stack = stack

    def solve(self) -> tuple[Array | None, bool]:
        """See `Solver`."""
        rows, rates, wish = self._stack.rows, self._stack.rates, self._stack.wish
        velocity, projector = np.zeros_like(wish), np.eye(wish.size)
        for first, end in itertools.pairwise((0, *self._stack.ends)):
            free = rows[first:end] @ projector
            square = free @ free.T
            if np.linalg.det(square) <= self.DETERMINANT:
                square = square + self.DAMPING * np.eye(len(square))
            inverse = free.T @ np.linalg.inv(square)
            velocity = velocity + inverse @ (rates[first:end] - rows[first:end] @ velocity)
            projector = projector - inverse @ free
        velocity = velocity + projector @ (wish - velocity)
        return (velocity if np.isfinite(velocity).all() else None), False
