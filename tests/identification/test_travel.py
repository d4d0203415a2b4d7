"""Depth and speed from noisy samples, whatever of the speed is given."""

import math

import numpy as np
import pytest

from foundation.records import as_record, from_record
from identification import CheckConfig
from identification.mixture.speed_filter import FIRST_SPEED_FILTER, filter_speed
from identification.travel_filter import (
    TravelState,
    filter_travel,
)
from residual import VelocityEstimator
from tests.identification.worlds import noisy

GAP_S = CheckConfig().gap_s


def motion(seconds=10.0, rate_hz=1000.0, jitter=0.0):
    """Times, depths and speeds of a needle, shape (n,).

    It rests, moves at 4 mm/s from 1 s on, rests from 5 s on, and moves back from 7 s
    on; ramps last 0.1 s.
    """
    t_s = np.arange(0.0, seconds, 1.0 / rate_hz)
    t_s += jitter / rate_hz * np.random.default_rng(0).uniform(-0.5, 0.5, len(t_s))
    course = [0.0, 1.0, 1.1, 5.0, 5.1, 7.0, 7.1, 99.0], [0, 0, 4, 4, 0, 0, -4, -4]
    fine = np.arange(-0.01, seconds + 0.01, 1e-4)
    travel = 1e-7 * np.cumsum(np.interp(fine, *course))
    return t_s, np.interp(t_s, fine, travel), 1e-3 * np.interp(t_s, *course)


def speed_given(kind, t_s, depth_m, speed_m_s, rng):
    if kind == "none":
        return np.full(len(t_s), math.nan)
    if kind == "measured":
        return speed_m_s + 1.4e-4 * rng.standard_normal(len(t_s))
    # It is 10 ms late, and its noise is smooth.
    estimator = VelocityEstimator(1, bandwidth_per_s=200.0)
    steps_s = np.diff(t_s, prepend=t_s[0] - 1e-3).tolist()
    pairs = zip(depth_m, steps_s, strict=True)
    return np.array([estimator.update([m], [0.0], dt_s).dq[0] for m, dt_s in pairs])


def filtered(t_s, depth_m, speed_m_s):
    """What the filter makes of depths, shape (n,), and the noise it has learnt.

    A speed that is not a number counts as not measured.
    """
    record = as_record(TravelState())
    columns = (depth_m, speed_m_s, np.diff(t_s, prepend=t_s[0] - 1e-3))
    travels = []
    for row in np.transpose(np.broadcast_arrays(*columns)).tolist():
        filter_travel(*row, not math.isnan(row[1]), GAP_S, record[0])
        state = from_record(TravelState, record)
        depth = state.depth
        squares = (depth.noise, state.speed.noise, depth.single.variance)
        values = (depth.value, state.speed.value, depth.means.min_variance)
        travels.append((*values, *map(math.sqrt, squares)))
    return np.rec.fromrecords(
        travels,
        names="depth_m,speed_m_s,min_variance_m2,depth_std_m,speed_std_m_s,learned_m",
    )


@pytest.mark.slow
@pytest.mark.parametrize("given", ["none", "measured", "estimated"])
@pytest.mark.parametrize("noise_m", [1.4e-5, 1.2e-4])
@pytest.mark.parametrize(("rate_hz", "jitter"), [(1000.0, 0.6), (200.0, 0.0)])
def test_noise_is_learned_and_its_rest_is_stated(given, noise_m, rate_hz, jitter):
    rng = np.random.default_rng(1)
    t_s, depth_m, speed_m_s = motion(rate_hz=rate_hz, jitter=jitter)
    noisy_m = depth_m + noise_m * rng.standard_normal(len(t_s))
    travel = filtered(t_s, noisy_m, speed_given(given, t_s, noisy_m, speed_m_s, rng))

    steady = (t_s > 2.0) & (t_s < 5.0)
    stated = np.array([travel.depth_std_m, travel.speed_std_m_s])[:, steady].mean(
        axis=1
    )
    errors = np.array([travel.depth_m - depth_m, travel.speed_m_s - speed_m_s])
    ratios = errors[:, steady].std(axis=1) / stated

    assert travel.learned_m[-1] == pytest.approx(noise_m, rel=0.15)
    # A filter that forgets within 0.1 s has few independent errors in 3 s.
    assert 0.3 < ratios.min() < ratios.max() < 1.6
    assert (stated < [0.5 * noise_m, 1.5e-4]).all()


@pytest.mark.slow
@pytest.mark.parametrize("given", ["none", "measured", "estimated"])
def test_a_needle_that_stops_or_turns_is_followed(given):
    rng = np.random.default_rng(2)
    t_s, depth_m, speed_m_s = motion()
    noisy_m = depth_m + 1.4e-5 * rng.standard_normal(len(t_s))
    travel = filtered(t_s, noisy_m, speed_given(given, t_s, noisy_m, speed_m_s, rng))

    late = np.abs(travel.speed_m_s - speed_m_s) > 0.5e-3

    assert np.abs(travel.depth_m - depth_m).max() < 6e-5
    assert late.mean() * t_s[-1] < 0.3
    assert not late[(t_s > 5.3) & (t_s < 7.0)].any()


def test_rest_of_a_rounded_depth_teaches_no_noise():
    t_s, depth_m, _ = motion()
    rounded = np.round(depth_m / 1e-5) * 1e-5
    travel = filtered(t_s, rounded, math.nan)
    steady_m_s = travel.speed_m_s[(t_s > 2.0) & (t_s < 5.0)]

    assert travel.learned_m[-1] > 1e-6
    assert np.abs(steady_m_s - 4e-3).max() < 4e-4


