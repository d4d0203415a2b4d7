"""The work that a pending rupture asks for, in stages of which a tick has room for one."""

import math

import numpy as np

from identification.estimate import Rupture, RuptureState, layers_left
from identification.force_drop import force_after, force_before, rows_after
from identification.layer_belief import IdentifiedLayer
from identification.layer_fit import close_layer, identify_layer
from identification.layer_model import MM, OWN_COULOMB, OWN_VISCOUS, layer_fit, no_information
from identification.membrane import SearchWork, search_step
from identification.multilayer_config import MultilayerConfig
from identification.multilayer_state import ForceDropMeasurement, MultilayerState, RuptureCandidate
from identification.resampling import DEPTH, NO_ROWS, Block, rows_of_track
from identification.rupture_classifier import (
    RuptureMeasurement,
    is_made_good,
    layer_ending,
    weigh_tear,
)
from identification.slope_change_detector import Verdict_kink_detector as Verdict
from identification.slope_change_detector import (
    block_noise_N2,
    blocks_since_kink,
    kink_kernels,
    restart_detector,
)

_MOST_LAYERS = 256
"""Layers kept: far more than a needle meets; the oldest go first."""
_SIGNIFICANT = 3.0
"""Standard deviations a drop must have to be believed at the first look."""
_REAL = 1.0
"""The same at the last look: the alarm itself was significant, only a fall that has been made good
again is no rupture."""


def search_stage(pending: RuptureCandidate, config: MultilayerConfig) -> RuptureCandidate:
    """The next stage of the search for a membrane before the rupture.

    Args:
        pending: The rupture, its search not ended.
        config: Settings.
    """
    left, work = pending.left, pending.search_work
    if work is None:
        work = SearchWork(max(left.start_m, left.tip_m + config.provisional_window_m))
    found = search_step(work, left.rows, pending.rupture.depth_m, config)
    if isinstance(found, SearchWork):
        return pending._replace(search_work=found)
    return pending._replace(search=found, search_work=None)


def look_stage(
    state: MultilayerState,
    pending: RuptureCandidate,
    look: ForceDropMeasurement,
    config: MultilayerConfig,
) -> MultilayerState:
    """The next stage of a look: both sides of the rupture, whether it was one, the layer left.

    Args:
        state: State; since the look began, its track has not changed.
        pending: The rupture; its search has ended, but for the first stage.
        look: What has been measured.
        config: Settings.
    """
    if look.stages < len(_MEASURING):
        look = _MEASURING[look.stages](state, pending, look, config)
    elif look.identified is not None and look.ending is not None:
        return _accept(state, pending, look, look.ending, look.identified, config)
    elif look.ending is not None and _is_believed(look, look.ending):
        bias_var = state.baseline.variance
        identified = identify_layer(pending.left, pending.rupture, look.ending, bias_var, config)
        look = look._replace(identified=identified)
    else:
        return _reject(state, pending, look, config)
    return state._replace(pending=pending._replace(look=look._replace(stages=look.stages + 1)))


def _measure_before(
    state: MultilayerState,
    pending: RuptureCandidate,
    look: ForceDropMeasurement,
    _config: MultilayerConfig,
) -> ForceDropMeasurement:
    points, depth_m = state.track.points, pending.rupture.depth_m
    return look._replace(before=force_before(points, depth_m, block_noise_N2(state.detector)))


def _prepare_after(
    state: MultilayerState,
    pending: RuptureCandidate,
    look: ForceDropMeasurement,
    config: MultilayerConfig,
) -> ForceDropMeasurement:
    noise, rupture = block_noise_N2(state.detector), pending.rupture
    rows = rows_after(state.track.points, rupture.depth_m, rupture.speed_m_s, noise, config)
    return look._replace(after_rows=rows)


def _measure_after(
    _state: MultilayerState,
    _pending: RuptureCandidate,
    look: ForceDropMeasurement,
    _config: MultilayerConfig,
) -> ForceDropMeasurement:
    rows = look.after_rows
    return look if rows is None else look._replace(after_rows=None, after=force_after(rows))


def _measure_ending(
    state: MultilayerState,
    pending: RuptureCandidate,
    look: ForceDropMeasurement,
    config: MultilayerConfig,
) -> ForceDropMeasurement:
    points, rupture = state.track.points, pending.rupture
    if look.before is not None and look.after is not None and pending.search is not None:
        ending = layer_ending(points, pending.search, rupture, look.before, look.after)
        earlier = state.traversed[: len(state.layers) - pending.is_closed]
        ending = weigh_tear(ending, [layer.end_probability for layer in earlier], config)
        look = look._replace(ending=ending)
    seen = pending.first or look.ending
    if look.is_final and seen is not None:
        noise = block_noise_N2(state.detector)
        has_come_back = is_made_good(points, rupture.depth_m, seen.drop_N, noise)
        look = look._replace(has_come_back=has_come_back)
    return look


_MEASURING = (_measure_before, _prepare_after, _measure_after, _measure_ending)


def _is_believed(look: ForceDropMeasurement, ending: RuptureMeasurement) -> bool:
    least = _REAL if look.is_final else _SIGNIFICANT
    return not look.has_come_back and ending.drop_N >= least * ending.drop_std_N


