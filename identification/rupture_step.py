"""From alarm to compensation."""

import math

import numpy as np

from identification.block import Block
from identification.change_point import blocks_since_kink
from identification.default_config import DefaultConfig
from identification.default_state import DefaultState, Pending
from identification.estimate import Rupture, layers_left
from identification.kink_detector import Verdict, block_noise_N2, restart_detector
from identification.kink_kernels import kink_kernels
from identification.layer_close import close_layer
from identification.layer_ending import LayerEnding, layer_ending, weigh_tear
from identification.layer_model import (
    MM,
    OWN_COULOMB,
    OWN_VISCOUS,
    layer_fit,
    no_information,
)
from identification.layer_rows import NO_ROWS, rows_of_track
from identification.made_good import is_made_good
from identification.membrane_search import MembraneSearch, search_membrane
from identification.rupture_state import RuptureState
from identification.track import DEPTH

_MOST_LAYERS = 256
"""Layers kept: far more than a needle meets; the oldest go first."""
_SIGNIFICANT = 3.0
"""Standard deviations a drop must have to be believed at the first look."""
_REAL = 1.0
"""The same at the last look: the alarm itself was significant, only a fall that has been made good
again is no rupture."""


def raise_rupture(
    state: DefaultState, block: Block, verdict: Verdict, config: DefaultConfig
) -> DefaultState:
    """An alarm: date the rupture, set the layer left aside, begin the next."""
    if state.pending is not None:
        state = measure_rupture(state, config, is_last=True)
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
        pending=Pending(rupture, left, fit, False, config.first_look_m),
        rupture_state=RuptureState.DETECTED,
        rupture=rupture,
    )


def _date(state: DefaultState, block: Block, verdict: Verdict) -> Rupture:
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
    state: DefaultState, config: DefaultConfig, *, is_last: bool = False
) -> DefaultState:
    """Look at the force drop: once early, once for good; dismiss what is no drop after all."""
    pending = state.pending
    if pending is None or len(state.track.points) == 0:
        return state
    travel = float(state.track.points[-1, DEPTH]) - pending.rupture.depth_m
    is_final = is_last or travel >= config.second_look_m
    if not is_final and travel < pending.next_look_m:
        return state._replace(rupture_state=_waiting(state))
    ending = _measure(state, pending, config)
    if is_final and _has_come_back(state, pending, ending):
        return _dismiss(state, pending)
    if ending is not None and _is_believed(ending, is_final=is_final):
        return _accept(state, pending, ending, is_final, config)
    if is_final:
        return state._replace(pending=None) if pending.is_closed else _dismiss(state, pending)
    later = pending._replace(next_look_m=pending.next_look_m + config.first_look_m)
    return state._replace(pending=later, rupture_state=_waiting(state))


def _waiting(state: DefaultState) -> RuptureState:
    pending = state.pending
    if pending is not None and not pending.is_closed:
        return RuptureState.FORCE_DROP_MEASURING
    return state.rupture_state


def search_pending(state: DefaultState, config: DefaultConfig) -> DefaultState:
    """Look once for the membrane before the pending rupture: between blocks there is time."""
    pending = state.pending
    if pending is None or pending.search is not None:
        return state
    return state._replace(pending=pending._replace(search=_searched(pending, config)))


def _searched(pending: Pending, config: DefaultConfig) -> MembraneSearch:
    left = pending.left
    start = max(left.start_m, left.tip_m + config.first_look_m)
    return search_membrane(left.rows, start, pending.rupture.depth_m, config)


def _measure(state: DefaultState, pending: Pending, config: DefaultConfig) -> LayerEnding | None:
    """Both sides of the rupture, if there are enough points."""
    return layer_ending(
        state.track.points,
        pending.search or _searched(pending, config),
        pending.rupture,
        block_noise_N2(state.detector),
        config,
    )


def _has_come_back(state: DefaultState, pending: Pending, ending: LayerEnding | None) -> bool:
    seen = pending.first or ending
    if seen is None:
        return False
    noise = block_noise_N2(state.detector)
    return is_made_good(state.track.points, pending.rupture.depth_m, seen.drop_N, noise)


def _is_believed(ending: LayerEnding, *, is_final: bool) -> bool:
    return ending.drop_N >= (_REAL if is_final else _SIGNIFICANT) * ending.drop_std_N


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
    later = pending._replace(is_closed=True, next_look_m=config.second_look_m, first=ending)
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
