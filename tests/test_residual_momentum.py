"""The momentum residual: its exact step and the observer around it."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from residual_signals import JOINTS, external_torque_of, swing

from residual import (
    ConfigurationError,
    JointFriction,
    MomentumObserver,
    SigmoidFriction,
)
from residual.momentum_observer import BEFORE, ROWS, set_step_weights

numbers = st.floats(-100.0, 100.0)


def rows(momentum, coriolis, gravity, torque, residual=0.0):
    return np.array([[residual], [momentum], [coriolis], [gravity], [torque]])


def step(before, after, gain, dt_s, alignment="trapezoid"):
    """Residual at the end of a tick, shape (n,), from rows as above at its start and its end."""
    known = np.concatenate((before, after[1:]))
    gains = np.atleast_1d(np.asarray(gain, dtype=float))
    weights = np.empty((len(gains), ROWS))
    set_step_weights(weights, gains, dt_s, alignment == "hold")
    return (weights.T * known).sum(axis=0)


@given(
    residual=numbers,
    slope=numbers,
    held=numbers,
    gain=st.floats(0.1, 1000.0),
    dt=st.floats(1e-5, 0.05),
)
def test_two_half_steps_equal_one_step_for_a_held_input(residual, slope, held, gain, dt):
    gain = np.array([gain])
    start = rows(0.0, 1.0, 2.0, held, residual)
    middle = rows(slope * dt / 2, 1.0, 2.0, held)
    end = rows(slope * dt, 1.0, 2.0, held)
    whole = step(start, end, gain, dt)
    middle[0] = step(start, middle, gain, dt / 2)
    assert step(middle, end, gain, dt / 2) == pytest.approx(whole, rel=1e-9, abs=1e-9)


@given(gain_dt=st.floats(1e-6, 50.0), residual=numbers, target=numbers)
def test_step_never_diverges_whatever_the_gain(gain_dt, residual, target):
    before = rows(0.0, 0.0, 0.0, 0.0, residual)
    after = rows(target * 1e-3, 0.0, 0.0, 0.0)
    found = step(before, after, np.array([gain_dt / 1e-3]), 1e-3)
    low, high = sorted((residual, target))
    assert low - 1e-9 <= found[0] <= high + 1e-9


@pytest.mark.parametrize("alignment", ["hold", "trapezoid"])
@pytest.mark.parametrize("gain", [40.0, np.linspace(10.0, 80.0, 7)], ids=["one gain", "gains"])
def test_observer_and_pure_step_agree(lwr, gain, alignment):
    observer = MomentumObserver(lwr, gain, alignment=alignment)
    times, q, dq, tau = swing(lwr, seconds=0.1)
    data = lwr.create_data()

    def sample_rows(k):
        inertia = pin.crba(lwr.model, data, q[k]).copy()
        coriolis = pin.computeCoriolisMatrix(lwr.model, data, q[k], dq[k]).copy()
        gravity = pin.computeGeneralizedGravity(lwr.model, data, q[k]).copy()
        return np.stack([np.zeros(7), inertia @ dq[k], coriolis.T @ dq[k], gravity, tau[k]])

    expected, before = np.zeros(7), sample_rows(0)
    observer.update(q[0], dq[0], tau[0], 0.0)
    for k in range(1, len(times)):
        after, dt = sample_rows(k), times[k] - times[k - 1]
        before[0] = expected
        expected = step(before, after, gain, dt, alignment)
        before = after
        np.testing.assert_allclose(observer.update(q[k], dq[k], tau[k], dt), expected, atol=1e-12)


def test_residual_converges_to_the_external_torque(lwr):
    force = np.array([1.0, -2.0, 3.0])
    times, q, dq, tau = swing(lwr, seconds=0.5, force_at_tip_in_base=force)
    observer = MomentumObserver(lwr, 200.0)
    for k in range(len(times)):
        residual = observer.update(q[k], dq[k], tau[k], 1e-3)
    np.testing.assert_allclose(residual, external_torque_of(lwr, q[-1], force), atol=0.02)


def test_start_on_a_moving_arm_has_no_spike(lwr):
    _, q, dq, tau = swing(lwr, seconds=0.2, start=0.4)
    observer = MomentumObserver(lwr, 500.0)
    peak = max(
        np.abs(observer.update(*sample, 1e-3)).max() for sample in zip(q, dq, tau, strict=True)
    )
    assert np.abs(dq[0]).max() > 0.1
    assert peak < 1e-3


def test_gap_in_time_restarts_without_integrating_across_the_hole(lwr):
    times, q, dq, tau = swing(lwr, seconds=2.0)
    observer = MomentumObserver(lwr, 50.0)
    for k in range(500):
        observer.update(q[k], dq[k], tau[k], 1e-3)
    after_gap = observer.update(q[1500], dq[1500], tau[1500], times[1500] - times[499])
    assert np.abs(after_gap).max() < 1e-3
    assert np.abs(observer.update(q[1501], dq[1501], tau[1501], 1e-3)).max() < 1e-3


def test_modelled_friction_does_not_read_as_force(lwr):
    friction = JointFriction(
        viscous_Nms=np.full(JOINTS, 2.0),
        coulomb_Nm=np.full(JOINTS, 1.0),
        offset_Nm=np.zeros(JOINTS),
    )
    _, q, dq, tau = swing(lwr, seconds=1.0)
    with_friction = np.array([t + friction.torque(v) for t, v in zip(tau, dq, strict=True)])
    known, unknown = MomentumObserver(lwr, 50.0, friction=friction), MomentumObserver(lwr, 50.0)
    worst_known = worst_unknown = 0.0
    for sample in zip(q, dq, with_friction, strict=True):
        worst_known = max(worst_known, np.abs(known.update(*sample, 1e-3)).max())
        worst_unknown = max(worst_unknown, np.abs(unknown.update(*sample, 1e-3)).max())
    assert worst_known < 0.01 < 0.5 < worst_unknown


def test_the_state_with_its_smoothing_resumes_bit_equal_and_is_forgotten_by_reset(lwr):
    _, q, dq, tau = swing(lwr, seconds=0.1)
    one, other = MomentumObserver(lwr, 50.0), MomentumObserver(lwr, 50.0)
    one.smooth_momentum(np.full(7, 1e-3), q[0])
    for k in range(50):
        one.update(q[k], dq[k], tau[k], 1e-3)
    other.restore(one.state)
    sample = (q[50], dq[50] + 1e-3, tau[50], 1e-3)
    np.testing.assert_array_equal(one.update(*sample), other.update(*sample))
    handed_out = one.update(*sample)
    kept = handed_out.copy()
    one.update(*sample[:2], sample[2] + 5.0, 1e-3)
    np.testing.assert_array_equal(handed_out, kept)
    assert not handed_out.flags.writeable
    with pytest.raises(ConfigurationError, match="rows of shape"):
        one.restore(type(one.state)(np.zeros((BEFORE, 3))))
    one.reset()
    fresh = MomentumObserver(lwr, 50.0)
    for k in range(3):
        sample = (q[k], dq[k] + 1e-3 * k, tau[k], 1e-3)
        np.testing.assert_array_equal(one.update(*sample), fresh.update(*sample))


# Joint friction models.


def test_smooth_friction_opposes_motion_and_reaches_coulomb_plus_viscous():
    friction = JointFriction(viscous_Nms=[2.0], coulomb_Nm=[1.0], offset_Nm=[0.25])
    assert friction.torque(np.array([0.5]))[0] == pytest.approx(2.0 * 0.5 + 1.0 + 0.25)
    assert friction.torque(np.array([-0.5]))[0] == pytest.approx(-2.0 * 0.5 - 1.0 + 0.25)
    assert friction.torque(np.array([0.0]))[0] == pytest.approx(0.25)


def test_sigmoid_friction_is_zero_at_rest_and_follows_its_formula():
    friction = SigmoidFriction(amplitude_Nm=[0.5], slope_s_rad=[5.0], shift_rad_s=[0.04])
    assert friction.torque(np.array([0.0]))[0] == 0.0
    expected = 0.5 / (1 + np.exp(-5 * (0.3 + 0.04))) - 0.5 / (1 + np.exp(-5 * 0.04))
    assert friction.torque(np.array([0.3]))[0] == pytest.approx(expected)


def test_sigmoid_friction_levels_off_at_any_speed():
    one, ones = np.ones(4), np.array([-1.0, 1.0, -1.0, 1.0])
    friction = SigmoidFriction(amplitude_Nm=one, slope_s_rad=50.0 * ones, shift_rad_s=30.0 * one)
    # A warning is an error in this suite.
    found = friction.torque(np.array([-1e3, -1e3, 1e3, 1e3]))
    np.testing.assert_allclose(found, [1.0, -1.0, 0.0, 0.0], atol=1e-300)


def test_parameters_are_read_only_copies():
    coulomb = np.array([1.0])
    friction = JointFriction(viscous_Nms=[0.0], coulomb_Nm=coulomb, offset_Nm=[0.0])
    coulomb[0] = 9.0
    assert friction.coulomb_Nm[0] == 1.0
    assert not friction.coulomb_Nm.flags.writeable


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"viscous_Nms": [-1.0]}, "negative"),
        ({"coulomb_Nm": [1.0, 2.0]}, "differ in length"),
        ({"offset_Nm": [np.nan]}, "offset_Nm"),
        ({"reversal_speed_rad_s": 0.0}, "reversal_speed"),
    ],
)
def test_parameters_that_cannot_be_are_refused(change, match):
    sound = {"viscous_Nms": [0.1], "coulomb_Nm": [0.1], "offset_Nm": [0.0]}
    with pytest.raises(ConfigurationError, match=match):
        JointFriction(**(sound | change))
