"""The multi-layer method beyond `update_multilayer`: free air, contact, cutting.

Once per block of samples, or between blocks while a rupture is being measured.
"""

import itertools
import math

import numpy as np

from identification.config import MultilayerConfig
from identification.estimate import MUTED, RuptureState, next_rupture_state
from identification.friction_compensation import MultilayerMemory
from identification.input_validation import Sample
from identification.layer_fit import add_point, settle_pool
from identification.layer_model import Array
from identification.multilayer_state import Baseline, MultilayerState, first_layer
from identification.resampling import (
    DEPTH,
    FORCE,
    Block,
    least_block_s,
    mean_block,
    update_lag,
    update_track,
)
from identification.rupture_measurement import (
    finish_measurement,
    measure_rupture,
    raise_rupture,
    work_on_rupture,
)
from identification.slope_change_detector import (
    block_noise_N2,
    blocks_since_change,
    restart_detector,
    update_detector,
)

SEGMENT_S = 0.25
"""Length of the means whose drift is learned."""
_MOST_SEGMENTS = 40
_LEAST_SEGMENTS = 4
_LOWER_HALF = 0.143
"""Mean of the lower half of a squared standard normal."""
_RAISED = 4.0
"""Standard deviations above free air that make a rise of the force a contact."""
_LEAST_POINTS = 8
_LOST = 2.0
_LOST_POINTS = 50
_CHANNEL_M = 2e-4
"""Behind the deepest point by more than this the needle is in its old channel."""


def begin_multilayer_sample(state: MultilayerState, _config: MultilayerConfig) -> MultilayerState:
    """Before a sample: the events of the one before are over."""
    if state.events == (None, None, None):
        return state
    return state._replace(rupture=None, identified_layer=None, retracted=None)


def multilayer_step(
    state: MultilayerState, memory: MultilayerMemory, sample: Sample, config: MultilayerConfig
) -> MultilayerState:
    """What is done once per block, or between blocks after a rupture."""
    if memory.filled_s < least_block_s(config.block_s):
        state = state._replace(memory=memory)
        return state if state.candidate is None else work_on_rupture(state, config)
    block, lag = mean_block(memory, sample.time_s), state.lag
    is_gap = block.dt_s > max(10.0 * config.block_s, config.check.gap_s)
    if is_gap:
        lag = lag._replace(last=None)
    else:
        lag, block = update_lag(lag, block)
    emptied = memory._replace(filled_s=0.0, depth_sum=0.0, speed_sum=0.0, force_sum=0.0)
    state = state._replace(memory=emptied, lag=lag)
    if state.candidate is not None:
        state = finish_measurement(state, config)
    if is_gap:
        return state._replace(detector=restart_detector(state.detector))
    if not state.in_contact:
        return _free_air(state, block, config)
    is_moving = memory.speed_m_s > config.rest_speed_m_s
    is_cutting = is_moving and block.depth_m > memory.deepest_m - _CHANNEL_M
    return _cut(state, block, config) if is_cutting else _rest(state, config)


# Free air and first contact.


def _free_air(state: MultilayerState, block: Block, config: MultilayerConfig) -> MultilayerState:
    """Learn offset and noise of the force until it rises: then contact was where it began to.

    Contact is an upward slope change that chance does not explain and that leaves the level of free
    air (a stiff surface), or a level that has left it slowly (a soft one), of an advancing needle.
    """
    detector, detection = update_detector(state.detector, block, config)
    state = state._replace(detector=detector, baseline=update_baseline(state.baseline, block))
    if block.speed_m_s <= config.rest_speed_m_s:
        return state
    track, _ = update_track(state.track, block, config.track_step_m)
    state = state._replace(track=track)
    noise = block_noise_N2(detector) * block.dt_s / SEGMENT_S
    is_contact = level_score(state.baseline, config.false_alarm_interval_s, noise) > 1.0
    if not is_contact and detection.rise > 1.0:
        level = float(np.mean(detector.force_N[-detection.rise_scale :]))
        is_contact = height_over_drift(state.baseline, level, noise) > _RAISED
    return _touch(state, block, config) if is_contact else state


def _touch(state: MultilayerState, block: Block, config: MultilayerConfig) -> MultilayerState:
    """Begin the first layer where the force left its line, with the points already beyond."""
    points, depth_m = state.track.points, block.depth_m
    if len(points) >= _LEAST_POINTS:
        depth_m = float(points[-1 - blocks_since_change(points[:, FORCE], 1.0), DEPTH])
    baseline = settle_baseline(state.baseline, depth_m)
    state = state._replace(
        baseline=baseline,
        in_contact=True,
        contact_m=depth_m,
        layer=first_layer(depth_m),
    )
    state = _with_raised_track(state, -baseline.offset_N)
    points = state.track.points
    for point in points[points[:, DEPTH] > depth_m]:
        state = add_point(state, point, config, is_solved=False)
    return state


