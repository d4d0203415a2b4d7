"""What a sample asks of this toolkit's own identification beyond `default_tick`."""

import numpy as np
from numpy.typing import NDArray

from identification.block import Block, emptied, is_block_full, mean_block
from identification.contact import free_air_step, lose_contact
from identification.default_config import DefaultConfig
from identification.default_state import DefaultState
from identification.default_tick import DefaultTick
from identification.kink_detector import detector_step, restart_detector
from identification.layer_step import layer_step, settle_pool
from identification.rupture_state import MUTED, RuptureState, next_rupture_state
from identification.rupture_step import (
    finish_look,
    measure_rupture,
    raise_rupture,
    work_on_rupture,
)
from identification.sample import Sample
from identification.speed_lag import lag_step
from identification.track import track_step

_CHANNEL_M = 2e-4


def begin_default_sample(state: DefaultState, _config: DefaultConfig) -> DefaultState:
    """Before a sample: the events of the one before are over."""
    if state.events == (None, None, None):
        return state
    return state._replace(rupture=None, compensated=None, withdrawn=None)


def default_step(
    state: DefaultState, tick: DefaultTick, sample: Sample, config: DefaultConfig
) -> DefaultState:
    """What is done once per block, or between blocks after a rupture.

    Args:
        state: Before the sample.
        tick: What `default_tick` has made of the sample.
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


def _idle(state: DefaultState, config: DefaultConfig) -> DefaultState:
    """Rest, reversal or an old channel: no rupture can happen, a pending one is settled."""
    state = state._replace(detector=restart_detector(state.detector))
    if state.pending is not None:
        state = measure_rupture(state, config, is_last=True)
    else:
        state = settle_pool(state, config)
    return _advance(state)


def _cut(state: DefaultState, block: Block, config: DefaultConfig) -> DefaultState:
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


def _is_muted(state: DefaultState, block: Block, config: DefaultConfig) -> bool:
    """No rupture is looked for while one is releasing: until its first look."""
    pending = state.pending
    if pending is None or state.rupture_state not in MUTED:
        return False
    return block.depth_m < pending.rupture.depth_m + config.first_look_m


def _follow(
    state: DefaultState, point: NDArray[np.float64] | None, config: DefaultConfig
) -> DefaultState:
    """Use a new track point: for the rupture being measured, else for the layer."""
    if point is None:
        return state
    if state.pending is not None:
        return measure_rupture(state, config)
    return lose_contact(layer_step(state, point, config))


def _advance(state: DefaultState, *, is_expected: bool = False) -> DefaultState:
    """Move the machine on; what raises and settles a rupture sets its own states."""
    machine = state.rupture_state
    if machine is RuptureState.NO_RUPTURE and not is_expected:
        return state
    if machine is RuptureState.FORCE_DROP_MEASURING or state.compensated is not None:
        return state
    return state._replace(rupture_state=next_rupture_state(machine, is_expected=is_expected))
