"""From the alarm of a rupture to the friction of its layer: a bounded amount of work per tick.

The force drop is measured twice: over the provisional window, a millimetre after the rupture, and
over the final one. A measurement is a handful of stages, of which a tick has room for one.
"""

import math
from dataclasses import replace

import numpy as np

from identification.config import MultilayerConfig
from identification.estimate import Rupture, RuptureState, layers_left
from identification.layer_fit import close_layer, identify_layer
from identification.layer_model import MM, OWN_COULOMB, OWN_VISCOUS, Gaussian, no_information
from identification.membrane import SearchWork, search_step
from identification.multilayer_state import ForceDropMeasurement, MultilayerState, RuptureCandidate
from identification.resampling import DEPTH, NO_ROWS, Block, rows_of_track
from identification.rupture_classifier import (
    force_after,
    force_before,
    has_recovered,
    measure_end,
    rows_after,
)
from identification.slope_change_detector import (
    SCALES,
    Detection,
    block_noise_N2,
    blocks_since_change,
    filter_bank,
    restart_detector,
)

_MOST_LAYERS = 256
"""Layers kept: far more than a needle meets; the oldest go first."""
_SIGNIFICANT = 3.0
"""Standard deviations a drop must have to count in the provisional measurement."""
_REAL = 1.0
"""The same in the final one: the alarm itself was significant, only a fall that has recovered is no
rupture."""


def raise_rupture(
    state: MultilayerState, block: Block, detection: Detection, config: MultilayerConfig
) -> MultilayerState:
    """An alarm: estimate the rupture time, set the layer left aside, begin the next."""
    if state.candidate is not None:
        state = finish_measurement(measure_rupture(state, config, is_last=True), config)
    rupture = _rupture(state, block, detection)
    left, fit = state.layer, state.fit
    thickness = MM * max(rupture.depth_m - left.start_m, 0.0)
    values = np.zeros(6)
    values[0] = fit.values[0] + thickness * fit.values[OWN_COULOMB]
    values[1] = fit.values[1] + thickness * fit.values[OWN_VISCOUS]
    layer = left._replace(
        start_m=rupture.depth_m,
        tip_m=rupture.depth_m,
        data=no_information(),
        rows=NO_ROWS,
        points=0,
        pool=None,
    )
    return state._replace(
        detector=restart_detector(state.detector),
        layer=layer,
        fit=Gaussian(values, np.zeros((6, 6))),
        candidate=RuptureCandidate(rupture, left, fit, False, config.provisional_window_m),
        rupture_state=RuptureState.DETECTED,
        rupture=rupture,
    )


def _rupture(state: MultilayerState, block: Block, detection: Detection) -> Rupture:
    """The rupture at its change point, not at its alarm."""
    detector = state.detector
    span = int(filter_bank().spans[SCALES.index(detection.scale)])
    since = blocks_since_change(detector.force_N[-span:], -1.0)
    travel = float(np.sum(detector.speed_m_s[-since:])) * block.dt_s
    chance = math.erfc(detection.deviations / math.sqrt(2.0))
    return Rupture(
        layer=layers_left(state.layers) + 1,
        alarm_s=block.time_s,
        alarm_depth_m=block.depth_m,
        time_s=block.time_s - since * block.dt_s,
        depth_m=max(block.depth_m - travel, state.layer.start_m),
        force_N=float(detector.force_N[-1 - since]),
        speed_m_s=float(np.mean(detector.speed_m_s[-span:-since])),
        confidence=1.0 - chance,
        contact_depth_m=state.contact_m,
    )


def measure_rupture(
    state: MultilayerState, config: MultilayerConfig, *, is_last: bool = False
) -> MultilayerState:
    """Begin a measurement of the force drop where one is due: once provisional, once final.

    This tick works off its first stage, those until the next block the others.
    """
    candidate = state.candidate
    if candidate is None or len(state.track.points) == 0:
        return state
    travel = float(state.track.points[-1, DEPTH]) - candidate.rupture.depth_m
    is_final = is_last or travel >= config.final_window_m
    if not candidate.is_provisional:
        state = state._replace(rupture_state=RuptureState.FORCE_DROP_MEASURING)
    if is_final or travel >= candidate.next_window_m:
        return _work(state, candidate, ForceDropMeasurement(is_final), config)
    return state


def work_on_rupture(state: MultilayerState, config: MultilayerConfig) -> MultilayerState:
    """One stage of what the rupture asks for: in ticks between blocks there is time."""
    candidate = state.candidate
    if candidate is None:
        return state
    if candidate.search is None:
        return state._replace(candidate=_search(candidate, config))
    return state if candidate.work is None else _work(state, candidate, candidate.work, config)


def finish_measurement(state: MultilayerState, config: MultilayerConfig) -> MultilayerState:
    """The rest of a measurement that has begun, at once: the next block must find it ended."""
    while state.candidate is not None and state.candidate.work is not None:
        state = work_on_rupture(state, config)
    return state


