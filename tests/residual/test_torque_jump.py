"""A torque sensor that jumps is noticed, doubted, and not mistaken for a force."""

import numpy as np
import pytest

from residual import SensorWarning, VirtualForceSensor
from tests.insertion_run import same
from tests.residual.guarded_sensor import feed, tared
from tests.residual.residual_signals import external_torque_of

JUMP = SensorWarning.TORQUE_JUMP


def with_step(rows, joint, step_Nm, first, last=None):
    """Samples with a step of one torque from the first to before the last."""
    changed = []
    for k, (q, dq, tau) in enumerate(rows):
        tau = tau.copy()
        if first <= k < (len(rows) if last is None else last):
            tau[joint] += step_Nm
        changed.append((q, dq, tau))
    return changed


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
    estimates = feed(sensor, with_step(rows, joint, step_Nm, first))
    flagged = warned(estimates)

    assert first < flagged[0] <= first + 500
    assert len(flagged) == len(rows) - flagged[0]  # it stays
    assert "a torque has jumped, by its sensor" in estimates[-1].message

    after = estimates[flagged[0] + 50 :]
    within = [abs(e.axial) < 2.0 * e.axial_std for e in after]

    assert np.mean(within) > 0.95
    assert sensor.jumps == 1


@pytest.mark.parametrize(("joint", "step_Nm"), [(3, -3.0), (5, 1.0), (5, -3.0)])
def test_the_new_level_of_a_torque_counts_as_the_zero(lwr, joint, step_Nm):
    steady, rows = tared(lwr, more=4.0)
    sensor, _ = tared(lwr, more=4.0)
    axial_N = np.array([e.axial for e in feed(steady, rows)])
    changed = feed(sensor, with_step(rows, joint, step_Nm, 500))
    error_N = np.array([e.axial for e in changed]) - axial_N
    std_N = np.array([e.axial_std for e in changed])
    after = slice(3_100, None)

    assert np.abs(error_N[700:900]).mean() > 4.0  # before its level is known
    assert np.abs(error_N[after]).max() < 0.1
    assert (np.abs(error_N[after]) < 2.0 * std_N[after]).all()
    assert error_N[after].std() < 0.02  # the gain stays, and the arm moves on
    assert std_N[after].max() < 1.0
    assert JUMP in changed[-1].warnings


@pytest.mark.slow
def test_a_torque_that_comes_back_ends_the_warning(lwr):
    sensor, rows = tared(lwr, more=4.0)
    estimates = feed(sensor, with_step(rows, 3, 0.5, 300, 2_000))
    flagged = warned(estimates)

    assert 300 < flagged[0] < 800
    assert 2_000 < flagged[-1] < 3_200
    assert estimates[-1].axial_std < 1.2 * estimates[250].axial_std


@pytest.mark.parametrize("force_N", [(0.0, 0.0, 3.0), (2.0, -2.0, 0.0)])
def test_a_force_at_the_tip_is_no_jump(lwr, force_N):
    sensor, rows = tared(lwr, more=2.0)
    pushed = [
        (q, dq, tau - external_torque_of(lwr, q, force_N) * (k > 700))
        for k, (q, dq, tau) in enumerate(rows)
    ]

    assert warned(feed(sensor, pushed)) == []


def test_a_snapshot_amid_a_jump_goes_on_bit_for_bit(lwr):
    sensor, rows = tared(lwr, more=2.5)
    rows = with_step(rows, 3, 0.5, 300)
    feed(sensor, rows[:800])  # it is being measured
    resumed = VirtualForceSensor(lwr)
    resumed.restore(sensor.snapshot())

    assert sensor.is_measuring_jump
    assert all(
        same(one, other)
        for one, other in zip(
            feed(sensor, rows[800:1_600]), feed(resumed, rows[800:1_600]), strict=True
        )
    )
