"""How large a change of torque has to be to count as a push on the arm."""

import numpy as np
import pytest

from residual.checks.pushed_arm import TorqueChange, change_step

DT_S = 0.02
ALONG_NEEDLE = np.eye(1, 7)  # torque per newton at the tip: the first joint alone
USUAL_NM = 0.1
"""Usual change of each torque."""


def changed(change_Nm, *, pushed_s=0.0, seconds=DT_S):
    """What follows after torques that have changed so, shape (7,)."""
    change = TorqueChange(
        present=change_Nm.copy(),
        reference=np.zeros(7),
        usual=np.diag(np.full(7, USUAL_NM**2)),
        learned_s=20.0,
        pushed_s=pushed_s,
    )
    for _ in range(round(seconds / DT_S)):
        change = change_step(ALONG_NEEDLE, change_Nm, *change, DT_S)
    return change


def beside_the_needle(mean_square):
    """A change that no axial force explains, in units of the usual one."""
    change_Nm = np.full(7, USUAL_NM * np.sqrt(mean_square))
    change_Nm[0] = 0.0
    return change_Nm


@pytest.mark.parametrize(
    ("mean_square", "pushed_s", "is_pushed"),
    [(13.0, 0.0, False), (17.0, 0.0, True), (13.0, 0.5, True), (10.0, 0.5, False)],
)
def test_a_change_fifteen_times_the_usual_is_a_push_until_it_is_below_twelve(
    mean_square, pushed_s, is_pushed
):
    change = changed(beside_the_needle(mean_square), pushed_s=pushed_s)

    assert (change.pushed_s > 0.0) == is_pushed


def test_a_force_along_the_needle_is_no_push():
    along_Nm = np.zeros(7)
    along_Nm[0] = 30.0 * USUAL_NM

    assert changed(along_Nm).pushed_s == 0.0


def test_what_lasts_longer_than_a_push_is_another_load():
    pushed = beside_the_needle(30.0)

    assert changed(pushed, seconds=2.0).pushed_s == pytest.approx(2.0)
    assert changed(pushed, seconds=3.0).pushed_s == 0.0