def _search(candidate: RuptureCandidate, config: MultilayerConfig) -> RuptureCandidate:
    """The next stage of the search for a membrane before the rupture."""
    left, work = candidate.left, candidate.search_work
    if work is None:
        work = SearchWork(max(left.start_m, left.tip_m + config.provisional_window_m))
    found = search_step(work, left.rows, candidate.rupture.depth_m, config)
    if isinstance(found, SearchWork):
        return candidate._replace(search_work=found)
    return candidate._replace(search=found, search_work=None)


def _work(
    state: MultilayerState,
    candidate: RuptureCandidate,
    work: ForceDropMeasurement,
    config: MultilayerConfig,
) -> MultilayerState:
    """The next stage: both sides of the rupture, whether it was one, the layer left."""
    rupture, end = candidate.rupture, work.end
    if work.stages < _MEASURING:
        work = _measure(state, candidate, work, config)
    elif work.layer is not None:
        return _accept(state, candidate, work, config)
    elif (
        end is not None
        and not work.has_recovered
        and (end.drop_N >= (_REAL if work.is_final else _SIGNIFICANT) * end.drop_std_N)
    ):
        bias_var = state.baseline.variance
        layer = identify_layer(candidate.left, rupture, end, bias_var, config)
        work = work._replace(layer=layer)
    else:
        return _reject(state, candidate, work, config)
    work = work._replace(stages=work.stages + 1)
    return state._replace(candidate=candidate._replace(work=work))


_MEASURING = 4


def _measure(
    state: MultilayerState,
    candidate: RuptureCandidate,
    work: ForceDropMeasurement,
    config: MultilayerConfig,
) -> ForceDropMeasurement:
    """One of the four stages that read the track."""
    points, rupture = state.track.points, candidate.rupture
    noise = block_noise_N2(state.detector)
    if work.stages == 0:
        return work._replace(before=force_before(points, rupture.depth_m, noise))
    if work.stages == 1:
        rows = rows_after(points, rupture.depth_m, rupture.speed_m_s, noise, config)
        return work._replace(after_rows=rows)
    if work.stages == 2:
        rows = work.after_rows
        return work if rows is None else work._replace(after_rows=None, after=force_after(rows))
    if work.before is not None and work.after is not None and candidate.search is not None:
        earlier = state.traversed[: len(state.layers) - candidate.is_provisional]
        ends = [layer.end_probability for layer in earlier]
        before, after = work.before, work.after
        end = measure_end(points, candidate.search, rupture, before, after, ends, config)
        work = work._replace(end=end)
    seen = candidate.first or work.end
    if work.is_final and seen is not None:
        is_back = has_recovered(points, rupture.depth_m, seen.drop_N, noise)
        work = work._replace(has_recovered=is_back)
    return work


def _accept(
    state: MultilayerState,
    candidate: RuptureCandidate,
    work: ForceDropMeasurement,
    config: MultilayerConfig,
) -> MultilayerState:
    """Close the layer; the final measurement replaces what the provisional one found."""
    end, layer = work.end, work.layer
    if end is None or layer is None:
        return state
    keep, rupture = len(state.layers) - candidate.is_provisional, candidate.rupture
    closed = close_layer(
        candidate.left, rupture, end, layer, state.baseline.variance, config, is_final=work.is_final
    )
    later = candidate._replace(
        is_provisional=True, next_window_m=config.final_window_m, first=end, work=None
    )
    undisturbed_m = rupture.depth_m + config.provisional_window_m
    rows = rows_of_track(state.track.points, undisturbed_m, config.row_m)
    row = np.array([1.0, MM * rupture.speed_m_s])
    spread = float(row @ closed.next_fit.covariance[:2, :2] @ row)
    if not candidate.is_provisional:
        state = state._replace(rupture_state=RuptureState.FRICTION_IDENTIFIED)
    return state._replace(
        layer=closed.next_layer._replace(rows=rows),
        fit=closed.next_fit,
        shaft_std_N=math.sqrt(max(spread, 0.0)),
        candidate=None if work.is_final else later,
        layers=(*state.layers[:keep], closed.estimate)[-_MOST_LAYERS:],
        traversed=(*state.traversed[:keep], closed.traversed)[-_MOST_LAYERS:],
        identified_layer=closed.estimate,
    )


def _reject(
    state: MultilayerState,
    candidate: RuptureCandidate,
    work: ForceDropMeasurement,
    config: MultilayerConfig,
) -> MultilayerState:
    """No rupture was seen: retract it, keep what was found provisionally, or measure later."""
    if work.has_recovered or (work.is_final and not candidate.is_provisional):
        kept = len(state.layers) - candidate.is_provisional
        return state._replace(
            layer=candidate.left,
            fit=candidate.left_fit,
            candidate=None,
            rupture_state=RuptureState.NO_RUPTURE,
            layers=state.layers[:kept],
            traversed=state.traversed[:kept],
            retracted=candidate.rupture,
        )
    if work.is_final:
        last = replace(state.layers[-1], is_final=True)
        return state._replace(candidate=None, layers=(*state.layers[:-1], last))
    next_window_m = candidate.next_window_m + config.provisional_window_m
    return state._replace(candidate=candidate._replace(next_window_m=next_window_m, work=None))
