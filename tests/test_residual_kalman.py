"""The Kalman momentum observer."""

import numpy as np
import pinocchio as pin
import pytest
from residual_signals import MIDDLE, external_torque_of, swing

from residual import ConfigurationError, KalmanObserver, MomentumObserver, SampleError

QUIET = {"torque_noise_Nm": 0.05, "velocity_noise_rad_s": 0.0, "walk_Nm_per_sqrt_s": 1.0}


def test_without_velocity_noise_it_settles_on_the_momentum_residual_with_the_optimal_gain(lwr):
    gain = 1.0 / (0.05 * np.sqrt(1e-3))
    # The discrete filter's own gain: 1 - a = steady gain of the two-state Riccati equation.
    kalman = KalmanObserver(lwr, **QUIET, alignment="hold")
    momentum = MomentumObserver(lwr, gain, alignment="hold")
    data = lwr.create_data()
    gravity = pin.computeGeneralizedGravity(lwr.model, data, MIDDLE).copy()
    step = np.ones(7)
    differences = []
    for k in range(600):
        tau = gravity - (step if k > 300 else 0.0)
        ours = kalman.update(MIDDLE, np.zeros(7), tau, 1e-3)
        theirs = momentum.update(MIDDLE, np.zeros(7), tau, 1e-3)
        differences.append(np.abs(ours - theirs).max())
    assert max(differences[:301]) < 1e-9
    assert max(differences) < 0.2
    np.testing.assert_allclose(ours, step, atol=1e-3)


def test_variance_is_believable(lwr):
    rng = np.random.default_rng(1)
    noise = {"torque_noise_Nm": 0.05, "velocity_noise_rad_s": 2e-4, "walk_Nm_per_sqrt_s": 0.5}
    kalman = KalmanObserver(lwr, **noise, alignment="hold")
    gravity = pin.computeGeneralizedGravity(lwr.model, lwr.create_data(), MIDDLE).copy()
    external, scores = np.zeros(7), []
    sent = gravity + 0.05 * rng.normal(size=7)
    for k in range(4000):
        dq = 2e-4 * rng.normal(size=7)
        # The arm is held still: the controller balances what the environment adds.
        estimate = kalman.update(MIDDLE, dq, sent, 1e-3)
        if k > 500:
            scores.append((estimate - external) ** 2 / kalman.variance_Nm2)
        external = external + 0.5 * np.sqrt(1e-3) * rng.normal(size=7)
        sent = gravity - external + 0.05 * rng.normal(size=7)
    assert 0.7 < np.mean(scores) < 1.3


def test_external_torque_is_found_on_a_moving_arm(lwr):
    force = np.array([0.0, 0.0, 2.0])
    _, q, dq, tau = swing(lwr, seconds=0.5, force_at_tip_in_base=force)
    kalman = KalmanObserver(
        lwr, torque_noise_Nm=0.05, velocity_noise_rad_s=1e-5, walk_Nm_per_sqrt_s=2.0
    )
    for sample in zip(q, dq, tau, strict=True):
        estimate = kalman.update(*sample, 1e-3)
    np.testing.assert_allclose(estimate, external_torque_of(lwr, q[-1], force), atol=0.03)


def test_variance_stays_positive_and_finite_for_any_step(lwr):
    rng = np.random.default_rng(2)
    kalman = KalmanObserver(
        lwr, torque_noise_Nm=0.05, velocity_noise_rad_s=1e-4, walk_Nm_per_sqrt_s=50.0
    )
    assert np.isinf(kalman.variance_Nm2).all()
    for _ in range(500):
        kalman.update(MIDDLE, rng.normal(size=7) * 1e-3, rng.normal(size=7), rng.uniform(1e-5, 0.2))
        assert (kalman.variance_Nm2 > 0).all()
        assert np.isfinite(kalman.variance_Nm2).all()


def test_bad_sample_is_refused_and_leaves_the_state_unchanged(lwr):
    _, q, dq, tau = swing(lwr, seconds=0.05)
    kalman, twin = KalmanObserver(lwr, **QUIET), KalmanObserver(lwr, **QUIET)
    for k in range(20):
        kalman.update(q[k], dq[k], tau[k], 1e-3)
        twin.update(q[k], dq[k], tau[k], 1e-3)
    for bad in ((q[20] * np.nan, dq[20], tau[20], 1e-3), (q[20], dq[20], tau[20], -1.0)):
        with pytest.raises(SampleError):
            kalman.update(*bad)
    np.testing.assert_array_equal(
        kalman.update(q[20], dq[20], tau[20], 1e-3), twin.update(q[20], dq[20], tau[20], 1e-3)
    )


@pytest.mark.parametrize("name", QUIET)
def test_noise_that_cannot_be_is_refused(lwr, name):
    for value in (-1.0, np.nan, [1.0, 2.0]):
        with pytest.raises(ConfigurationError, match=name):
            KalmanObserver(lwr, **(QUIET | {name: value}))


def test_torque_without_noise_is_refused(lwr):
    with pytest.raises(ConfigurationError, match="positive"):
        KalmanObserver(lwr, **(QUIET | {"torque_noise_Nm": 0.0}))


def test_settings_that_cannot_work_are_refused(lwr):
    for bad in ({"alignment": "x"}, {"max_gap_s": np.nan}):
        with pytest.raises(ConfigurationError, match=next(iter(bad))):
            KalmanObserver(lwr, **QUIET, **bad)


def test_an_absurd_first_sample_does_not_poison_it(lwr):
    _, q, dq, tau = swing(lwr, seconds=0.02)
    kalman = KalmanObserver(lwr, **QUIET)
    with pytest.raises(SampleError):
        kalman.update(q[0], np.full(7, 1e308), tau[0], 1e-3)
    for k in range(10):
        assert np.isfinite(kalman.update(q[k], dq[k], tau[k], 1e-3)).all()
