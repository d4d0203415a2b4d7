"""What `default_tick` reads until the layer is fitted anew: worked out then, not every time."""

import math
from typing import Any, NamedTuple

from identification import default_tick as at
from identification.block import least_block_s
from identification.default_config import DefaultConfig
from identification.default_state import DefaultState, Pending, Traversed
from identification.estimate import LayerEstimate, layers_left
from identification.layer_figures import IDENTIFIED_SHARE
from identification.layer_model import (
    COULOMB,
    MM,
    OWN_COULOMB,
    OWN_VISCOUS,
    STIFFNESS,
    VISCOUS,
    LayerFit,
)
from identification.packed import packed


class DefaultStanding(NamedTuple):
    """What follows from a state and changes with the fit, a rupture or the layers only.

    Attributes:
        numbers: What `default_tick` takes.
        in_contact: Of the state that it was worked out from, as the next three.
        fit: See `DefaultState`.
        pending: See `DefaultState`.
        layers: See `DefaultState`.
        is_due: Whether the next sample finds work to do.
    """

    numbers: Any
    in_contact: bool
    fit: LayerFit
    pending: Pending | None
    layers: tuple[LayerEstimate, ...]
    is_due: bool

    def holds(self, state: DefaultState) -> bool:
        """Whether it still says what holds of a state."""
        return (
            self.fit is state.fit
            and self.pending is state.pending
            and self.layers is state.layers
            and self.in_contact == state.in_contact
            and self.is_due == is_due(state)
        )


def is_due(state: DefaultState) -> bool:
    """Whether the next sample finds work to do even if it fills no block."""
    if state.rupture is not None or state.compensated is not None or state.withdrawn is not None:
        return True
    pending = state.pending
    return pending is not None and (pending.search is None or pending.look is not None)


def default_standing(state: DefaultState, config: DefaultConfig) -> DefaultStanding:
    """Work it out of a state."""
    numbers = [0.0] * at.TRAVERSED
    numbers[at.SMOOTHING_S] = config.speed_smoothing_s
    numbers[at.PLAY_M] = config.track_step_m
    numbers[at.PRESLIDING_M] = config.presliding_m
    numbers[at.BLOCK_S] = least_block_s(config.block_s)
    numbers[at.ONSET_M] = config.cutting_onset_m
    numbers[at.REST_SPEED] = config.rest_speed_m_s
    numbers[at.IDENTIFIED_SHARE] = IDENTIFIED_SHARE
    numbers[at.IS_DUE] = is_due(state)
    numbers[at.OFFSET_N] = state.baseline.offset_N
    _lay_out_layer(numbers, state)
    _lay_out_earlier(numbers, state)
    for layer in state.traversed:
        numbers += _shares(layer)
    return DefaultStanding(
        packed(numbers), state.in_contact, state.fit, state.pending, state.layers, is_due(state)
    )


def _lay_out_layer(numbers: list[float], state: DefaultState) -> None:
    """The layer the tip is in."""
    fit, layers = state.fit, state.layers
    numbers[at.IN_CONTACT] = state.in_contact
    if state.in_contact:
        numbers[at.LAYER] = layers_left(layers) + (open_rupture(state) is not None) + 1
    numbers[at.START_M], numbers[at.TIP_M] = state.layer.start_m, state.layer.tip_m
    numbers[at.COULOMB], numbers[at.VISCOUS] = fit.values[COULOMB], fit.values[VISCOUS]
    numbers[at.STIFFNESS] = MM * fit.values[STIFFNESS]
    numbers[at.STIFFNESS_STD] = MM * math.sqrt(fit.spread.stiffness)
    numbers[at.OWN_COULOMB] = fit.values[OWN_COULOMB]
    numbers[at.OWN_VISCOUS] = fit.values[OWN_VISCOUS]
    numbers[at.VAR_OWN_COULOMB] = fit.spread.own_coulomb
    numbers[at.VAR_OWN_BOTH] = fit.spread.own_both
    numbers[at.VAR_OWN_VISCOUS] = fit.spread.own_viscous
    numbers[at.SHAFT_STD_N] = state.shaft_std_N


def _lay_out_earlier(numbers: list[float], state: DefaultState) -> None:
    """Friction of the layers before, which no open rupture has touched."""
    pending, layers = open_rupture(state), state.layers
    fit = state.fit if pending is None else pending.left_fit
    numbers[at.EARLIER_COULOMB] = fit.values[COULOMB]
    numbers[at.EARLIER_VISCOUS] = fit.values[VISCOUS]
    numbers[at.VAR_COULOMB] = fit.spread.coulomb
    numbers[at.VAR_BOTH] = fit.spread.both
    numbers[at.VAR_VISCOUS] = fit.spread.viscous
    # At the speed of the last rupture; before the first, at the present one.
    numbers[at.CUMULATIVE_SPEED] = MM * layers[-1].rupture.speed_m_s if layers else 0.0


def _shares(layer: Traversed) -> tuple[float, float, float, float]:
    return layer.start_m, layer.thickness_m, layer.coulomb_N, layer.viscous


def open_rupture(state: DefaultState) -> Pending | None:
    """The rupture alarmed whose layer is not identified yet, if any."""
    pending = state.pending
    return None if pending is None or pending.is_closed else pending
