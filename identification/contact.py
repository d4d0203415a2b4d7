"""First contact: where the force leaves its free-air level."""

import math

import numpy as np

from identification.baseline import (
    SEGMENT_S,
    baseline_step,
    height_over_wander,
    level_score,
    settle_baseline,
)
from identification.block import Block
from identification.change_point import blocks_since_kink
from identification.default_config import DefaultConfig
from identification.default_state import DefaultState, untouched_layer
from identification.kink_detector import block_noise_N2, detector_step
from identification.layer_step import layer_step
from identification.track import DEPTH, FORCE, track_step

_LEVEL = 4.0
_LEAST_POINTS = 8
_LOST = 2.0
_LOST_POINTS = 50


def free_air_step(state: DefaultState, block: Block, config: DefaultConfig) -> DefaultState:
    """Learn offset and noise of the force until it rises: then contact is dated back.

    Contact is an upward kink that chance does not explain and that leaves the level of free air
    (a stiff surface), or a level that has left it slowly (a soft one), of an advancing needle.
    """
    detector, verdict = detector_step(state.detector, block, config)
    state = state._replace(detector=detector, baseline=baseline_step(state.baseline, block))
    if block.speed_m_s <= config.rest_speed_m_s:
        return state
    track, _ = track_step(state.track, block, config.track_step_m)
    state = state._replace(track=track)
    noise = block_noise_N2(detector) * block.dt_s / SEGMENT_S
    is_slow = level_score(state.baseline, config.false_alarm_interval_s, noise) > 1.0
    if is_slow or (verdict.rise > 1.0 and _is_raised(state, verdict.rise_scale, noise)):
        return _touch(state, _contact_depth(state, block), config)
    return state


def _is_raised(state: DefaultState, scale: int, noise_N2: float) -> bool:
    """Whether the blocks since the kink stand above what the sensor wanders in free air."""
    level = float(np.mean(state.detector.force_N[-scale:]))
    return height_over_wander(state.baseline, level, noise_N2) > _LEVEL


def _contact_depth(state: DefaultState, block: Block) -> float:
    """Depth at which the force left its line, found on the recent track."""
    points = state.track.points
    if len(points) < _LEAST_POINTS:
        return block.depth_m
    since = blocks_since_kink(points[:, FORCE], 1.0)
    return float(points[-1 - since, DEPTH])


def _touch(state: DefaultState, depth_m: float, config: DefaultConfig) -> DefaultState:
    """Begin the first layer at `depth_m` with the points already beyond it."""
    state = state._replace(baseline=settle_baseline(state.baseline, depth_m))
    points = state.track.points.copy()
    points[:, FORCE] -= state.baseline.offset_N
    points.setflags(write=False)
    state = state._replace(
        in_contact=True,
        layer=untouched_layer(depth_m),
        track=state.track._replace(points=points),
    )
    for point in points[points[:, DEPTH] > depth_m]:
        state = layer_step(state, point, config, is_solved=False)
    return state


def lose_contact(state: DefaultState) -> DefaultState:
    """Go back to free air if the force has: a bump, not a tissue, was met."""
    if state.layers or state.layer.points < _LOST_POINTS:
        return state
    recent = state.track.points[-_LOST_POINTS // 2 :, FORCE]
    spread = state.baseline.variance + block_noise_N2(state.detector) / len(recent)
    if float(np.mean(recent)) > _LOST * math.sqrt(spread):
        return state
    points = state.track.points.copy()
    points[:, FORCE] += state.baseline.offset_N
    return state._replace(in_contact=False, track=state.track._replace(points=points))
