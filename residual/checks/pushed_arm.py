"""Detects a push on the arm: torques change as no force at the tip changes them."""

import math
from typing import NamedTuple

import numpy as np

from foundation.arrays import Array, Matrix, Vector
from foundation.jit import compiled

PRESENT_S = 0.06
"""Time constant of the smoothed torque of the present."""

REFERENCE_S = 0.6
"""Time constant of the torque that it is compared with."""

USUAL_S = 8.0
"""Time constant of the usual difference of the two."""

PUSHED = 15.0
"""Mean square of a torque change that no wrench explains, in units of the usual one,
from which on the arm counts as pushed."""

RELEASED = 12.0
"""The same below which a pushed arm counts as released."""

USUAL = 6.0
"""The same below which a change is learnt as usual."""

BESIDE = 4.0
"""The same of what no axial force explains, from which on a rupture is not reported."""

MAX_PUSH_S = 2.5
"""Longest push of a hand: what lasts longer is a cable, or another load."""

LEARNED_S = 1.0
"""Learning time before anything is called unusual."""

MIN_CHANGE_NM = 3e-4
"""A change up to this may be hysteresis of a joint's sensor."""

CHANGE_ERROR_RATIO = 0.02
"""A change up to this fraction of the largest explained one may be an error of the
lever arms."""

DIAGONAL_WEIGHT = 0.2
"""Weight of the diagonal in the covariance of usual changes, which is learnt from few
samples; the rest is that of the whole matrix."""

UNSEEN_RATIO = 1e-12
"""Regularisation of the normal equations, relative to their trace: what no joint feels
is left at zero."""

MIN_INFORMATION = 1e-30
"""Regularisation of normal equations that are zero."""


class TorqueChange(NamedTuple):
    """How the joint torque, without its offset, changes; arrays are not written again.

    Attributes:
        present: Smoothed torque of the present [Nm], shape (n,).
        reference: Smoothed torque of a while ago [Nm], shape (n,); kept while the arm
            is pushed.
        usual: Mean product of their differences without a push [Nm^2], shape (n, n).
        learned_s: Time over which that product was learned.
        pushed_s: Time since the arm has been pushed.
    """

    present: Array
    reference: Array
    usual: Array
    learned_s: float = 0.0
    pushed_s: float = 0.0

    def find_damage(self) -> str:
        """Return the shapes of the arrays if they do not fit each other, else ""."""
        joints = self.present.shape
        if self.reference.shape == joints and self.usual.shape == joints + joints:
            return ""
        return f"arrays have shapes {[array.shape for array in self[:3]]}"


def first_change(residual: Array) -> TorqueChange:
    """Return the change after a first residual [Nm], shape (n,)."""
    joints = len(residual)
    return TorqueChange(residual.copy(), residual.copy(), np.zeros((joints, joints)))


class SplitChange(NamedTuple):
    """A change of torque, split by whether a wrench explains it.

    Attributes:
        unexplained: Mean square of the part that no wrench explains, in units of a
            covariance.
        explained: The other part [Nm], shape (n,).
    """

    unexplained: float
    explained: Array


@compiled
def split_change(rows: Matrix, covariance: Matrix, change: Vector) -> SplitChange:
    """Split a change of torque [Nm], shape (n,), by least squares.

    Unknowns of a wrench make torque by ``rows``, shape (k, n); the covariance [Nm^2]
    has the shape (n, n).
    """
    precision = np.linalg.inv(covariance).T  # symmetric: transposed for its layout
    weighted = rows.dot(precision)
    information = weighted.dot(rows.T)
    information += (UNSEEN_RATIO * np.trace(information) + MIN_INFORMATION) * np.eye(
        len(rows)
    )
    explained = np.linalg.solve(information, weighted.dot(change)).dot(rows)
    remaining = change - explained
    square = remaining.dot(precision).dot(remaining) / (len(change) - len(rows))
    return SplitChange(square, explained)


@compiled
def unusual_change(rows: Matrix, change: Vector, usual: Matrix, limit: float) -> float:
    """Return the mean square of a change of torque that no wrench explains.

    Args:
        rows: Torque per unit of each unknown of a wrench, shape (k, n).
        change: Change of joint torque [Nm], shape (n,).
        usual: Unit of the result: mean product of changes without a push [Nm^2], shape
            (n, n); it is shrunk towards its diagonal.
        limit: A value beyond it is computed again with errors of sensors and lever arms
            in the explained part, which lowers it.
    """
    if len(rows) >= len(change):
        return 0.0
    diagonal = DIAGONAL_WEIGHT * np.diag(usual) + MIN_CHANGE_NM**2
    covariance = (1.0 - DIAGONAL_WEIGHT) * usual + np.diag(diagonal)
    split = split_change(rows, covariance, change)
    if split.unexplained > limit:
        error_Nm = CHANGE_ERROR_RATIO * np.abs(split.explained).max()
        covariance += error_Nm**2 * np.eye(len(change))
        split = split_change(rows, covariance, change)
    return split.unexplained


@compiled
def change_step(
    rows: Matrix,
    residual: Vector,
    present: Vector,
    reference: Vector,
    usual: Matrix,
    learned_s: float,
    pushed_s: float,
    dt_s: float,
) -> TorqueChange:
    """Return the `TorqueChange` a time ``dt_s`` > 0 later.

    Args:
        rows: Torque per unit of each unknown of a wrench, shape (k, n).
        residual: External joint torque after offset removal [Nm], shape (n,).
        present: Field of the `TorqueChange` before, like the next four.
        reference: See there.
        usual: See there.
        learned_s: See there.
        pushed_s: See there.
        dt_s: Time since then.
    """
    square = 0.0
    present = present - math.expm1(-dt_s / PRESENT_S) * (residual - present)
    change = present - reference
    if learned_s >= LEARNED_S:
        square = unusual_change(rows, change, usual, USUAL)
    if square > (RELEASED if pushed_s > 0.0 else PUSHED):
        if pushed_s < MAX_PUSH_S:
            return TorqueChange(
                present, reference.copy(), usual.copy(), learned_s, pushed_s + dt_s
            )
        reference = present.copy()
    if square < USUAL:
        learned_s += dt_s
        weight = min(dt_s / min(learned_s, USUAL_S), 1.0)
        usual = usual + weight * (np.outer(change, change) - usual)
    else:
        usual = usual.copy()
    reference = reference - math.expm1(-dt_s / REFERENCE_S) * (present - reference)
    return TorqueChange(present, reference, usual, learned_s, 0.0)
