"""The errors of the arm's sensors: as large as the plant model says, and no others."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.signal import welch

from groundtruth import PLANT_MODELS, TICK_s, sensors
from groundtruth.arm_plant import (
    STRIBECK_PEAK,
    BearingFriction,
    PRESLIDING_rad,
    STRIBECK_SPEED_rad_s,
)
from urdf import LWR_GEAR_RATIO

IDEAL = PLANT_MODELS["ideal"]
CLEAN = PLANT_MODELS["clean"]
FRI = PLANT_MODELS["fri"]
DEGRADED = PLANT_MODELS["degraded"]
LIMIT_Nm = np.array([176.0, 176.0, 100.0, 100.0, 100.0, 38.0, 38.0])
N = 60_000
STILL = np.zeros((N, 7))


def torque_error(plant_model, seed=0, tau=STILL, q=STILL):
    rng = np.random.default_rng(seed)
    return sensors.measured_torque(tau, q, LIMIT_Nm, plant_model, rng) - tau


def test_ideal_sensors_are_perfect():
    rng = np.random.default_rng(0)
    true = rng.standard_normal((50, 7))
    time = np.arange(50) * TICK_s
    for measured, expected in (
        (sensors.measured_position(true, IDEAL, rng), true),
        (sensors.measured_velocity(true, IDEAL, rng), true),
        (sensors.measured_torque(true, true, LIMIT_Nm, IDEAL, rng), true),
        (sensors.measured_wrench(true[:, :6], IDEAL, rng), true[:, :6]),
        (sensors.time_stamps(time, IDEAL, rng), time),
        (sensors.received_samples(50, IDEAL, rng), np.arange(50)),
    ):
        np.testing.assert_array_equal(measured, expected)


def test_clean_torque_has_stated_white_noise_and_bias():
    change = np.diff(torque_error(CLEAN), axis=0)
    # differences of white noise: variance doubles, neighbours correlate by -1/2
    expected = np.sqrt(2) * np.array(CLEAN.torque_noise_std_Nm)
    neighbours = (change[1:] * change[:-1]).mean(axis=0) / change.var(axis=0)
    errors = [torque_error(CLEAN, seed, STILL[:400], STILL[:400]) for seed in range(40)]
    start = np.array([error.mean(axis=0) for error in errors])

    np.testing.assert_allclose(change.std(axis=0), expected, rtol=0.02)
    np.testing.assert_allclose(neighbours, -0.5, atol=0.02)
    assert (np.abs(start) > np.array(CLEAN.torque_bias_min_Nm) - 0.02).all()
    assert (np.abs(start) < np.array(CLEAN.torque_bias_max_Nm) + 0.02).all()
    assert (start.min(axis=0) * start.max(axis=0) < 0.0).all()


@pytest.mark.slow
@pytest.mark.parametrize("plant_model", [FRI, DEGRADED], ids=["fri", "degraded"])
def test_torque_noise_has_the_stated_spread_behind_an_8_Hz_filter(plant_model):
    noise_s = plant_model.torque_noise_correlation_s
    std_Nm = plant_model.torque_noise_std_Nm
    still = np.zeros((10 * N, 7))
    noisy = replace(
        IDEAL, torque_noise_std_Nm=std_Nm, torque_noise_correlation_s=noise_s
    )
    noise = torque_error(noisy, tau=still, q=still) / np.array(std_Nm)
    frequency, densities = welch(noise, fs=1.0 / TICK_s, nperseg=8192, axis=0)
    density = densities.mean(axis=1)
    low = density[(frequency > 0.2) & (frequency < 1.0)].mean()
    at_8_Hz, at_80_Hz = np.interp([8.0, 80.0], frequency, density) / low

    np.testing.assert_allclose(noise.std(axis=0), 1.0, rtol=0.03)
    assert np.abs(noise[:3]).max() > 0.1  # at once as large, not rising from zero
    # one pole at 8 Hz: half the density there, a hundredth at 80 Hz
    assert (at_8_Hz, at_80_Hz, low) == (
        pytest.approx(0.5, rel=0.15),
        pytest.approx(0.01, rel=0.25),
        pytest.approx(4.0 * noise_s, rel=0.1),
    )


@pytest.mark.slow
def test_torque_drift_has_the_stated_spread():
    wide = replace(
        IDEAL, torque_random_walk_std_per_sqrt_min=3e-5, size_spread=FRI.size_spread
    )
    few = STILL[:5_000]
    errors_Nm = np.array([torque_error(wide, seed, few, few) for seed in range(12)])
    step = np.diff(errors_Nm, axis=1).std(axis=1)
    factor = step / LIMIT_Nm / (3e-5 * np.sqrt(TICK_s / 60.0))
    others = ("torque_noise_std_Nm", "torque_bias_min_Nm", "torque_bias_max_Nm")
    quiet = replace(CLEAN, **dict.fromkeys(others, (0.0,) * 7))
    ends_Nm = np.array([torque_error(quiet, seed)[[0, -1]] for seed in range(60)])
    expected = np.hypot(
        CLEAN.torque_drift_std_per_min, CLEAN.torque_random_walk_std_per_sqrt_min
    )

    assert 0.48 < factor.min() < 0.65 < 1.6 < factor.max() < 2.05
    np.testing.assert_allclose(ends_Nm[:, 0], 0.0, atol=1e-15)
    # 420 draws: 3.5 % standard error
    assert (ends_Nm[:, 1] / LIMIT_Nm).std() == pytest.approx(expected, rel=0.12)


def test_ripple_repeats_twice_per_motor_turn():
    only_ripple = replace(IDEAL, torque_ripple=1e-4)
    turn = np.linspace(0.0, 1.0, 2001)[:, None] * 2.0 * np.pi / np.array(LWR_GEAR_RATIO)
    error = torque_error(only_ripple, tau=np.zeros_like(turn), q=turn)

    np.testing.assert_allclose(error[:1001], error[1000:], atol=1e-12)
    np.testing.assert_allclose(error.max(axis=0), 1e-4 * LIMIT_Nm, rtol=1e-5)
    assert not np.allclose(error[:501], error[500:1001], atol=1e-4)


@given(
    signal=arrays(float, (30, 3), elements=st.floats(-5.0, 5.0)),
    width=st.floats(0.0, 2.0),
)
def test_backlash_stays_within_its_width(signal, width):
    out = sensors.backlash(signal, np.full(3, width))
    slack = width - np.abs(out - signal)
    has_moved = np.diff(out, axis=0) != 0.0

    assert slack.min() >= -1e-12
    assert (np.abs(slack[1:][has_moved]) < 1e-9).all()


def test_position_is_rounded_and_velocity_noisy_or_missing():
    rng = np.random.default_rng(0)
    true = np.linspace(0.0, 1.0, 20_000)[:, None] * np.ones(7)
    measured = sensors.measured_position(true, CLEAN, rng)
    steps = measured / CLEAN.position_step_rad
    rounding_rad = CLEAN.position_step_rad / np.sqrt(12)
    expected_rad = np.hypot(CLEAN.position_noise_std_rad, rounding_rad)
    velocity_rad_s = sensors.measured_velocity(STILL, CLEAN, rng)

    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    assert ((measured - true).std(), velocity_rad_s.std()) == pytest.approx(
        (expected_rad, 2e-4), rel=0.02
    )
    assert sensors.measured_velocity(STILL, DEGRADED, rng) is None


def test_wrench_noise_and_drift_have_the_stated_spread():
    wrench = np.zeros((N, 6))
    rngs = map(np.random.default_rng, range(20))
    readings = np.stack([sensors.measured_wrench(wrench, CLEAN, rng) for rng in rngs])
    white = np.diff(readings[:3], axis=1).std(axis=1) / np.sqrt(2)
    ends = readings[:, -2000:].mean(axis=1)

    np.testing.assert_allclose(white / CLEAN.ft_noise_std, 1.0, rtol=0.03)
    # 120 draws, means of noise included: 8 % standard error
    assert (ends / CLEAN.ft_drift_std_per_min).std() == pytest.approx(1.0, rel=0.25)


def test_jitter_keeps_order_and_losses_are_as_stated():
    true = np.arange(N) * TICK_s
    wild = replace(DEGRADED, clock_jitter_std_s=1e-3)
    wild_s, stamps_s = (
        sensors.time_stamps(true, model, np.random.default_rng(0))
        for model in (wild, DEGRADED)
    )
    received = sensors.received_samples(10 * N, DEGRADED, np.random.default_rng(0))
    gaps = np.diff(received) - 1

    assert (np.diff(wild_s) > 0.0).all()
    assert (stamps_s - true).std() == pytest.approx(
        DEGRADED.clock_jitter_std_s, rel=0.02
    )
    assert received[[0, -1]].tolist() == [0, 10 * N - 1]
    # touching losses may add up; three per cent of a thousandth
    assert {1, 2, 3} <= set(gaps) <= set(range(2 * DEGRADED.drop_max_samples + 1))
    assert (gaps > 0).sum() / (10 * N) == pytest.approx(
        DEGRADED.drop_probability, rel=0.15
    )


COULOMB = 1e-3
LEVEL_Nm = COULOMB * LIMIT_Nm
STEP_s = 2.5e-4


def bearings(seed=0, **change):
    model = replace(IDEAL, joint_coulomb=COULOMB, **change)
    return BearingFriction(model, LIMIT_Nm, np.random.default_rng(seed))


@pytest.mark.parametrize(
    ("fraction", "is_held"), [(0.5, True), (0.95, True), (1.6, False)]
)
def test_a_resting_joint_holds_a_push_and_slides_beyond_the_peak(fraction, is_held):
    friction = bearings()
    inertia = 0.01
    q = np.zeros(7)
    dq = np.zeros(7)
    for _ in range(8000):  # Euler steps as long as the plant's
        # A little damping of the tissue's kind: the bristle would ring for ever.
        damping = 20.0 * inertia * dq
        torque = fraction * LEVEL_Nm + friction.step(dq, STEP_s) - damping
        dq = dq + STEP_s * torque / inertia
        q += STEP_s * dq

    assert ((q < 20.0 * PRESLIDING_rad) == is_held).all()


@pytest.mark.parametrize("direction", [1.0, -1.0])
@pytest.mark.parametrize(
    ("speed", "level"),
    [(1e-3, STRIBECK_PEAK), (STRIBECK_SPEED_rad_s, 1.0 + 0.5 / np.e), (1.0, 1.0)],
)
def test_sliding_friction_opposes_motion_at_stribeck_level(speed, level, direction):
    friction = bearings()
    dq = np.full(7, direction * speed)
    for _ in range(round(20.0 * PRESLIDING_rad / (speed * STEP_s)) + 2):
        torque = friction.step(dq, STEP_s)

    np.testing.assert_allclose(torque, -direction * level * LEVEL_Nm, rtol=1e-3)


def test_joint_sizes_are_drawn_within_the_factor():
    dq = np.ones(7)  # fast sliding, at once beyond presliding
    arms = (bearings(seed, size_spread=2.0) for seed in range(60))
    fraction = np.array([-friction.step(dq, 1.0) / LEVEL_Nm for friction in arms])

    assert 0.5 <= fraction.min() < 0.55
    assert 1.9 < fraction.max() <= 2.0
    assert np.median(fraction) == pytest.approx(1.0, rel=0.1)
