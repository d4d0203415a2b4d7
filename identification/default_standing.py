"""What a report says until the layer is fitted anew: worked out then, not at every sample."""

import math
from typing import NamedTuple

from identification.default_state import DefaultState, Pending
from identification.estimate import LayerEstimate, layers_left
from identification.layer_figures import is_identified
from identification.layer_model import COULOMB, MM, STIFFNESS, VISCOUS, LayerFit


class Standing(NamedTuple):
    """Figures that change with the fit, a rupture or the layers only.

    Attributes:
        in_contact: Of the state that it was worked out from, as the next three.
        fit: See `DefaultState`.
        pending: See `DefaultState`.
        layers: See `DefaultState`.
        layer: Number of the layer the tip is in, see `Estimate`.
        stiffness: K [N/m], its standard deviation, and whether it is identified.
        earlier: Fit of the friction of the layers before, which no open rupture has touched.
        cumulative: Sum of B_j d_j at the speed of the last rupture [Ns/m] and its standard
            deviation; None before a rupture: then the present speed counts.
    """

    in_contact: bool
    fit: LayerFit
    pending: Pending | None
    layers: tuple[LayerEstimate, ...]
    layer: int
    stiffness: tuple[float, float, bool]
    earlier: LayerFit
    cumulative: tuple[float, float] | None

    def holds(self, state: DefaultState) -> bool:
        """Whether it still says what holds of a state."""
        return (
            self.fit is state.fit
            and self.pending is state.pending
            and self.layers is state.layers
            and self.in_contact == state.in_contact
        )


def standing_of(state: DefaultState) -> Standing:
    """Work it out of a state."""
    pending, fit, layers = open_rupture(state), state.fit, state.layers
    k, k_std = MM * fit.values[STIFFNESS], MM * math.sqrt(fit.spread.stiffness)
    earlier = fit if pending is None else pending.left_fit
    return Standing(
        in_contact=state.in_contact,
        fit=fit,
        pending=state.pending,
        layers=layers,
        layer=layers_left(layers) + (pending is not None) + 1 if state.in_contact else 0,
        stiffness=(k, k_std, state.in_contact and is_identified(k, k_std)),
        earlier=earlier,
        cumulative=cumulative(earlier, MM * layers[-1].rupture.speed_m_s) if layers else None,
    )


def cumulative(earlier: LayerFit, speed_mm_s: float) -> tuple[float, float]:
    """Sum of B_j d_j at a speed, and its standard deviation [Ns/m].

    Args:
        earlier: Fit that holds the friction of the layers traversed.
        speed_mm_s: The speed.
    """
    spread = earlier.spread
    variance = spread.coulomb / speed_mm_s**2 + 2.0 * spread.both / speed_mm_s + spread.viscous
    mean = earlier.values[COULOMB] / speed_mm_s + earlier.values[VISCOUS]
    return MM * mean, MM * math.sqrt(max(variance, 0.0))


def open_rupture(state: DefaultState) -> Pending | None:
    """The rupture alarmed whose layer is not identified yet, if any."""
    pending = state.pending
    return None if pending is None or pending.is_closed else pending
