"""Strict task priority: joint velocities that serve a stack of tasks within limits.

    lexmin_dq (|J_1 dq - v_1|, |J_2 dq - v_2|, ...)   subject to   l <= dq <= u

`Hierarchical` solves that (Kanoun et al., IEEE T-RO 2011) with DAQP, level by level, each within
what the levels above leave free. Rows count by how far joints move for them: norms are of rows
scaled to unit length. `Published` is the recursion of Ferro et al., Section V.B, with damped
inverses as in the authors' code. It knows no limits, and a projector made of damped inverses is
none: near singular postures lower tasks undo higher ones. It is here to compare with.
"""

import itertools
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from needleforce.control.errors import SettingError
from needleforce.control.ports import Array

daqp: Any
try:
    import daqp  # pyright: ignore[reportMissingImports]
except ImportError:
    daqp = None


class Stack:
    """Room for the numbers of a stack of tasks, over and over.

    Attributes:
        rows: J of all tasks, shape (m, n).
        bounds: Lower bounds (row 0) and upper bounds (row 1) of joint velocities, then of rows,
            shape (2, n + m).
        rates: v of all tasks, shape (m,): the end of row 0 of the bounds.
        ends: Index behind the last row of each task, shape (tasks,).
    """

    def __init__(self, sizes: Sequence[int], joints: int) -> None:
        total = sum(sizes)
        self.rows = np.zeros((total, joints))
        self.bounds = np.zeros((2, joints + total))
        self.rates = self.bounds[0, joints:]
        self.ends = np.cumsum(sizes, dtype=np.float64)


class Solver(Protocol):
    """Finds joint velocities for a stack that its user fills in."""

    def __init__(self, stack: Stack) -> None: ...

    def solve(self) -> Array | None:
        """Joint velocities, shape (n,); None if there are none."""
        ...


class Hierarchical:
    """Hierarchical QP: strict priorities within hard limits."""

    # A level is softened by a penalty, so of unit rows it is damped where singular values are
    # below the root of this; DAQP takes that back in levels that are left unmet by more than the
    # tolerance.
    SETTINGS = {"rho_soft": 1e-8, "primal_tol": 1e-7}  # noqa: RUF012

    def __init__(self, stack: Stack) -> None:
        if daqp is None:
            raise SettingError("task priorities need daqp: pip install 'needleforce[control]'")
        self._rows = stack.rows
        lower, upper = stack.bounds
        self._sense = np.zeros(lower.size, dtype=np.intc)
        joints = stack.rows.shape[1]
        levels = np.array((joints, *(joints + stack.ends)), dtype=np.intc)
        self._model = daqp.Model()
        self._model.setup(
            *(np.eye(joints), np.zeros(joints), stack.rows, upper, lower, self._sense, levels)
        )
        self._model.settings = self.SETTINGS

    def solve(self) -> Array | None:
        """See `Solver`."""
        # The model looks at the arrays themselves: naming the rows renews the bounds too, and
        # naming the sense forgets the last active set, so that answers have no history.
        model = self._model
        if model.update(A=self._rows, sense=self._sense) < 0:
            return None
        velocity, _, flag, _ = model.solve()
        return velocity if flag > 0 else None


class Published:
    """The published recursion: no limits, damped inverses.

    dq_k = dq_{k-1} + (J_k P_{k-1})^# (v_k - J_k dq_{k-1}),   P_k = P_{k-1} - (J_k P_{k-1})^# J_k P
    """

    DETERMINANT, DAMPING = 1e-10, 0.5
    """The authors' code adds the damping to A A^T where its determinant is this small."""

    def __init__(self, stack: Stack) -> None:
        self._stack = stack

    def solve(self) -> Array | None:
        """See `Solver`."""
        rows, rates = self._stack.rows, self._stack.rates
        joints = rows.shape[1]
        velocity, projector = np.zeros(joints), np.eye(joints)
        ends = [0, *map(int, self._stack.ends)]
        for first, end in itertools.pairwise(ends):
            free = rows[first:end] @ projector
            square = free @ free.T
            if np.linalg.det(square) <= self.DETERMINANT:
                square = square + self.DAMPING * np.eye(len(square))
            inverse = free.T @ np.linalg.inv(square)
            velocity = velocity + inverse @ (rates[first:end] - rows[first:end] @ velocity)
            projector = projector - inverse @ free
        return velocity if np.isfinite(velocity).all() else None
