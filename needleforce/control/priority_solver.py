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
from needleforce.jit import COMPILER, Matrix, Vector, WrittenMatrix, WrittenVector, compiled

daqp: Any
try:
    import daqp  # pyright: ignore[reportMissingImports]
except ImportError:
    daqp = None


REGULAR = 0.01
"""A row of length one counts as independent if this much of it is new."""


TOLERANCE = 1e-9
"""Joint velocities this close to a limit are at it [rad/s]."""


class Stack:
    """Room for the numbers of a stack of tasks, over and over.

    Attributes:
        rows: J of all tasks, shape (m, n).
        bounds: Lower bounds (row 0) and upper bounds (row 1) of joint velocities, then of rows,
            shape (2, n + m).
        rates: v of all tasks, shape (m,): the end of row 0 of the bounds.
        wish: w, shape (n,).
        ends: Index behind the last row of each task.
    """

    def __init__(self, sizes: Sequence[int], joints: int) -> None:
        total = sum(sizes)
        self.rows, self.wish = np.zeros((total, joints)), np.zeros(joints)
        self.bounds = np.zeros((2, joints + total))
        self.rates = self.bounds[0, joints:]
        self.ends = tuple(itertools.accumulate(sizes))


class Solver(Protocol):
    """Finds joint velocities for a stack that its user fills in."""

    def __init__(self, stack: Stack) -> None: ...

    def solve(self) -> tuple[Array | None, bool]:
        """Joint velocities, shape (n,), in an array of their own, and whether one is at a limit.

        None where it finds none.
        """
        ...


@compiled
def dot(one: Vector, other: Vector) -> float:
    """Scalar product."""
    total = 0.0
    for k in range(one.size):
        total += one[k] * other[k]
    return total


@compiled
def remove(basis: Matrix, count: int, rest: WrittenVector) -> None:
    """Remove from a vector its parts along the first orthonormal rows of a basis."""
    for j in range(count):
        along = dot(rest, basis[j])
        for k in range(rest.size):
            rest[k] -= along * basis[j, k]


@compiled
def meet_all(
    rows: Matrix, rates: Vector, wish: Vector, basis: WrittenMatrix, velocity: WrittenVector
) -> bool:
    """The velocity nearest to the wish that meets all rows; False if rows are nearly dependent.

    Where it is within limits it is the solution, whatever the priorities. Gram-Schmidt steps,
    twice for accuracy, make a basis q_i of the rows; moving along q_i meets row i and leaves the
    rows before it met. In loops, for a compiler.
    """
    velocity[:] = 0.0
    count = rows.shape[0]
    for i in range(count):
        basis[i] = rows[i]
        remove(basis, i, basis[i])
        remove(basis, i, basis[i])
        new = math.sqrt(dot(basis[i], basis[i]))
        if not new > REGULAR * math.sqrt(dot(rows[i], rows[i])):
            return False
        step = (rates[i] - dot(rows[i], velocity)) / new
        for k in range(velocity.size):
            basis[i, k] /= new
            velocity[k] += step * basis[i, k]
    rest = wish - velocity
    remove(basis, count, rest)
    velocity += rest
    return True


@compiled
def is_inside(velocity: Vector, bounds: Matrix) -> bool:
    """Whether joint velocities are within the first columns of the bounds of a stack."""
    inside = True
    for k in range(velocity.size):
        inside = inside and bounds[0, k] < velocity[k] < bounds[1, k]
    return inside


class Hierarchical:
    """Hierarchical QP: strict priorities within hard limits.

    Most ticks need no QP: with a compiler `meet_all` goes first. DAQP has the others.
    """

    # A level is softened by a penalty, so of unit rows it is damped where singular values are
    # below the root of this; DAQP takes that back in levels that are left unmet by more than the
    # tolerance.
    SETTINGS = {"rho_soft": 1e-8, "primal_tol": 1e-7}  # noqa: RUF012

    def __init__(self, stack: Stack) -> None:
        if daqp is None:
            raise SettingError("task priorities need daqp: pip install 'needleforce[control]'")
        self._stack, joints = stack, stack.wish.size
        lower, upper = stack.bounds
        self._sense = np.zeros(lower.size, dtype=np.intc)
        self._basis, self._box = np.zeros_like(stack.rows), stack.bounds[:, :joints]
        levels = np.array([joints, *(joints + end for end in stack.ends)], dtype=np.intc)
        problem = (np.eye(joints), stack.wish, stack.rows, upper, lower, self._sense, levels)
        self._model = daqp.Model()
        self._model.setup(*problem)
        self._model.settings = self.SETTINGS

    def solve(self) -> tuple[Array | None, bool]:
        """See `Solver`."""
        stack, model = self._stack, self._model
        if COMPILER:
            velocity = np.empty_like(stack.wish)
            if meet_all(stack.rows, stack.rates, stack.wish, self._basis, velocity) and is_inside(
                velocity, stack.bounds
            ):
                return velocity, False
        # The model looks at the arrays themselves: naming the rows renews the bounds too, and
        # naming the sense forgets the last active set, so that answers have no history.
        if model.update(A=stack.rows, sense=self._sense, f=-stack.wish) < 0:
            return None, False
        velocity, _, flag, _ = model.solve()
        lower, upper = self._box
        velocity = np.minimum(np.maximum(velocity, lower), upper)
        room = np.minimum.reduce(np.minimum(velocity - lower, upper - velocity))
        return (velocity if flag > 0 else None), bool(room <= TOLERANCE)


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
