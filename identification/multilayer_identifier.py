"""The multi-layer method beyond `update_multilayer`: free air, contact, cutting.

Once per block of samples, or between blocks while a rupture is being measured.
"""

import itertools
import math
from typing import Any

import numpy as np

from identification.config import MultilayerConfig
from identification.estimate import (
    MUTED,
    Array,
    Events,
    LayerEstimate,
    RuptureState,
    Sample,
    next_rupture_state,
)
from identification.friction_compensation import (
    LayerFriction,
    MultilayerCoefficients,
    MultilayerMemory,
    multilayer_outputs,
    update_multilayer,
)
from identification.layer_model import (
    CUTTING,
    STIFFNESS,
    add_layer_prior,
    add_row,
    model_row,
    solve_layer,
)
from identification.multilayer_state import (
    Baseline,
    MultilayerState,
    first_layer,
    initial_multilayer_state,
    multilayer_coefficients,
)
from identification.resampling import (
    BLOCKS,
    DEPTH,
    FORCE,
    TRAVEL,
    Block,
    add_layer_row,
    least_block_s,
    mean_block,
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
from needleforce.jit import jit_arguments

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
_POOLED_BLOCKS = 20.0
"""A row spans 0.1 s or `row_m` of travel, whichever is sooner."""
_OTHER_ERROR = 0.2
"""Weight of the whole force, beside the layer's own, in the error of the linear law."""
_JITTER = 4.0
_CHANNEL_M = 2e-4
"""Behind the deepest point by more than this the needle is in its old channel."""


class MultilayerMethod:
    """The multi-layer method, sample by sample; see `identification.identifier.Method`."""

    takes_filtered_travel = True

    def __init__(self, config: MultilayerConfig) -> None:
        self._config = config
        self.restore(initial_multilayer_state(config))

    @property
    def state(self) -> MultilayerState:
        """All that it remembers."""
        return self._state._replace(memory=MultilayerMemory._make(self._memory))

    def restore(self, state: MultilayerState) -> None:
        """Go on from there."""
        self.before, self._sources = state, None
        self._keep(state)

    @property
    def layers(self) -> tuple[LayerEstimate, ...]:
        """Layers traversed so far, smoothed by all data since."""
        return self._state.known_layers

    def report(self) -> tuple[Any, ...]:
        """What there is to report without a sample."""
        outputs = multilayer_outputs(0.0, 0.0, 0.0, self._memory, *self._arguments)
        return (self._state.rupture_state, *outputs, None, None, None)

    def update(self, sample: Sample) -> tuple[Any, ...]:
        """Use one sample: what to report of it, from the rupture state to the events."""
        _, dt_s, depth_m, speed_m_s, depth_std_m, _, force_N = sample
        is_all, memory, outputs = update_multilayer(
            depth_m, speed_m_s, depth_std_m, force_N, dt_s, self._memory, *self._arguments
        )
        if is_all:
            self._memory = memory
            return (self._state.rupture_state, *outputs, None, None, None)
        before, state = self.state, self._state
        if any(state.events):
            state = state._replace(events=Events())
        new = multilayer_step(state, MultilayerMemory._make(memory), sample, self._config)
        if new.events.rupture is not None:
            self.before = before
        self._keep(new)
        outputs = multilayer_outputs(depth_m, speed_m_s, force_N, self._memory, *self._arguments)
        return (new.rupture_state, *outputs, *new.events)

    def _keep(self, state: MultilayerState) -> None:
        self._memory: Any = tuple(state.memory)
        self._state, known = state, self._sources
        self._sources = state.sources
        if known is None or any(a is not b for a, b in zip(known, self._sources, strict=True)):
            coefficients = multilayer_coefficients(state, self._config)
            friction = (layer.friction for layer in state.traversed)
            self._arguments = (
                jit_arguments(MultilayerCoefficients, coefficients),
                jit_arguments(LayerFriction, *friction),
            )


def multilayer_step(
    state: MultilayerState, memory: MultilayerMemory, sample: Sample, config: MultilayerConfig
) -> MultilayerState:
    """What is done once per block, or between blocks after a rupture."""
    if memory.filled_s < least_block_s(config.block_s):
        state = state._replace(memory=memory)
        return state if state.candidate is None else work_on_rupture(state, config)
    block = mean_block(memory, sample.time_s)
    is_gap = block.dt_s > max(10.0 * config.block_s, config.check.gap_s)
    emptied = memory._replace(filled_s=0.0, depth_sum=0.0, speed_sum=0.0, force_sum=0.0)
    state = state._replace(memory=emptied)
    if state.candidate is not None:
        state = finish_measurement(state, config)
    if is_gap:
        return state._replace(detector=restart_detector(state.detector))
    if not state.in_contact:
        return _free_air(state, block, config)
    channel_m = _CHANNEL_M + _JITTER * sample.depth_std_m
    is_moving = memory.speed_m_s > config.rest_speed_m_s
    is_cutting = is_moving and block.depth_m > memory.deepest_m - channel_m
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
        baseline=baseline, in_contact=True, contact_m=depth_m, layer=first_layer(depth_m)
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
    level, spread = _free_air_level(forces, noise_N2)
    squared = 2.0 * math.log(max(interval_s / SEGMENT_S, math.e))
    squared *= 1.0 + squared / (2.0 * len(forces))
    spread *= 1.0 + 1.0 / (len(forces) // 2)
    return (forces[-1] - level) / math.sqrt(max(squared * spread, 1e-18))


def height_over_drift(state: Baseline, force_N: float, noise_N2: float) -> float:
    """Height of a force above the older half of the means, in units of their drift.

    Zero while too little of free air is known.
    """
    if len(state.forces_N) < 2:
        return 0.0
    level, spread = _free_air_level(state.forces_N, noise_N2)
    return (force_N - level) / math.sqrt(max(spread, 1e-18))


def _free_air_level(forces: tuple[float, ...], noise_N2: float) -> tuple[float, float]:
    """Mean of the older half, and the variance of one mean.

    Half the mean square difference between neighbours (von Neumann), from the lower half of the
    squares: the upper one may contain the contact itself.
    """
    half = forces[: max(len(forces) // 2, 1)]
    squares = sorted((b - a) ** 2 for a, b in itertools.pairwise(forces))
    kept = squares[: max(len(squares) // 2, 1)]
    variance = 0.5 * sum(kept) / len(kept) / _LOWER_HALF
    return sum(half) / len(half), max(variance, noise_N2)


def settle_baseline(state: Baseline, contact_m: float) -> Baseline:
    """Offset and slow error from what was measured before the contact at `contact_m`."""
    rows = zip(state.forces_N, state.depths_m, strict=True)
    before = [force for force, depth in rows if depth < contact_m]
    if not before:
        return state
    offset = sum(before) / len(before)
    variance = sum((f - offset) ** 2 for f in before) / max(len(before) - 1, 1)
    return state._replace(offset_N=offset, variance=variance)


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
    """The tip meets fresh tissue: detect a rupture, measure one, learn the layer."""
    block = block._replace(force_N=block.force_N - state.baseline.offset_N)
    track, point = update_track(state.track, block, config.track_step_m)
    detector, detection = update_detector(state.detector, block, config)
    candidate = state.candidate
    if (
        candidate is not None
        and state.rupture_state in MUTED
        and block.depth_m < candidate.rupture.depth_m + config.provisional_window_m
    ):
        # No new rupture is detected while one releases: until its provisional measurement.
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


def add_point(
    state: MultilayerState, point: Array, config: MultilayerConfig, *, is_solved: bool = True
) -> MultilayerState:
    """Use one point; every few of them make one row, and a new fit.

    Rows of many points average the noise of the speed: in a regressor it would look like a change
    of speed without a change of force, that is, like Coulomb friction.
    """
    layer = state.layer
    pool = point.copy()
    pool[:BLOCKS] *= point[BLOCKS]
    if layer.pool is not None:
        pool += layer.pool
    state = state._replace(layer=layer._replace(pool=pool, points=layer.points + 1))
    if pool[BLOCKS] < _POOLED_BLOCKS and pool[TRAVEL] < config.row_m:
        return state
    return settle_pool(state, config, is_solved=is_solved)


def settle_pool(
    state: MultilayerState, config: MultilayerConfig, *, is_solved: bool = True
) -> MultilayerState:
    """Turn the pooled points into one row and fit anew.

    A row weighs by its noise and by the error of the linear law, which rows within a few
    millimetres have in common: many rows do not make a wrong law right.
    """
    layer, pool = state.layer, state.layer.pool
    if pool is None:
        return state
    point = np.append(pool[:BLOCKS] / pool[BLOCKS], pool[BLOCKS:])
    depth, speed, force, bristle, blocks, travel = point.tolist()
    row = model_row(
        depth - layer.start_m, depth - layer.tip_m, speed, bristle, config.cutting_onset_m
    )
    before = state.fit.values
    own = force - float(row[0] * before[0] + row[1] * before[1])
    error = config.model_error_fraction * max(abs(own), _OTHER_ERROR * abs(force))
    common = max(config.model_error_m / max(travel, 1e-6), 1.0)
    variance = block_noise_N2(state.detector) / blocks + error * error * common
    layer = layer._replace(
        data=add_row(layer.data, row, force, variance),
        rows=add_layer_row(layer.rows, point),
        pool=None,
    )
    if not is_solved:
        return state._replace(layer=layer)
    known = layer.prior.plus(layer.data)
    inside = depth - layer.start_m
    fit = solve_layer(add_layer_prior(known, own, inside, speed, config, layer.residual))
    row[[CUTTING, STIFFNESS]] = 0.0
    spread = float(row @ fit.covariance @ row)
    return state._replace(layer=layer, fit=fit, shaft_std_N=math.sqrt(max(spread, 0.0)))


def _advance(state: MultilayerState, *, is_expected: bool = False) -> MultilayerState:
    """Move the rupture state on; what raises and settles a rupture sets its own states."""
    now = state.rupture_state
    if now is RuptureState.NO_RUPTURE and not is_expected:
        return state
    if now is RuptureState.FORCE_DROP_MEASURING or state.events.identified_layer is not None:
        return state
    return state._replace(rupture_state=next_rupture_state(now, is_expected=is_expected))
