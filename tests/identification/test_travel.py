"""Depth and speed from noisy samples, whatever of the speed is given."""

import math

import numpy as np
import pytest

from identification import Identifier, SampleStatus
from identification.multilayer.speed_filter import NO_TREND, follow_speed
from identification.sample_filter import (
    LEAST_DEPTHS,
    OF_DEPTH,
    SAMPLE_MEMORY,
    filter_travel,
)


def motion(seconds=10.0, rate_hz=1000.0, jitter=0.0, seed=0):
    """Rest, 4 mm/s from 1 s on, rest from 5 s on, back at 4 mm/s from 7 s on; ramps
    of 0.1 s."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(0.0, seconds, 1.0 / rate_hz)
    t_s = t_s + jitter / rate_hz * rng.uniform(-0.5, 0.5, len(t_s))
    corners = [0.0, 1.0, 1.1, 5.0, 5.1, 7.0, 7.1, 99.0]
    speed = 1e-3 * np.interp(t_s, corners, [0, 0, 4, 4, 0, 0, -4, -4])
    fine = np.arange(-0.01, seconds + 0.01, 1e-4)
    travel = 1e-7 * np.cumsum(np.interp(fine, corners, [0, 0, 4, 4, 0, 0, -4, -4]))
    return t_s, np.interp(t_s, fine, travel), speed


def speed_given(kind, t_s, depth_m, speed_m_s, rng):
    if kind == "none":
        return np.full(len(t_s), math.nan)
    if kind == "measured":
        return speed_m_s + 1.4e-4 * rng.standard_normal(len(t_s))
    # Two lags of 5 ms, differentiated: 10 ms late, and its noise is smooth.
    found = np.zeros(len(t_s))
    first = depth_m[0]
    second = depth_m[0]
    for k in range(1, len(t_s)):
        dt_s = t_s[k] - t_s[k - 1]
        keep = math.exp(-200.0 * dt_s)
        first = depth_m[k] + keep * (first - depth_m[k])
        second = first + keep * (second - first)
        found[k] = (first - second) * (1.0 - keep) / (keep * dt_s)
    return found


def filtered(t_s, depth_m, speed_m_s):
    memory = np.zeros(SAMPLE_MEMORY)
    steps = np.diff(t_s, prepend=t_s[0] - 1e-3)
    rows = zip(depth_m.tolist(), speed_m_s.tolist(), steps.tolist(), strict=True)
    found = [filter_travel(*row, not math.isnan(row[1]), memory) for row in rows]
    return np.array(found), math.sqrt(memory[OF_DEPTH])


@pytest.mark.parametrize("given", ["none", "measured", "estimated"])
@pytest.mark.parametrize("noise_m", [1.4e-5, 1.2e-4])
@pytest.mark.parametrize(
    ("rate_hz", "jitter"), [(1000.0, 0.0), (1000.0, 0.6), (200.0, 0.0)]
)
def test_noise_is_learned_and_what_it_leaves_is_stated(given, noise_m, rate_hz, jitter):
    rng = np.random.default_rng(1)
    t_s, depth_m, speed_m_s = motion(rate_hz=rate_hz, jitter=jitter)
    noisy_m = depth_m + noise_m * rng.standard_normal(len(t_s))
    found, known_m = filtered(
        t_s, noisy_m, speed_given(given, t_s, noisy_m, speed_m_s, rng)
    )
    assert known_m == pytest.approx(noise_m, rel=0.15)
    steady = (t_s > 2.0) & (t_s < 5.0)
    off_m, off_m_s = (found[:, :2] - np.column_stack((depth_m, speed_m_s)))[steady].T
    std_m, std_m_s = found[steady, 2:].mean(axis=0)
    # A filter that forgets within 0.1 s has few independent errors in 3 s.
    assert 0.3 * std_m < np.std(off_m) < 1.6 * std_m
    assert 0.3 * std_m_s < np.std(off_m_s) < 1.6 * std_m_s
    assert std_m < 0.5 * noise_m
    assert std_m_s < 1.5e-4


@pytest.mark.parametrize("given", ["none", "measured", "estimated"])
def test_a_needle_that_stops_or_turns_is_followed(given):
    rng = np.random.default_rng(2)
    t_s, depth_m, speed_m_s = motion()
    noisy_m = depth_m + 1.4e-5 * rng.standard_normal(len(t_s))
    found, _ = filtered(t_s, noisy_m, speed_given(given, t_s, noisy_m, speed_m_s, rng))
    assert np.abs(found[:, 0] - depth_m).max() < 6e-5
    late = np.abs(found[:, 1] - speed_m_s) > 0.5e-3
    assert late.mean() * t_s[-1] < 0.3
    assert not late[(t_s > 5.3) & (t_s < 7.0)].any()


def test_rest_of_a_rounded_depth_teaches_no_noise():
    t_s, depth_m, _ = motion()
    rounded = np.round(depth_m / 1e-5) * 1e-5
    found, known_m = filtered(t_s, rounded, np.full(len(t_s), math.nan))
    assert known_m > 1e-6
    assert np.abs(found[(t_s > 2.0) & (t_s < 5.0), 1] - 4e-3).max() < 4e-4


@pytest.mark.parametrize("step_m", [5e-5, 1.2e-4])
def test_smooth_noise_of_a_coarse_encoder_is_learned_too(step_m):
    t_s, depth_m, speed_m_s = motion()
    at_m = np.zeros(len(t_s))
    rate_m_s = np.zeros(len(t_s))
    for part, rng in zip(
        (0.5, 0.3, 0.2), np.random.default_rng(6).spawn(3), strict=True
    ):
        noisy_m = part * depth_m + 0.3 * step_m * rng.standard_normal(len(t_s))
        rounded_m = np.round(noisy_m / step_m) * step_m
        rate = speed_given("estimated", t_s, rounded_m, None, rng)
        rate_m_s += rate
        at_m += rounded_m[0] + np.cumsum(rate * np.diff(t_s, prepend=t_s[0]))
    found, _ = filtered(t_s, at_m, rate_m_s)
    steady = (t_s > 2.0) & (t_s < 5.0)
    off_m_s = (found[:, 1] - speed_m_s)[steady]
    assert np.std(off_m_s) < 0.25 * np.std((rate_m_s - speed_m_s)[steady])
    assert 0.3 < np.std(off_m_s) / found[steady, 3].mean() < 3.0


@pytest.mark.parametrize("lost_s", [0.0, 0.01, 0.3])
@pytest.mark.parametrize("rate_hz", [1000.0, 200.0])
def test_a_swing_is_no_noise_though_samples_are_late_or_lost(rate_hz, lost_s):
    rng = np.random.default_rng(4)
    memory = np.zeros(SAMPLE_MEMORY)
    least = []
    t_s = 0.0
    for k in range(int(14.0 * rate_hz)):
        dt_s = (lost_s if k % int(2.0 * rate_hz) == 0 else 0.0) + rng.uniform(
            0.8, 1.2
        ) / rate_hz
        t_s += dt_s
        swing_m = (
            2e-4 * math.sin(2.0 * math.pi * 6.0 * t_s) if k > 8.0 * rate_hz else 0.0
        )
        filter_travel(
            swing_m + 2e-6 * float(rng.standard_normal()), 0.0, dt_s, False, memory
        )
        least.append(memory[LEAST_DEPTHS])
    forgotten = math.exp(6.0 / 8.0)  # of the least, in 6 s of swing
    assert max(least[int(3.0 * rate_hz) :]) < 2.0 * forgotten * 4e-12 / (
        0.016 * rate_hz
    )


def test_after_a_gap_it_starts_anew():
    t_s, depth_m, speed_m_s = motion()
    kept = (t_s < 2.0) | (t_s > 4.0)
    for given in (speed_m_s[kept], np.full(kept.sum(), math.nan)):
        found, _ = filtered(t_s[kept], depth_m[kept], given)
        assert np.abs(found[:, 0] - depth_m[kept]).max() < 1e-4
        later = (t_s[kept] > 4.1) & (t_s[kept] < 5.0)
        assert np.abs(found[later, 1] - 4e-3).max() < 1e-4


def test_nobody_need_measure_the_speed():
    rng = np.random.default_rng(4)
    identifier = Identifier()
    for k in range(9000):
        depth = 2.5e-6 * k - 5e-3
        force = 60.0 * max(depth, 0.0) if depth < 0.01 else 0.2
        noise = rng.standard_normal(2).tolist()
        found = identifier.update(
            depth + 1e-4 * noise[0], None, force + 0.01 * noise[1], 1e-3
        )
        assert found.status is SampleStatus.OK
    (layer,) = identifier.layers
    assert layer.rupture.depth_m == pytest.approx(0.01, abs=3e-4)


def test_the_speed_of_the_law_is_quiet_in_a_slow_change_and_stops_with_the_needle():
    rng = np.random.default_rng(1)
    noise = (2.5e-3, 0.05)
    speed = (3.0 + 0.5 * np.sin(0.002 * np.arange(1600.0))) * (np.arange(1600) < 1200)
    measured = speed + noise[1] * rng.standard_normal(1600)
    depth = 0.01 * np.cumsum(speed) + 1.6e-3 * rng.standard_normal(1600)
    found = np.zeros(1600)
    trend = NO_TREND
    for k in range(1600):
        found[k], trend = follow_speed(trend, depth[k], measured[k], noise, 0.01)
    assert np.sqrt(np.mean((found - speed)[200:1199] ** 2)) < 0.2 * noise[1]
    assert np.abs(found - measured)[1200:].max() < 4.01 * noise[1]
    assert np.abs(found - speed)[1250:].max() < 0.5 * noise[1]
