"""Blocks, presliding, track, baseline, and the detector of slope changes.

The detector learns its threshold: alarms on falls, not on noise of any size or spectrum.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter

from identification import MULTILAYER, Identifier
from identification.friction_compensation import MultilayerMemory, bristle_step, follow_depth
from identification.multilayer_identifier import (
    Baseline,
    level_score,
    settle_baseline,
    update_baseline,
)
from identification.resampling import (
    LENGTH,
    Block,
    Track,
    least_block_s,
    mean_block,
    update_track,
)
from identification.slope_change_detector import (
    SCALES,
    block_noise_N2,
    blocks_since_change,
    filter_bank,
    initial_detector,
    restart_detector,
    update_detector,
)

BLOCK_S = 5e-3


def falls(force, speed=None, config=MULTILAYER):
    """Scores of the falls, the memory at the end, and all detections."""
    state, detections = initial_detector(), []
    speeds = np.full(len(force), 2e-3) if speed is None else speed
    for k, (f, v) in enumerate(zip(force.tolist(), speeds.tolist(), strict=True)):
        block = Block(BLOCK_S * k, BLOCK_S, 1e-5 * k, v, f, 1.0)
        state, detection = update_detector(state, block, config)
        detections.append(detection)
    return np.array([found.fall for found in detections]), state, detections


def correlated(rng, n, std, correlation_s):
    keep = np.exp(-BLOCK_S / max(correlation_s, 1e-9))
    return std * lfilter([np.sqrt(1 - keep**2)], [1, -keep], rng.standard_normal(n))


def test_filters_ignore_lines_and_measure_slope_changes():
    bank = filter_bank()
    change, rise = bank.filters.reshape(5, len(SCALES), -1)[:2]
    time = np.arange(bank.length, dtype=float)
    assert np.allclose(change @ (3.0 + 0.2 * time), 0.0, atol=1e-9)
    for i, scale in enumerate(SCALES):
        changed = np.maximum(time - (bank.length - scale - 0.5), 0.0)
        assert change[i] @ changed == pytest.approx(scale)
        assert rise[i] @ (0.2 * time) == pytest.approx(0.2 * scale)


@pytest.mark.parametrize("std", [0.001, 0.05])
@pytest.mark.parametrize("correlation_s", [0.0, 0.02])
def test_noise_alone_does_not_alarm(std, correlation_s):
    rng = np.random.default_rng(11)
    scores, *_ = falls(1.0 + correlated(rng, 24_000, std, correlation_s))
    assert np.count_nonzero(scores > 1.0) == 0


@pytest.mark.parametrize("seed", range(3))
def test_noise_alone_alarms_about_as_often_as_is_wanted(seed):
    """Once per two seconds and side at the most, and not ten times less: the threshold is tight."""
    config = replace(MULTILAYER, false_alarm_interval_s=2.0)
    noise = 0.01 * np.random.default_rng(seed).standard_normal(30_000)
    scores = [max(found.fall, found.rise) for found in falls(1.0 + noise, config=config)[2]]
    is_alarm = np.array(scores[400:]) > 1.0
    wanted = 2.0 * BLOCK_S * len(is_alarm) / 2.0
    assert 0.1 * wanted < np.count_nonzero(is_alarm[1:] & ~is_alarm[:-1]) < wanted


@pytest.mark.parametrize(("std", "correlation_s"), [(0.0045, 0.0), (0.03, 0.02)])
def test_a_release_is_found_and_its_change_point_lies_before_the_alarm(std, correlation_s):
    rng = np.random.default_rng(12)
    time = BLOCK_S * np.arange(2000)
    clean = 0.1 * np.minimum(time, 8.0) - np.clip((time - 8.0) / 0.13, 0.0, 1.0) * 0.5
    force = clean + correlated(rng, len(time), std, correlation_s)
    scores, *_ = falls(force)
    alarm = int(np.argmax(scores > 1.0))
    assert np.max(scores[:1600]) < 1.0
    assert 1600 < alarm < 1620
    since = blocks_since_change(force[alarm - 63 : alarm + 1], -1.0)
    assert abs(alarm - since - 1600) <= 4


@pytest.mark.parametrize(
    ("std", "correlation_s", "least", "most"),
    [(0.002, 0.0, 0.6, 1.4), (0.04, 0.0, 0.6, 1.4), (0.01, 0.02, 1.5, 4.0)],
)
def test_the_threshold_follows_the_noise(std, correlation_s, least, most):
    """Correlated noise counts for more than its variance; a restart keeps it, not the signal."""
    _, state, _ = falls(correlated(np.random.default_rng(13), 4000, std, correlation_s))
    assert least * std < np.sqrt(block_noise_N2(state)) < most * std
    again = restart_detector(state)
    assert again.filled == 0
    assert np.array_equal(again.variance, state.variance)


@pytest.mark.parametrize("is_slowing", [True, False])
def test_loss_of_speed_and_a_flattening_force_are_no_rupture(is_slowing):
    rng = np.random.default_rng(15)
    time = BLOCK_S * np.arange(2000)
    speed = 2e-3 * (np.clip((9.0 - time) / 0.5, 0.05, 1.0) if is_slowing else np.ones(2000))
    force = 500.0 * speed if is_slowing else 0.5 * np.minimum(time, 8.0)
    assert np.max(falls(force + 0.002 * rng.standard_normal(2000), speed)[0]) < 1.0


def test_one_odd_value_at_a_time_does_not_silence_or_fire_the_detector():
    rng = np.random.default_rng(17)
    force = 1.0 + 0.002 * rng.standard_normal(2000)
    force[500] += 5.0
    force[1500:1526] -= np.linspace(0.0, 0.5, 26)
    force[1526:] -= 0.5
    scores, *_ = falls(force)
    assert np.max(scores[600:1500]) < 1.0
    assert np.max(scores[1500:1526]) > 1.0


travel = st.floats(-2e-3, 2e-3)


@given(st.floats(-1.0, 1.0), travel, travel)
def test_bristle_steps_compose_and_stay_bounded(start, first, second):
    after = bristle_step(start, first, 3e-4)
    assert -1.0 <= after <= 1.0
    if first * second > 0.0:
        once = bristle_step(start, first + second, 3e-4)
        assert bristle_step(after, second, 3e-4) == pytest.approx(once, abs=1e-12)


def test_bristle_holds_at_rest_and_turns_after_a_reversal():
    assert bristle_step(0.7, 0.0, 3e-4) == 0.7
    assert bristle_step(1.0, -3e-3, 3e-4) == pytest.approx(-1.0, abs=1e-3)


def test_jitter_of_the_depth_does_not_turn_the_bristle():
    rng = np.random.default_rng(3)
    bristle, follower = 0.0, 0.0
    for depth in 2e-6 * np.arange(3000) + 6e-6 * rng.standard_normal(3000):
        moved = follow_depth(follower, float(depth), 2e-5)
        bristle, follower = bristle_step(bristle, moved - follower, 3e-4), moved
    assert bristle > 0.95


def test_block_is_the_time_weighted_mean_and_a_sparse_sample_one_of_its_own():
    short, long = MultilayerMemory(filled_s=0.001), MultilayerMemory(0.004, 7e-4, 0.0, 0.016, 0.5)
    assert short.filled_s < least_block_s(4e-3) <= long.filled_s
    block = mean_block(long, 0.004)
    assert block == Block(0.004, 0.004, pytest.approx(0.175), 0.0, pytest.approx(4.0), 0.5)
    block = mean_block(MultilayerMemory(0.05, 5e-3, 0.0, 0.05, 1.0), 0.05)
    assert (block.dt_s, block.force_N) == (0.05, 1.0)


def _block(time, depth, force):
    return Block(time, 5e-3, depth, 2e-3, force, 1.0)


def test_track_keeps_a_bounded_past_at_fixed_travel():
    track = Track()
    for k in range(20_000):
        track, _ = update_track(track, _block(0.005 * k, 1e-5 * k, 0.1), 2e-5)
    assert len(track.points) == LENGTH
    assert np.all(np.diff(track.points[:, 0]) >= 2e-5 - 1e-12)
    assert np.allclose(track.points[:, 5], np.diff(track.points[:, 0]).mean(), rtol=0.5)
    assert not track.points.flags.writeable


def test_baseline_finds_offset_and_a_slow_rise_but_no_noise():
    rng = np.random.default_rng(5)
    state, scores = Baseline(), []
    for k in range(1600):
        force = 0.2 + 0.003 * rng.standard_normal() + max(k - 1000, 0) * 1e-4
        state = update_baseline(state, _block(0.005 * k, 1e-5 * (k - 1000), force))
        scores.append(level_score(state, 3600.0, 1e-8))
    assert max(scores[:1000]) < 1.0
    assert max(scores[1000:1400]) > 1.0
    settled = settle_baseline(state, 0.0)
    assert settled.offset_N == pytest.approx(0.2, abs=0.002)
    assert math.sqrt(settled.variance) < 0.003


DT_S = 1e-3


def low_passed(signal, time_constant_s):
    if time_constant_s == 0.0:
        return signal
    keep = np.exp(-DT_S / time_constant_s)
    return lfilter([1.0 - keep], [1.0, -keep], signal, zi=[keep * signal[0]])[0]


def motion(n=14_000, ramp_s=0.3):
    """Rest, constant speed, rest."""
    time = DT_S * np.arange(n)
    speed = 3e-3 * np.clip((time - 1.0) / ramp_s, 0.0, 1.0)
    speed *= np.clip((time[-1] - 1.5 - time) / ramp_s, 0.0, 1.0)
    return speed, np.cumsum(speed) * DT_S


@pytest.mark.parametrize("time_constant_s", [0.0, 0.02, 0.05])
@pytest.mark.parametrize("ramp_s", [0.1, 0.5])
def test_a_needle_that_stops_has_left_no_layer(time_constant_s, ramp_s):
    """All force is viscous friction: it falls at once, the speed as known only later.

    There may be an alarm, which is retracted.
    """
    speed, depth = motion(ramp_s=ramp_s)
    rng = np.random.default_rng(int(1e3 * (time_constant_s + ramp_s)))
    force = 12_000.0 * np.maximum(depth - 2e-3, 0.0) * speed
    force += 0.01 * rng.standard_normal(len(force))
    given = low_passed(speed + 1.2e-4 * rng.standard_normal(len(speed)), time_constant_s)
    measured = depth + 6e-6 * rng.standard_normal(len(depth))
    identifier = Identifier()
    rows = zip(measured.tolist(), given.tolist(), force.tolist(), strict=True)
    found = [identifier.update(*row, DT_S) for row in rows]
    alarms = sum(estimate.rupture is not None for estimate in found)
    assert alarms <= 1
    assert sum(estimate.retracted is not None for estimate in found) == alarms
    assert not identifier.layers
