"""The work that a pending rupture asks for, in stages of which a tick has room for one."""

import math

import numpy as np

from identification.default_config import DefaultConfig
from identification.default_state import DefaultState, Pending
from identification.kink_detector import block_noise_N2
from identification.layer_close import close_layer, identify_layer
from identification.layer_ending import LayerEnding, layer_ending, weigh_tear
from identification.layer_hindsight import IdentifiedLayer
from identification.layer_model import MM
from identification.layer_rows import rows_of_track
from identification.made_good import is_made_good
from identification.membrane_search import SearchWork, search_step
from identification.rupture_fit import force_after, force_before, rows_after
from identification.rupture_look import RuptureLook
from identification.rupture_state import RuptureState

_MOST_LAYERS = 256
"""Layers kept: far more than a needle meets; the oldest go first."""
_SIGNIFICANT = 3.0
"""Standard deviations a drop must have to be believed at the first look."""
_REAL = 1.0
"""The same at the last look: the alarm itself was significant, only a fall that has been made good
again is no rupture."""


def search_stage(pending: Pending, config: DefaultConfig) -> Pending:
    """The next stage of the search for a membrane before the rupture.

    Args:
        pending: The rupture, its search not ended.
        config: Settings.
    """
    left, work = pending.left, pending.search_work
    if work is None:
        work = SearchWork(max(left.start_m, left.tip_m + config.first_look_m))
    found = search_step(work, left.rows, pending.rupture.depth_m, config)
    if isinstance(found, SearchWork):
        return pending._replace(search_work=found)
    return pending._replace(search=found, search_work=None)


def look_stage(
    state: DefaultState, pending: Pending, look: RuptureLook, config: DefaultConfig
) -> DefaultState:
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
    state: DefaultState, pending: Pending, look: RuptureLook, _config: DefaultConfig
) -> RuptureLook:
    points, depth_m = state.track.points, pending.rupture.depth_m
    return look._replace(before=force_before(points, depth_m, block_noise_N2(state.detector)))


def _prepare_after(
    state: DefaultState, pending: Pending, look: RuptureLook, config: DefaultConfig
) -> RuptureLook:
    noise, rupture = block_noise_N2(state.detector), pending.rupture
    rows = rows_after(state.track.points, rupture.depth_m, rupture.speed_m_s, noise, config)
    return look._replace(after_rows=rows)


def _measure_after(
    _state: DefaultState, _pending: Pending, look: RuptureLook, _config: DefaultConfig
) -> RuptureLook:
    rows = look.after_rows
    return look if rows is None else look._replace(after_rows=None, after=force_after(rows))


def _measure_ending(
    state: DefaultState, pending: Pending, look: RuptureLook, config: DefaultConfig
) -> RuptureLook:
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


def _is_believed(look: RuptureLook, ending: LayerEnding) -> bool:
    least = _REAL if look.is_final else _SIGNIFICANT
    return not look.has_come_back and ending.drop_N >= least * ending.drop_std_N


def _reject(
    state: DefaultState, pending: Pending, look: RuptureLook, config: DefaultConfig
) -> DefaultState:
    """No rupture was seen: dismiss it, keep what an earlier look saw, or look again later."""
    if look.has_come_back or (look.is_final and not pending.is_closed):
        return _dismiss(state, pending)
    if look.is_final:
        return state._replace(pending=None)
    next_look_m = pending.next_look_m + config.first_look_m
    return state._replace(pending=pending._replace(next_look_m=next_look_m, look=None))


def _accept(
    state: DefaultState,
    pending: Pending,
    look: RuptureLook,
    ending: LayerEnding,
    identified: IdentifiedLayer,
    config: DefaultConfig,
) -> DefaultState:
    """Close the layer; a later look replaces what an earlier one found."""
    keep, rupture = len(state.layers) - pending.is_closed, pending.rupture
    bias_var = state.baseline.variance
    closed = close_layer(pending.left, rupture, ending, identified, bias_var, config)
    machine = state.rupture_state if pending.is_closed else RuptureState.COMPENSATED
    later = pending._replace(
        is_closed=True, next_look_m=config.second_look_m, first=ending, look=None
    )
    undisturbed_m = rupture.depth_m + config.first_look_m
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


def _dismiss(state: DefaultState, pending: Pending) -> DefaultState:
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
