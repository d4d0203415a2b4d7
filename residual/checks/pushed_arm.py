"""Detects a push on the arm: torques change as no force at the tip changes them."""

import math
from typing import NamedTuple

import numpy as np

from foundation.arrays import Array, Matrix, Vector
from foundation.jit import compiled, compiled_inside
from residual.checks.torque_change import USUAL_S, unusual_change

LEARNED_S = 1.0
"""Learning time before anything is called unusual."""


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

    def has_begun(self, axial_row: Array) -> bool:
        """Return whether the torque changes as no force along the needle changes it.

        Args:
            axial_row: Torque per newton along the needle, shape (1, n).
        """
        if self.learned_s < LEARNED_S:
            return False
        # From here on a rupture is not reported.
        limit = 4.0
        difference = self.present - self.reference
        return unusual_change(axial_row, difference, self.usual) > limit


def first_change(residual: Array) -> TorqueChange:
    """Return the change after a first residual [Nm], shape (n,)."""
    joints = len(residual)
    return TorqueChange(residual.copy(), residual.copy(), np.zeros((joints, joints)))


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
    # Mean squares of a change in units of the usual one: from where the arm counts as
    # pushed, below which it counts as released, and below which a change is usual.
    min_push = 15.0
    max_release = 12.0
    max_usual = 6.0
    # Longest push of a hand: what lasts longer is a cable, or another load.
    max_push_s = 2.5
    # The smoothed torque of the present is compared with that of a while ago.
    present = approach(present, residual, dt_s, 0.06)
    reference_lag_s = 0.6
    joints = len(residual)
    change = np.zeros(joints)
    for j in range(joints):
        change[j] = present[j] - reference[j]
    square = 0.0
    if learned_s >= LEARNED_S:
        square = unusual_change(rows, change, usual)
    own_reference = reference.copy()
    own_usual = usual.copy()
    if square > (max_release if pushed_s > 0.0 else min_push):
        if pushed_s < max_push_s:
            return TorqueChange(
                present, own_reference, own_usual, learned_s, pushed_s + dt_s
            )
        own_reference = present.copy()
    if square < max_usual:
        learned_s += dt_s
        weight = min(dt_s / min(learned_s, USUAL_S), 1.0)
        for i in range(joints):
            for j in range(joints):
                own_usual[i, j] += weight * (change[i] * change[j] - usual[i, j])
    own_reference = approach(own_reference, present, dt_s, reference_lag_s)
    return TorqueChange(present, own_reference, own_usual, learned_s, 0.0)
