"""The work that a pending rupture asks for, in stages of which a tick has room for one."""

import math

import numpy as np

from identification.default_config import DefaultConfig
from identification.default_state import DefaultState, Pending
from identification.kink_detector import block_noise_N2
from identification.layer_close import close_layer
from identification.layer_ending import LayerEnding, layer_ending, weigh_tear
from identification.layer_model import MM
from identification.layer_rows import rows_of_track
from identification.made_good import is_made_good
from identification.membrane_search import SearchWork, search_step
from identification.rupture_fit import force_after
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
        pending: The rupture, its search ended.
        look: What has been measured.
        config: Settings.
    """
    points, noise = state.track.points, block_noise_N2(state.detector)
    rupture, stage = pending.rupture, look.stages
    if stage == 0:
        after = force_after(points, rupture.depth_m, rupture.speed_m_s, noise, config)
        look = look._replace(after=after)
    elif stage == 1 and look.after is not None and pending.search is not None:
        ending = layer_ending(points, pending.search, rupture, look.after, noise)
        look = look._replace(ending=ending)
    elif stage == 2 and look.is_final:
        seen = pending.first or look.ending
        has_come_back = seen is not None and is_made_good(
            points, rupture.depth_m, seen.drop_N, noise
        )
        look = look._replace(has_come_back=has_come_back)
    elif stage >= 2:
        return _conclude(state, pending, look, config)
    return state._replace(pending=pending._replace(look=look._replace(stages=stage + 1)))


def _conclude(
    state: DefaultState, pending: Pending, look: RuptureLook, config: DefaultConfig
) -> DefaultState:
    """Close the layer, dismiss what is no rupture after all, or look again later."""
    if look.has_come_back:
        return _dismiss(state, pending)
    ending, least = look.ending, _REAL if look.is_final else _SIGNIFICANT
    if ending is not None and ending.drop_N >= least * ending.drop_std_N:
        return _accept(state, pending, ending, look.is_final, config)
    if look.is_final:
        return state._replace(pending=None) if pending.is_closed else _dismiss(state, pending)
    next_look_m = pending.next_look_m + config.first_look_m
    return state._replace(pending=pending._replace(next_look_m=next_look_m, look=None))


def _accept(
    state: DefaultState,
    pending: Pending,
    ending: LayerEnding,
    is_final: bool,
    config: DefaultConfig,
) -> DefaultState:
    """Close the layer; a later look replaces what an earlier one found."""
    keep = len(state.layers) - pending.is_closed
    ending = weigh_tear(ending, [layer.end_probability for layer in state.traversed[:keep]], config)
    closed = close_layer(pending.left, pending.rupture, ending, state.baseline.variance, config)
    machine = state.rupture_state if pending.is_closed else RuptureState.COMPENSATED
    later = pending._replace(
        is_closed=True, next_look_m=config.second_look_m, first=ending, look=None
    )
    row = np.array([1.0, MM * pending.rupture.speed_m_s])
    spread = float(row @ closed.next_fit.covariance[:2, :2] @ row)
    undisturbed_m = pending.rupture.depth_m + config.first_look_m
    rows = rows_of_track(state.track.points, undisturbed_m, config.row_m)
    return state._replace(
        layer=closed.next_layer._replace(rows=rows),
        fit=closed.next_fit,
        shaft_std_N=math.sqrt(max(spread, 0.0)),
        pending=None if is_final else later,
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