@pytest.mark.parametrize("step_m", [5e-5, 1.2e-4])
def test_smooth_noise_of_an_encoder_is_learned(step_m):
    t_s, depth_m, speed_m_s = motion()
    first_m = 0.0
    rate_m_s = np.zeros(len(t_s))
    for fraction, rng in zip(
        (0.5, 0.3, 0.2), np.random.default_rng(6).spawn(3), strict=True
    ):
        noisy_m = fraction * depth_m + 0.3 * step_m * rng.standard_normal(len(t_s))
        rounded_m = np.round(noisy_m / step_m) * step_m
        first_m += rounded_m[0]
        rate_m_s += speed_given("estimated", t_s, rounded_m, None, rng)
    at_m = first_m + np.cumsum(rate_m_s * np.diff(t_s, prepend=t_s[0]))
    travel = filtered(t_s, at_m, rate_m_s)
    steady = (t_s > 2.0) & (t_s < 5.0)
    error_m_s = (travel.speed_m_s - speed_m_s)[steady]

    assert np.std(error_m_s) < 0.25 * np.std((rate_m_s - speed_m_s)[steady])
    assert 0.3 < np.std(error_m_s) / travel.speed_std_m_s[steady].mean() < 3.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rate_hz", "lost_s"), [(1000.0, 0.01), (200.0, 0.0), (200.0, 0.3)]
)
def test_a_swing_is_no_noise(rate_hz, lost_s):
    rng = np.random.default_rng(4)
    steps_s = rng.uniform(0.8, 1.2, int(14.0 * rate_hz)) / rate_hz
    steps_s[:: int(2.0 * rate_hz)] += lost_s
    t_s = np.cumsum(steps_s)
    is_swinging = np.arange(len(t_s)) > 8.0 * rate_hz
    swing_m = 2e-4 * np.sin(2.0 * math.pi * 6.0 * t_s) * is_swinging
    noise_m = 2e-6 * rng.standard_normal(len(t_s))
    least_m2 = filtered(t_s, swing_m + noise_m, math.nan).min_variance_m2
    forgotten = math.exp(6.0 / 8.0)  # of the least, in 6 s of swing
    of_a_mean = 4e-12 / (0.016 * rate_hz)

    assert least_m2[int(3.0 * rate_hz) :].max() < 2.0 * forgotten * of_a_mean


def test_after_a_gap_it_starts_anew():
    is_kept = np.abs(motion()[0] - 3.0) > 1.0
    t_s, depth_m, speed_m_s = (column[is_kept] for column in motion())
    for speeds_m_s in (speed_m_s, math.nan):
        travel = filtered(t_s, depth_m, speeds_m_s)
        assert np.abs(travel.depth_m - depth_m).max() < 1e-4
        assert np.abs(travel.speed_m_s - 4e-3)[(t_s > 4.1) & (t_s < 5.0)].max() < 1e-4


def filtered_slowly(depth_mm, measured_mm_s):
    """Speeds of the slow filter at 100 Hz and its state, told of usual noise."""
    speeds_mm_s = []
    state = FIRST_SPEED_FILTER
    for row in zip(depth_mm, measured_mm_s, strict=True):
        speed_mm_s, state = filter_speed(state, *row, 2.5e-3, 0.05, 0.01)
        speeds_mm_s.append(speed_mm_s)
    return np.array(speeds_mm_s), state


def test_the_slow_speed_filter_is_quiet_and_stops():
    rng = np.random.default_rng(1)
    speed = (3.0 + 0.5 * np.sin(0.002 * np.arange(1600.0))) * (np.arange(1600) < 1200)
    measured = speed + 0.05 * rng.standard_normal(1600)
    depth = 0.01 * np.cumsum(speed) + 1.6e-3 * rng.standard_normal(1600)
    filtered_speed, _ = filtered_slowly(depth, measured)
    error = filtered_speed - speed

    assert np.sqrt(np.mean(error[200:1199] ** 2)) < 0.2 * 0.05
    assert np.abs(filtered_speed - measured)[1200:].max() < 4.01 * 0.05
    assert np.abs(error)[1250:].max() < 0.5 * 0.05


@pytest.mark.parametrize("acceleration_mm_s2", [0.3, -0.3])
def test_the_slow_speed_filter_follows_an_even_acceleration(acceleration_mm_s2):
    """Its state holds the acceleration: no lag of the speed is left."""
    time_s = 0.01 * np.arange(600)
    speed = 4.0 + acceleration_mm_s2 * time_s
    depth = 4.0 * time_s + 0.5 * acceleration_mm_s2 * time_s**2
    filtered_speed, state = filtered_slowly(depth, speed)

    assert filtered_speed[-1] == pytest.approx(speed[-1], abs=1e-5)
    assert state.mean[2] == pytest.approx(acceleration_mm_s2, rel=1e-3)


@pytest.mark.parametrize("shift_m", [-0.105, 0.3])
@pytest.mark.parametrize("noise_m", [0.0, 1.4e-5])
def test_the_zero_of_depth_changes_nothing(shift_m, noise_m):
    t_s, clean_m, _ = motion()
    depth_m = noisy(clean_m, noise_m, 2)
    before, after = (filtered(t_s, depth_m + m, math.nan) for m in (0.0, shift_m))

    assert np.abs(after.depth_m - shift_m - before.depth_m).max() < 1e-7
    # Rounding of depths so far from zero is noise, of which exact ones have none.
    assert np.abs(after.speed_m_s - before.speed_m_s).max() < 5e-5
