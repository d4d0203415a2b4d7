"""The detector learns its threshold: alarms on falls, not on noise of any size or spectrum."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from identification.config import MULTILAYER
from identification.resampling import Block
from identification.slope_change_detector import (
    SCALES,
    block_noise_N2,
    blocks_since_change,
    filter_bank,
    initial_detector,
    restart_detector,
    update_detector,
)

DT_S = 5e-3


def falls(force, speed=None):
    state, scores = initial_detector(), []
    speeds = np.full(len(force), 2e-3) if speed is None else speed
    for k, (f, v) in enumerate(zip(force, speeds, strict=True)):
        block = Block(DT_S * k, DT_S, 1e-5 * k, float(v), float(f), 1.0)
        state, detection = update_detector(state, block, MULTILAYER)
        scores.append(detection.fall)
    return np.array(scores), state


def correlated(rng, n, std, correlation_s):
    keep = np.exp(-DT_S / max(correlation_s, 1e-9))
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
    scores, _ = falls(1.0 + correlated(rng, 24_000, std, correlation_s))
    assert np.count_nonzero(scores > 1.0) == 0


@pytest.mark.parametrize("seed", range(3))
def test_noise_alone_alarms_about_as_often_as_is_wanted(seed):
    """Once per two seconds and side at the most, and not ten times less: the threshold is tight."""
    config = replace(MULTILAYER, false_alarm_interval_s=2.0)
    noise = 0.01 * np.random.default_rng(seed).standard_normal(30_000)
    state, scores = initial_detector(), []
    for k, force in enumerate(noise.tolist()):
        block = Block(DT_S * k, DT_S, 1e-5 * k, 2e-3, 1.0 + force, 1.0)
        state, detection = update_detector(state, block, config)
        scores.append(max(detection.fall, detection.rise))
    is_alarm = np.array(scores[400:]) > 1.0
    wanted = 2.0 * DT_S * len(is_alarm) / 2.0
    assert 0.1 * wanted < np.count_nonzero(is_alarm[1:] & ~is_alarm[:-1]) < wanted


@pytest.mark.parametrize(("std", "correlation_s"), [(0.0045, 0.0), (0.03, 0.02)])
def test_a_release_is_found_and_its_change_point_lies_before_the_alarm(std, correlation_s):
    rng = np.random.default_rng(12)
    time = DT_S * np.arange(2000)
    clean = 0.1 * np.minimum(time, 8.0) - np.clip((time - 8.0) / 0.13, 0.0, 1.0) * 0.5
    force = clean + correlated(rng, len(time), std, correlation_s)
    scores, _ = falls(force)
    alarm = int(np.argmax(scores > 1.0))
    assert np.max(scores[:1600]) < 1.0
    assert 1600 < alarm < 1620
    since = blocks_since_change(force[alarm - 63 : alarm + 1], -1.0)
    assert abs(alarm - since - 1600) <= 4


def test_the_threshold_follows_the_noise():
    rng = np.random.default_rng(13)
    _, quiet = falls(correlated(rng, 3000, 0.002, 0.0))
    _, loud = falls(correlated(rng, 3000, 0.04, 0.0))
    assert np.sqrt(block_noise_N2(quiet)) == pytest.approx(0.002, rel=0.4)
    assert np.sqrt(block_noise_N2(loud)) == pytest.approx(0.04, rel=0.4)


def test_correlated_noise_counts_for_more_than_its_variance():
    rng = np.random.default_rng(14)
    _, state = falls(correlated(rng, 6000, 0.01, 0.02))
    assert 1.5 * 0.01 < np.sqrt(block_noise_N2(state)) < 4.0 * 0.01


def test_loss_of_speed_is_no_rupture():
    rng = np.random.default_rng(15)
    time = DT_S * np.arange(2000)
    speed = 2e-3 * np.clip((9.0 - time) / 0.5, 0.05, 1.0)
    force = 500.0 * speed + 0.002 * rng.standard_normal(len(time))
    scores, _ = falls(force, speed)
    assert np.max(scores) < 1.0


def test_a_flattening_force_is_no_rupture():
    rng = np.random.default_rng(16)
    time = DT_S * np.arange(2000)
    scores, _ = falls(0.5 * np.minimum(time, 8.0) + 0.002 * rng.standard_normal(len(time)))
    assert np.max(scores) < 1.0


def test_one_odd_value_at_a_time_does_not_silence_or_fire_the_detector():
    rng = np.random.default_rng(17)
    force = 1.0 + 0.002 * rng.standard_normal(2000)
    force[500] += 5.0
    force[1500:1526] -= np.linspace(0.0, 0.5, 26)
    force[1526:] -= 0.5
    scores, _ = falls(force)
    assert np.max(scores[600:1500]) < 1.0
    assert np.max(scores[1500:1526]) > 1.0


def test_restart_keeps_the_noise_and_forgets_the_signal():
    rng = np.random.default_rng(18)
    _, state = falls(correlated(rng, 3000, 0.01, 0.0))
    again = restart_detector(state)
    assert again.filled == 0
    assert np.array_equal(again.variance, state.variance)
