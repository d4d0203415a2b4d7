"""From alarm to compensation, a bounded amount of work per tick."""

import math

import numpy as np

from identification.block import Block
from identification.change_point import blocks_since_kink
from identification.default_config import DefaultConfig
from identification.default_state import DefaultState, Pending
from identification.estimate import Rupture, layers_left
from identification.kink_detector import Verdict, restart_detector
from identification.kink_kernels import kink_kernels
from identification.layer_model import (
    MM,
    OWN_COULOMB,
    OWN_VISCOUS,
    layer_fit,
    no_information,
)
from identification.layer_rows import NO_ROWS
from identification.rupture_look import RuptureLook
from identification.rupture_stages import look_stage, search_stage
from identification.rupture_state import RuptureState
from identification.track import DEPTH


def raise_rupture(
    state: DefaultState, block: Block, verdict: Verdict, config: DefaultConfig
) -> DefaultState:
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
        return look_stage(state, pending, RuptureLook(is_final), config)
    return state


def work_on_rupture(state: DefaultState, config: DefaultConfig) -> DefaultState:
    """One stage of what the pending rupture asks for: in ticks between blocks there is time."""
    pending = state.pending
    if pending is None:
        return state
    if pending.search is None:
        return state._replace(pending=search_stage(pending, config))
    return state if pending.look is None else look_stage(state, pending, pending.look, config)


def finish_look(state: DefaultState, config: DefaultConfig) -> DefaultState:
    """What is left of a look that has begun, at once: the next block must find it ended."""
    while state.pending is not None and state.pending.look is not None:
        state = work_on_rupture(state, config)
    return state
