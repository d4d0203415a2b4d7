"""Blocks, presliding, track, baseline and the lag of the speed."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter

from identification import Identifier
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
    SpeedLag,
    Track,
    least_block_s,
    mean_block,
    update_lag,
    update_track,
)

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


def test_block_is_the_time_weighted_mean():
    short, long = MultilayerMemory(filled_s=0.001), MultilayerMemory(0.004, 7e-4, 0.0, 0.016, 0.5)
    assert short.filled_s < least_block_s(4e-3)
    assert long.filled_s >= least_block_s(4e-3)
    block = mean_block(long, 0.004)
    assert block == Block(0.004, 0.004, pytest.approx(0.175), 0.0, pytest.approx(4.0), 0.5)


def test_sparse_samples_are_blocks_of_their_own():
    block = mean_block(MultilayerMemory(0.05, 5e-3, 0.0, 0.05, 1.0), 0.05)
    assert block.dt_s >= least_block_s(5e-3)
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


def learned(speed, depth, block=5):
    state, out = SpeedLag(), []
    for k in range(0, len(speed) - block + 1, block):
        part = slice(k, k + block)
        state, handed = update_lag(
            state,
            Block(k * DT_S, block * DT_S, depth[part].mean(), speed[part].mean(), 0.0, 1.0),
        )
        out.append(handed.speed_m_s)
    return state.lag_s, np.array(out)


@pytest.mark.parametrize("time_constant_s", [0.02, 0.05, 0.1])
@pytest.mark.parametrize("noise_m", [0.0, 6e-6])
def test_the_time_constant_is_learned_and_the_speed_restored(time_constant_s, noise_m):
    speed, depth = motion()
    rng = np.random.default_rng(5)
    given = low_passed(speed, time_constant_s)
    found, restored = learned(given, depth + noise_m * rng.standard_normal(len(depth)))
    assert found == pytest.approx(time_constant_s, rel=0.1)
    blocks = speed.reshape(-1, 5).mean(axis=1)
    late = len(blocks) // 2
    assert np.max(np.abs(restored - blocks)[late:]) < 0.15e-3
    assert np.max(np.abs(given.reshape(-1, 5).mean(axis=1) - blocks)[late:]) > 0.15e-3


@pytest.mark.parametrize("seed", range(10))
def test_a_speed_without_lag_is_left_as_it_is(seed):
    speed, depth = motion()
    rng = np.random.default_rng(seed)
    noisy = speed + 1.2e-4 * rng.standard_normal(len(speed))
    found, restored = learned(noisy, depth + 6e-6 * rng.standard_normal(len(depth)))
    assert found == 0.0
    assert np.allclose(restored, noisy.reshape(-1, 5).mean(axis=1))


@pytest.mark.parametrize("time_constant_s", [0.0, 0.02, 0.05])
@pytest.mark.parametrize("ramp_s", [0.1, 0.5])
def test_no_alarm_when_the_needle_stops(time_constant_s, ramp_s):
    """All force is viscous friction: it falls at once, the speed as given only later."""
    speed, depth = motion(ramp_s=ramp_s)
    rng = np.random.default_rng(int(1e3 * (time_constant_s + ramp_s)))
    force = 12_000.0 * np.maximum(depth - 2e-3, 0.0) * speed
    force += 0.01 * rng.standard_normal(len(force))
    given = low_passed(speed + 1.2e-4 * rng.standard_normal(len(speed)), time_constant_s)
    measured = depth + 6e-6 * rng.standard_normal(len(depth))
    identifier = Identifier()
    rows = zip(measured.tolist(), given.tolist(), force.tolist(), strict=True)
    assert all(identifier.update(*row, DT_S).rupture is None for row in rows)
