"""What a sample asks of this toolkit's own identification beyond `multilayer_update`."""

import math

import numpy as np
from numpy.typing import NDArray

from identification.estimate import MUTED, RuptureState, next_rupture_state
from identification.free_air_baseline import (
    SEGMENT_S,
    baseline_step,
    height_over_wander,
    level_score,
    settle_baseline,
)
from identification.friction_compensation import MultilayerUpdate
from identification.input_validation import Sample
from identification.layer_fit import layer_step, settle_pool
from identification.multilayer_config import MultilayerConfig
from identification.multilayer_state import MultilayerState, untouched_layer
from identification.resampling import (
    DEPTH,
    FORCE,
    Block,
    emptied,
    is_block_full,
    mean_block,
    track_step,
)
from identification.rupture_measurement import (
    finish_look,
    measure_rupture,
    raise_rupture,
    work_on_rupture,
)
from identification.slope_change_detector import (
    block_noise_N2,
    blocks_since_kink,
    detector_step,
    restart_detector,
)
from identification.speed_lag import lag_step

# First contact: where the force leaves its free-air level.


_LEVEL = 4.0
_LEAST_POINTS = 8
_LOST = 2.0
_LOST_POINTS = 50


def free_air_step(
    state: MultilayerState, block: Block, config: MultilayerConfig
) -> MultilayerState:
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


def _is_raised(state: MultilayerState, scale: int, noise_N2: float) -> bool:
    """Whether the blocks since the kink stand above what the sensor wanders in free air."""
    level = float(np.mean(state.detector.force_N[-scale:]))
    return height_over_wander(state.baseline, level, noise_N2) > _LEVEL


def _contact_depth(state: MultilayerState, block: Block) -> float:
    """Depth at which the force left its line, found on the recent track."""
    points = state.track.points
    if len(points) < _LEAST_POINTS:
        return block.depth_m
    since = blocks_since_kink(points[:, FORCE], 1.0)
    return float(points[-1 - since, DEPTH])


def _touch(state: MultilayerState, depth_m: float, config: MultilayerConfig) -> MultilayerState:
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


def lose_contact(state: MultilayerState) -> MultilayerState:
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


_CHANNEL_M = 2e-4


def begin_default_sample(state: MultilayerState, _config: MultilayerConfig) -> MultilayerState:
    """Before a sample: the events of the one before are over."""
    if state.events == (None, None, None):
        return state
    return state._replace(rupture=None, compensated=None, withdrawn=None)


def multilayer_step(
    state: MultilayerState, tick: MultilayerUpdate, sample: Sample, config: MultilayerConfig
) -> MultilayerState:
    """What is done once per block, or between blocks after a rupture.

    Args:
        state: Before the sample.
        tick: What `multilayer_update` has made of the sample.
        sample: The sample.
        config: Settings.
    """
    if not is_block_full(tick.filled_s, config.block_s):
        state = state._replace(tick=tick)
        return state if state.pending is None else work_on_rupture(state, config)
    block, lag = mean_block(tick, sample.time_s), state.lag
    is_gap = block.dt_s > max(10.0 * config.block_s, config.check.gap_s)
    if is_gap:
        lag = lag._replace(last=None)
    else:
        lag, block = lag_step(lag, block)
    state = state.after_block(emptied(tick), lag)
    if state.pending is not None:
        state = finish_look(state, config)
    if is_gap:
        return state._replace(detector=restart_detector(state.detector))
    if not state.in_contact:
        return free_air_step(state, block, config)
    is_moving = tick.speed_m_s > config.rest_speed_m_s
    is_cutting = is_moving and block.depth_m > tick.deepest_m - _CHANNEL_M
    return _cut(state, block, config) if is_cutting else _idle(state, config)


def _idle(state: MultilayerState, config: MultilayerConfig) -> MultilayerState:
    """Rest, reversal or an old channel: no rupture can happen, a pending one is settled."""
    state = state._replace(detector=restart_detector(state.detector))
    if state.pending is not None:
        state = measure_rupture(state, config, is_last=True)
    else:
        state = settle_pool(state, config)
    return _advance(state)


def _cut(state: MultilayerState, block: Block, config: MultilayerConfig) -> MultilayerState:
    """The tip meets fresh tissue: look for a rupture, measure one, learn the layer."""
    block = block.less(state.baseline.offset_N)
    track, point = track_step(state.track, block, config.track_step_m)
    detector, verdict = detector_step(state.detector, block, config)
    is_muted = _is_muted(state, block, config)
    state = state.after_point(restart_detector(detector) if is_muted else detector, track)
    if is_muted:
        return _follow(state, point, config)
    if verdict.fall > 1.0:
        return raise_rupture(state, block, verdict, config)
    state = _follow(state, point, config)
    return _advance(state, is_expected=verdict.fall > config.expected_share)


def _is_muted(state: MultilayerState, block: Block, config: MultilayerConfig) -> bool:
    """No rupture is looked for while one is releasing: until its first look."""
    pending = state.pending
    if pending is None or state.rupture_state not in MUTED:
        return False
    return block.depth_m < pending.rupture.depth_m + config.provisional_window_m


def _follow(
    state: MultilayerState, point: NDArray[np.float64] | None, config: MultilayerConfig
) -> MultilayerState:
    """Use a new track point: for the rupture being measured, else for the layer."""
    if point is None:
        return state
    if state.pending is not None:
        return measure_rupture(state, config)
    return lose_contact(layer_step(state, point, config))


def _advance(state: MultilayerState, *, is_expected: bool = False) -> MultilayerState:
    """Move the machine on; what raises and settles a rupture sets its own states."""
    machine = state.rupture_state
    if machine is RuptureState.NO_RUPTURE and not is_expected:
        return state
    if machine is RuptureState.FORCE_DROP_MEASURING or state.compensated is not None:
        return state
    return state._replace(rupture_state=next_rupture_state(machine, is_expected=is_expected))
