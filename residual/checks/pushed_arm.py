"""Notices a push on the arm: joint torques change as no force at the tip changes them."""

import math
from typing import NamedTuple

import numpy as np

from foundation.arrays import Matrix, Vector
from foundation.jit import compiled
from residual.errors import Array

# memory of the torque now, before, of their difference
NOW_S = 0.06
BEFORE_S = 0.6
USUAL_S = 8.0
PUSHED = 15.0
LET_GO = 12.0
USUAL = 6.0
BESIDE = 4.0
"""Mean square of a torque change that no wrench explains, in units of the usual one.
From PUSHED on the arm is pushed, until below LET_GO; below USUAL it is learnt as usual.
From BESIDE on, for what no axial force explains, a rupture is not reported."""
LONGEST_PUSH_S = 2.5  # what lasts longer is no hand's push: a cable, or another load
LEARNED_S = 1.0  # learning time before anything is called unusual
LEAST_CHANGE_NM = 3e-4
CHANGE_ERROR = 0.02
"""A change up to this may be hysteresis of a joint's sensor; one up to this fraction of
the largest explained change may be an error of the lever arms."""


class TorqueChange(NamedTuple):
    """Joint torque without its offset, now and before, both smoothed.

    Attributes:
        torques: Torque now; torque before, kept while the arm is pushed [Nm]; then the
            mean product of their differences [Nm^2]; shape (n + 2, n).
        learned_s: Time over which that product was learned.
        pushed_s: Time since the arm has been pushed.
    """

    torques: Array
    learned_s: float = 0.0
    pushed_s: float = 0.0


@compiled
def unexplained_change(
    rows: Matrix, covariance: Matrix, change: Vector
) -> tuple[float, Array]:
    """Like `unusual_change`, for a given covariance [Nm^2]; also the explained part
    [Nm], (n,).
    """
    precision = np.linalg.inv(covariance).T  # the same, with its rows in order
    weighted = rows.dot(precision)
    information = weighted.dot(rows.T)
    # What no joint feels is left at zero.
    information += (1e-12 * np.trace(information) + 1e-30) * np.eye(len(rows))
    explained = np.linalg.solve(information, weighted.dot(change)).dot(rows)
    left = change - explained
    return left.dot(precision).dot(left) / (len(change) - len(rows)), explained


@compiled
def unusual_change(rows: Matrix, change: Vector, usual: Matrix, enough: float) -> float:
    """Mean square of a change of joint torque [Nm], shape (n,), that no wrench
    explains.

    Unknowns make torque by ``rows``, (k, n). The unit is ``usual``, the mean product of
    changes without a push [Nm^2], shape (n, n), shrunk towards its diagonal. A value
    beyond ``enough`` is computed again with errors of sensors and lever arms in the
    explained part, which lowers it.
    """
    if len(rows) >= len(change):
        return 0.0
    covariance = 0.8 * usual + np.diag(0.2 * np.diag(usual) + LEAST_CHANGE_NM**2)
    square, explained = unexplained_change(rows, covariance, change)
    if square > enough:
        covariance += (CHANGE_ERROR * np.abs(explained).max()) ** 2 * np.eye(
            len(change)
        )
        square, explained = unexplained_change(rows, covariance, change)
    return square


@compiled
def change_step(
    rows: Matrix,
    residual: Vector,
    last: Matrix,
    learned_s: float,
    pushed_s: float,
    dt_s: float,
) -> tuple[Array, float, float]:
    """The next `TorqueChange` after the last, from a residual [Nm] a time ``dt_s`` >
    0 later.
    """
    torques = last.copy()
    square = 0.0
    now = torques[0]
    before = torques[1]
    usual = torques[2:]
    now -= math.expm1(-dt_s / NOW_S) * (residual - now)
    change = now - before
    if learned_s >= LEARNED_S:
        square = unusual_change(rows, change, usual, USUAL)
    if square > (LET_GO if pushed_s > 0.0 else PUSHED):
        if pushed_s < LONGEST_PUSH_S:
            return torques, learned_s, pushed_s + dt_s
        before[:] = now
    if square < USUAL:
        learned_s += dt_s
        usual += min(dt_s / min(learned_s, USUAL_S), 1.0) * (
            np.outer(change, change) - usual
        )
    before -= math.expm1(-dt_s / BEFORE_S) * (now - before)
    return torques, learned_s, 0.0