def _reject(
    state: MultilayerState,
    pending: RuptureCandidate,
    look: ForceDropMeasurement,
    config: MultilayerConfig,
) -> MultilayerState:
    """No rupture was seen: dismiss it, keep what an earlier look saw, or look again later."""
    if look.has_come_back or (look.is_final and not pending.is_closed):
        return _dismiss(state, pending)
    if look.is_final:
        return state._replace(pending=None)
    next_look_m = pending.next_look_m + config.provisional_window_m
    return state._replace(pending=pending._replace(next_look_m=next_look_m, look=None))


def _accept(
    state: MultilayerState,
    pending: RuptureCandidate,
    look: ForceDropMeasurement,
    ending: RuptureMeasurement,
    identified: IdentifiedLayer,
    config: MultilayerConfig,
) -> MultilayerState:
    """Close the layer; a later look replaces what an earlier one found."""
    keep, rupture = len(state.layers) - pending.is_closed, pending.rupture
    bias_var = state.baseline.variance
    closed = close_layer(pending.left, rupture, ending, identified, bias_var, config)
    machine = state.rupture_state if pending.is_closed else RuptureState.COMPENSATED
    later = pending._replace(
        is_closed=True, next_look_m=config.second_look_m, first=ending, look=None
    )
    undisturbed_m = rupture.depth_m + config.provisional_window_m
    rows = rows_of_track(state.track.points, undisturbed_m, config.row_m)
    row = np.array([1.0, MM * rupture.speed_m_s])
    spread = float(row @ closed.next_fit.covariance[:2, :2] @ row)
    return state._replace(
        layer=closed.next_layer._replace(rows=rows),
        fit=closed.next_fit,
        shaft_std_N=math.sqrt(max(spread, 0.0)),
        pending=None if look.is_final else later,
        rupture_state=machine,
        layers=(*state.layers[:keep], closed.estimate)[-_MOST_LAYERS:],
        traversed=(*state.traversed[:keep], closed.traversed)[-_MOST_LAYERS:],
        compensated=closed.estimate,
    )


def _dismiss(state: MultilayerState, pending: RuptureCandidate) -> MultilayerState:
    """The force came back: no layer was left, and the alarm is withdrawn."""
    kept = len(state.layers) - pending.is_closed
    return state._replace(
        layer=pending.left,
        fit=pending.left_fit,
        pending=None,
        rupture_state=RuptureState.NO_RUPTURE,
        layers=state.layers[:kept],
        traversed=state.traversed[:kept],
        withdrawn=pending.rupture,
    )


# From alarm to compensation, a bounded amount of work per tick.


def raise_rupture(
    state: MultilayerState, block: Block, verdict: Verdict, config: MultilayerConfig
) -> MultilayerState:
    """An alarm: date the rupture, set the layer left aside, begin the next."""
    if state.pending is not None:
        state = finish_look(measure_rupture(state, config, is_last=True), config)
    rupture = _date(state, block, verdict)
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
        fit=layer_fit(values, np.zeros((6, 6))),
        pending=RuptureCandidate(rupture, left, fit, False, config.provisional_window_m),
        rupture_state=RuptureState.DETECTED,
        rupture=rupture,
    )


def _date(state: MultilayerState, block: Block, verdict: Verdict) -> Rupture:
    kernels, detector = kink_kernels(), state.detector
    span = int(kernels.spans[list(kernels.scales).index(verdict.scale)])
    since = blocks_since_kink(detector.force_N[-span:], -1.0)
    travel = float(np.sum(detector.speed_m_s[-since:])) * block.dt_s
    depth = max(block.depth_m - travel, state.layer.start_m)
    chance = math.erfc(verdict.deviations / math.sqrt(2.0))
    return Rupture(
        layer=layers_left(state.layers) + 1,
        alarm_s=block.time_s,
        alarm_depth_m=block.depth_m,
        time_s=block.time_s - since * block.dt_s,
        depth_m=depth,
        force_N=float(detector.force_N[-1 - since]),
        speed_m_s=float(np.mean(detector.speed_m_s[-span:-since])),
        confidence=1.0 - chance,
    )


def measure_rupture(
    state: MultilayerState, config: MultilayerConfig, *, is_last: bool = False
) -> MultilayerState:
    """Begin a look at the force drop where one is due: once early, once for good.

    This tick works off its first stage, those until the next block the others.
    """
    pending = state.pending
    if pending is None or len(state.track.points) == 0:
        return state
    travel = float(state.track.points[-1, DEPTH]) - pending.rupture.depth_m
    is_final = is_last or travel >= config.second_look_m
    if not pending.is_closed:
        state = state._replace(rupture_state=RuptureState.FORCE_DROP_MEASURING)
    if is_final or travel >= pending.next_look_m:
        return look_stage(state, pending, ForceDropMeasurement(is_final), config)
    return state


def work_on_rupture(state: MultilayerState, config: MultilayerConfig) -> MultilayerState:
    """One stage of what the pending rupture asks for: in ticks between blocks there is time."""
    pending = state.pending
    if pending is None:
        return state
    if pending.search is None:
        return state._replace(pending=search_stage(pending, config))
    return state if pending.look is None else look_stage(state, pending, pending.look, config)


def finish_look(state: MultilayerState, config: MultilayerConfig) -> MultilayerState:
    """What is left of a look that has begun, at once: the next block must find it ended."""
    while state.pending is not None and state.pending.look is not None:
        state = work_on_rupture(state, config)
    return state
