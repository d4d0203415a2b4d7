"""A torque sensor that jumps is noticed, doubted, and not mistaken for a force."""

import numpy as np
import pytest

from residual import SensorWarning
from residual.checks.torque_watch import TorqueWatch, fit_steps
from tests.residual.guarded_sensor import at, changed, feed, tared
from tests.residual.residual_signals import jacobian_of

JUMP = SensorWarning.TORQUE_JUMP


def with_step(rows, joint, step_Nm, first, last=None):
    """Samples with a step of one torque from the first to before the last."""
    return changed(rows, 2, lambda tau: tau + at(joint, step_Nm), first, last)


def warned(estimates):
    return [k for k, e in enumerate(estimates) if JUMP in e.warnings]


@pytest.mark.parametrize(
    ("joint", "step_Nm", "first"),
    [(1, 0.5, 150), (3, -0.4, 1_000), (5, 0.3, 1_000), (6, 0.3, 150)],
)
def test_a_jump_is_reported_within_half_a_second_and_in_the_deviation(
    lwr, joint, step_Nm, first
):
    sensor, rows = tared(lwr, more=4.0)
    found = feed(sensor, with_step(rows, joint, step_Nm, first))
    flagged = warned(found)
    after = found[flagged[0] + 50 :]

    assert first < flagged[0] <= first + 500
    assert (sensor.jumps, len(flagged)) == (1, len(rows) - flagged[0])  # it stays
    assert np.mean([abs(e.axial) < 2.0 * e.axial_std for e in after]) > 0.95
    # It can have begun 0.6 s before, or 0.1 s where torques changed like a push.
    begun_s = 4.0 - 1e-3 * first
    assert begun_s <= sensor.jump_since_s <= begun_s + (0.6 if first == 150 else 0.1)


@pytest.mark.parametrize(("joint", "step_Nm"), [(3, -3.0), (5, 1.0), (5, -3.0)])
def test_the_new_level_of_a_torque_counts_as_the_zero(lwr, joint, step_Nm):
    (steady, rows), (sensor, _) = (tared(lwr, more=4.0) for _ in range(2))
    found = feed(sensor, with_step(rows, joint, step_Nm, 500))
    axial_N, std_N = np.array([(e.axial, e.axial_std) for e in found]).T
    error_N = axial_N - [e.axial for e in feed(steady, rows)]
    after_N = error_N[3_100:]

    assert np.abs(error_N[700:900]).mean() > 4.0  # before its level is known
    assert (np.abs(after_N) < np.minimum(2.0 * std_N[3_100:], 0.1)).all()
    assert after_N.std() < 0.02  # the gain stays, and the arm moves on
    assert std_N[3_100:].max() < 1.0
    assert JUMP in found[-1].warnings


@pytest.mark.slow
def test_torques_that_come_back_end_the_warning(lwr):
    sensor, rows = tared(lwr, more=16.0)
    calm_N = feed(sensor, rows[:200])[-1].axial_std
    stepped = with_step(rows[200:], 1, 0.5, 300, 10_000)
    stepped = with_step(stepped, 5, 0.4, 4_000, 7_000)
    found = feed(sensor, stepped)
    flagged = warned(found)

    assert 300 < flagged[0] < 800
    assert 10_000 < flagged[-1] < 13_500
    assert (sensor.jumps, len(flagged)) == (4, flagged[-1] - flagged[0] + 1)
    assert found[-1].axial_std < 1.8 * calm_N


@pytest.mark.parametrize(
    ("frame", "force_N", "last"),
    [
        (None, (0.0, 0.0, 3.0), None),
        (None, (2.0, -2.0, 0.0), None),
        ("lwr_link_5", (8.0, -6.0, 5.0), 2_700),
    ],
)
def test_a_force_at_the_tip_or_a_push_on_the_arm_is_no_jump(lwr, frame, force_N, last):
    sensor, rows = tared(lwr, more=4.0)
    push_Nm = jacobian_of(lwr, rows[0][0], frame)[:3].T @ force_N
    found = feed(sensor, changed(rows, 2, lambda tau: tau - push_Nm, 700, last))

    assert (warned(found), sensor.jumps) == ([], 0)


# How large a change has to be, as mathematics.

ALONG_NEEDLE = np.array([[0.4, -0.6, 0.3, 0.5, -0.2, 0.1, 0.05]])
"""Torque per newton at the tip [m]."""


def fitted(change_Nm, usual_Nm=0.1, force_N=1e4):
    return fit_steps(ALONG_NEEDLE, change_Nm, usual_Nm**2 * np.eye(7), force_N)


@pytest.mark.parametrize("joint", [0, 3, 6])
def test_a_step_beside_a_force_is_found_in_its_size(joint):
    found = fitted(at(joint, 0.5) + 3.0 * ALONG_NEEDLE[0], 0.01)

    assert found.ratios.argmax() == joint
    assert found.steps_Nm[joint] == pytest.approx(0.5, rel=0.01)


@pytest.mark.parametrize(("sigmas", "is_jump"), [(4.8, False), (5.2, True)])
def test_a_step_of_five_deviations_is_a_jump(sigmas, is_jump):
    std_Nm = np.sqrt(fitted(at(2, 1.0)).variances_Nm2[2])

    assert fitted(at(2, sigmas * std_Nm)).is_jump == is_jump


@pytest.mark.parametrize(("step_Nm", "is_jump"), [(0.045, False), (0.06, True)])
def test_a_step_that_a_twisted_needle_makes_is_no_jump(step_Nm, is_jump):
    assert fitted(at(2, step_Nm), 1e-3).is_jump == is_jump


def watch_of(change_Nm, changed_s=0.0):
    """What has seen usual changes of 0.1 Nm, and then another."""
    watch = TorqueWatch.after_tare(np.zeros(7), np.full(7, 0.1**2 / 2.0))
    watch.has_blocks = True
    watch.learned_s = 20.0
    watch.present_Nm = change_Nm.copy()
    watch.changed_s = changed_s
    return watch


@pytest.mark.parametrize(
    ("mean_square", "before_s", "lasts_s", "is_pushed"),
    [
        (13.0, 0.0, 0.02, False),
        (17.0, 0.0, 0.02, True),
        (13.0, 0.5, 0.02, True),
        (10.0, 0.5, 0.02, False),
        (30.0, 0.0, 1.9, True),
        (30.0, 0.0, 2.6, False),
    ],
)
def test_a_change_fifteen_times_the_usual_is_a_push_until_below_twelve_or_too_long(
    mean_square, before_s, lasts_s, is_pushed
):
    change_Nm = 0.1 * np.sqrt(mean_square) * (np.arange(7) > 0)
    watch = watch_of(change_Nm, before_s)
    for _ in range(round(lasts_s / 0.02)):
        watch.update(np.eye(1, 7), change_Nm, 0.02)

    assert (watch.is_pushed, watch.has_jumped) == (is_pushed, False)


def test_a_force_along_the_needle_is_no_push():
    watch = watch_of(at(0, 3.0))
    watch.update(np.eye(1, 7), at(0, 3.0), 0.02)

    begun = [one.has_begun(np.eye(1, 7)) for one in (watch, watch_of(at(1, 3.0)))]

    assert (watch.changed_s, watch.is_pushed, begun) == (0.0, False, [False, True])