def _lose_contact(state: MultilayerState) -> MultilayerState:
    """Go back to free air if the force has: a bump, not a tissue, was met."""
    if state.layers or state.layer.points < _LOST_POINTS:
        return state
    recent = state.track.points[-_LOST_POINTS // 2 :, FORCE]
    spread = state.baseline.variance + block_noise_N2(state.detector) / len(recent)
    if float(np.mean(recent)) > _LOST * math.sqrt(spread):
        return state
    return _with_raised_track(state._replace(in_contact=False), state.baseline.offset_N)


def _with_raised_track(state: MultilayerState, by_N: float) -> MultilayerState:
    points = state.track.points.copy()
    points[:, FORCE] += by_N
    points.setflags(write=False)
    return state._replace(track=state.track._replace(points=points))


def update_baseline(state: Baseline, block: Block) -> Baseline:
    """Use one block of free-air force."""
    total = state.sum_Ns + block.force_N * block.dt_s
    time = state.time_s + block.dt_s
    if time < SEGMENT_S:
        return state._replace(sum_Ns=total, time_s=time)
    return state._replace(
        forces_N=(*state.forces_N, total / time)[-_MOST_SEGMENTS:],
        depths_m=(*state.depths_m, block.depth_m)[-_MOST_SEGMENTS:],
        sum_Ns=0.0,
        time_s=0.0,
    )


def level_score(state: Baseline, interval_s: float, noise_N2: float) -> float:
    """Newest mean's height above the older half, over the height chance would reach.

    Above 1, chance explains it less than once per `interval_s`. The spread comes from the
    differences between neighbours, which a slow rise hardly touches; it is widened while few
    means are known, as Student's t is.
    """
    forces = state.forces_N
    if len(forces) < _LEAST_SEGMENTS or state.time_s > 0.0:
        return 0.0
    half = forces[: len(forces) // 2]
    squared = 2.0 * math.log(max(interval_s / SEGMENT_S, math.e))
    squared *= 1.0 + squared / (2.0 * len(forces))
    spread = max(_neighbour_variance(forces), noise_N2) * (1.0 + 1.0 / len(half))
    height = forces[-1] - sum(half) / len(half)
    return height / math.sqrt(max(squared * spread, 1e-18))


def height_over_drift(state: Baseline, force_N: float, noise_N2: float) -> float:
    """Height of a force above the older half of the means, in units of their drift.

    Zero while too little of free air is known.
    """
    forces = state.forces_N
    if len(forces) < 2:
        return 0.0
    half = forces[: max(len(forces) // 2, 1)]
    height = force_N - sum(half) / len(half)
    return height / math.sqrt(max(_neighbour_variance(forces), noise_N2, 1e-18))


def settle_baseline(state: Baseline, contact_m: float) -> Baseline:
    """Offset and slow error from what was measured before the contact at `contact_m`."""
    rows = zip(state.forces_N, state.depths_m, strict=True)
    before = [force for force, depth in rows if depth < contact_m]
    if not before:
        return state
    offset = sum(before) / len(before)
    variance = sum((f - offset) ** 2 for f in before) / max(len(before) - 1, 1)
    return state._replace(offset_N=offset, variance=variance)


def _neighbour_variance(forces: tuple[float, ...]) -> float:
    """Half the mean square difference between neighbours (von Neumann), from its lower half.

    The upper half may hold the contact itself.
    """
    squares = sorted((b - a) ** 2 for a, b in itertools.pairwise(forces))
    kept = squares[: max(len(squares) // 2, 1)]
    return 0.5 * sum(kept) / len(kept) / _LOWER_HALF


# In tissue.


def _rest(state: MultilayerState, config: MultilayerConfig) -> MultilayerState:
    """Rest, reversal or an old channel: no rupture can happen, one being measured is settled."""
    state = state._replace(detector=restart_detector(state.detector))
    if state.candidate is not None:
        state = measure_rupture(state, config, is_last=True)
    else:
        state = settle_pool(state, config)
    return _advance(state)


def _cut(state: MultilayerState, block: Block, config: MultilayerConfig) -> MultilayerState:
    """The tip meets fresh tissue: look for a rupture, measure one, learn the layer."""
    block = block._replace(force_N=block.force_N - state.baseline.offset_N)
    track, point = update_track(state.track, block, config.track_step_m)
    detector, detection = update_detector(state.detector, block, config)
    candidate = state.candidate
    if (
        candidate is not None
        and state.rupture_state in MUTED
        and block.depth_m < candidate.rupture.depth_m + config.provisional_window_m
    ):
        # No rupture is looked for while one releases: until its provisional measurement.
        state = state._replace(detector=restart_detector(detector), track=track)
        return _follow(state, point, config)
    state = state._replace(detector=detector, track=track)
    if detection.fall > 1.0:
        return raise_rupture(state, block, detection, config)
    state = _follow(state, point, config)
    return _advance(state, is_expected=detection.fall > config.expected_fraction)


def _follow(
    state: MultilayerState, point: Array | None, config: MultilayerConfig
) -> MultilayerState:
    """Use a new track point: for the rupture being measured, else for the layer."""
    if point is None:
        return state
    if state.candidate is not None:
        return measure_rupture(state, config)
    return _lose_contact(add_point(state, point, config))


def _advance(state: MultilayerState, *, is_expected: bool = False) -> MultilayerState:
    """Move the rupture state on; what raises and settles a rupture sets its own states."""
    now = state.rupture_state
    if now is RuptureState.NO_RUPTURE and not is_expected:
        return state
    if now is RuptureState.FORCE_DROP_MEASURING or state.identified_layer is not None:
        return state
    return state._replace(rupture_state=next_rupture_state(now, is_expected=is_expected))
