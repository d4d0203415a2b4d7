"""Blocks, presliding, track and baseline: the small steps of the default method."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from identification.free_air_baseline import Baseline, baseline_step, level_score, settle_baseline
from identification.friction_compensation import MultilayerUpdate, bristle_step, follow_depth
from identification.resampling import (
    LENGTH,
    Block,
    initial_track,
    is_block_full,
    mean_block,
    track_step,
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
    short, long = MultilayerUpdate(filled_s=0.001), MultilayerUpdate(0.004, 7e-4, 0.0, 0.016, 0.5)
    assert not is_block_full(short.filled_s, 4e-3)
    assert is_block_full(long.filled_s, 4e-3)
    block = mean_block(long, 0.004)
    assert block == Block(0.004, 0.004, pytest.approx(0.175), 0.0, pytest.approx(4.0), 0.5)


def test_sparse_samples_are_blocks_of_their_own():
    block = mean_block(MultilayerUpdate(0.05, 5e-3, 0.0, 0.05, 1.0), 0.05)
    assert is_block_full(block.dt_s, 5e-3)
    assert (block.dt_s, block.force_N) == (0.05, 1.0)


def _block(time, depth, force):
    return Block(time, 5e-3, depth, 2e-3, force, 1.0)


def test_track_keeps_a_bounded_past_at_fixed_travel():
    track = initial_track()
    for k in range(20_000):
        track, _ = track_step(track, _block(0.005 * k, 1e-5 * k, 0.1), 2e-5)
    assert len(track.points) == LENGTH
    assert np.all(np.diff(track.points[:, 0]) >= 2e-5 - 1e-12)
    assert np.allclose(track.points[:, 5], np.diff(track.points[:, 0]).mean(), rtol=0.5)
    assert not track.points.flags.writeable


def test_baseline_finds_offset_and_a_slow_rise_but_no_noise():
    rng = np.random.default_rng(5)
    state, scores = Baseline(), []
    for k in range(1600):
        force = 0.2 + 0.003 * rng.standard_normal() + max(k - 1000, 0) * 1e-4
        state = baseline_step(state, _block(0.005 * k, 1e-5 * (k - 1000), force))
        scores.append(level_score(state, 3600.0, 1e-8))
    assert max(scores[:1000]) < 1.0
    assert max(scores[1000:1400]) > 1.0
    settled = settle_baseline(state, 0.0)
    assert settled.offset_N == pytest.approx(0.2, abs=0.002)
    assert math.sqrt(settled.variance) < 0.003
