"""Detects a push on the arm: torques change as no force at the tip changes them."""

import math
from typing import NamedTuple

import numpy as np

from foundation.arrays import Array, Matrix, Vector
from foundation.jit import compiled, compiled_inside
from foundation.linear_algebra import (
    decompose_cholesky,
    dot,
    invert_definite,
    multiply,
    multiply_transposed,
    multiply_vector,
    solve_cholesky,
)

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


@compiled_inside
def split_change(rows: Matrix, covariance: Matrix, change: Vector) -> SplitChange:
    """Split a change of torque [Nm], shape (n,), by least squares.

    Unknowns of a wrench make torque by ``rows``, shape (k, n); the covariance [Nm^2]
    has the shape (n, n).
    """
    count, joints = rows.shape
    precision = invert_definite(covariance)
    weighted = multiply(rows, precision)
    information = multiply_transposed(weighted, rows)
    trace = 0.0
    for i in range(count):
        trace += information[i, i]
    for i in range(count):
        information[i, i] += UNSEEN_RATIO * trace + MIN_INFORMATION
    wrench = solve_cholesky(
        decompose_cholesky(information), multiply_vector(weighted, change)
    )
    explained = np.zeros(joints)
    remaining = np.zeros(joints)
    for j in range(joints):
        for i in range(count):
            explained[j] += wrench[i] * rows[i, j]
        remaining[j] = change[j] - explained[j]
    square = dot(remaining, multiply_vector(precision, remaining)) / (joints - count)
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
    joints = len(change)
    if len(rows) >= joints:
        return 0.0
    covariance = np.zeros((joints, joints))
    for i in range(joints):
        for j in range(joints):
            covariance[i, j] = (1.0 - DIAGONAL_WEIGHT) * usual[i, j]
        covariance[i, i] += DIAGONAL_WEIGHT * usual[i, i] + MIN_CHANGE_NM**2
    split = split_change(rows, covariance, change)
    if split.unexplained > limit:
        largest_Nm = 0.0
        for j in range(joints):
            largest_Nm = max(largest_Nm, abs(split.explained[j]))
        for j in range(joints):
            covariance[j, j] += (CHANGE_ERROR_RATIO * largest_Nm) ** 2
        split = split_change(rows, covariance, change)
    return split.unexplained


@compiled_inside
def approach(values: Vector, target: Vector, dt_s: float, lag_s: float) -> Array:
    """Return values after a first-order lag towards a target, shape (n,)."""
    gain = -math.expm1(-dt_s / lag_s)
    approached = np.zeros(len(values))
    for j in range(len(values)):
        approached[j] = values[j] + gain * (target[j] - values[j])
    return approached


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
    joints = len(residual)
    present = approach(present, residual, dt_s, PRESENT_S)
    change = np.zeros(joints)
    for j in range(joints):
        change[j] = present[j] - reference[j]
    square = 0.0
    if learned_s >= LEARNED_S:
        square = unusual_change(rows, change, usual, USUAL)
    own_reference = reference.copy()
    own_usual = usual.copy()
    if square > (RELEASED if pushed_s > 0.0 else PUSHED):
        if pushed_s < MAX_PUSH_S:
            return TorqueChange(
                present, own_reference, own_usual, learned_s, pushed_s + dt_s
            )
        own_reference = present.copy()
    if square < USUAL:
        learned_s += dt_s
        weight = min(dt_s / min(learned_s, USUAL_S), 1.0)
        for i in range(joints):
            for j in range(joints):
                own_usual[i, j] += weight * (change[i] * change[j] - usual[i, j])
    own_reference = approach(own_reference, present, dt_s, REFERENCE_S)
    return TorqueChange(present, own_reference, own_usual, learned_s, 0.0)
