"""Velocity from position, with torque delayed to match."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from residual_signals import swing

from residual import MomentumObserver, VelocityEstimator
from residual.velocity_estimator import lag_pair_coefficients


@given(split=st.floats(0.05, 0.95), start=st.floats(-5, 5), end=st.floats(-5, 5))
def test_two_part_steps_equal_one_for_a_straight_input(split, start, end):
    def outputs(before, first, last, dt_s):
        return lag_pair_coefficients(120.0, dt_s)[:2] @ (*before, first, last)

    middle = start + split * (end - start)
    whole = outputs((1.0, -2.0), start, end, 0.01)
    part = outputs((1.0, -2.0), start, middle, 0.01 * split)
    parts = outputs(part, middle, end, 0.01 * (1 - split))
    np.testing.assert_allclose(parts, whole, atol=1e-12)


def test_velocity_of_a_ramp_is_exact_and_position_lags_by_the_stated_delay():
    estimator = VelocityEstimator(1, 200.0)
    rng = np.random.default_rng(0)
    time = 0.0
    for _ in range(400):
        dt = rng.uniform(5e-4, 2e-3)
        time += dt
        sample = estimator.update([0.3 * time], [0.0], dt)
    assert sample.settled
    assert sample.dq[0] == pytest.approx(0.3, rel=1e-9)
    assert sample.q[0] == pytest.approx(0.3 * (time - estimator.delay_s), rel=1e-9)


def test_velocity_noise_follows_its_formula():
    rng = np.random.default_rng(0)
    estimator = VelocityEstimator(200, 100.0)
    noise = [
        estimator.update(1e-5 * rng.normal(size=200), np.zeros(200), 1e-3).dq for _ in range(500)
    ]
    assert np.std(noise[200:]) == pytest.approx(1e-5 * np.sqrt(1e-3 * 100.0**3 / 4), rel=0.15)


def test_matched_delay_keeps_motion_from_reading_as_force(lwr):
    _, q, _, tau = swing(lwr, seconds=2.0)
    estimator, observer = VelocityEstimator(7, 100.0), MomentumObserver(lwr, 50.0)
    careless = MomentumObserver(lwr, 50.0)
    worst = worst_careless = 0.0
    for k in range(len(q)):
        sample = estimator.update(q[k], tau[k], 1e-3)
        if sample.settled:
            matched = observer.update(sample.q, sample.dq, sample.tau, 1e-3)
            undelayed = careless.update(q[k], sample.dq, tau[k], 1e-3)
            if k > 500:
                worst = max(worst, np.abs(matched).max())
                worst_careless = max(worst_careless, np.abs(undelayed).max())
    assert worst < 0.005
    assert worst < 0.1 * worst_careless


def test_held_torque_is_filtered_as_held():
    held = VelocityEstimator(1, 100.0, alignment="hold")
    held.update([0.0], [1.0], 1e-3)
    assert held.update([0.0], [0.0], 1e-3).tau[0] == 1.0
    sampled = VelocityEstimator(1, 100.0)
    sampled.update([0.0], [1.0], 1e-3)
    assert sampled.update([0.0], [0.0], 1e-3).tau[0] < 1.0


def test_gap_starts_the_filter_anew():
    estimator = VelocityEstimator(1, 200.0)
    for _ in range(100):
        sample = estimator.update([0.0], [0.0], 1e-3)
    assert sample.settled
    sample = estimator.update([1.0], [0.0], 0.5)
    assert not sample.settled
    assert sample.dq[0] == 0.0
