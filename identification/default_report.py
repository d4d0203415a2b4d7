"""What this toolkit's own identification tells about a sample."""

import math

import numpy as np

from identification.default_config import DefaultConfig
from identification.default_standing import Standing, cumulative, open_rupture, standing_of
from identification.default_state import DefaultState
from identification.estimate import Estimate, LayerEstimate
from identification.layer_figures import is_identified, revised
from identification.layer_hindsight import Belief, look_back
from identification.layer_model import MM, OWN_COULOMB, OWN_VISCOUS, LayerFit
from identification.sample import Sample
from identification.sample_check import SampleStatus
from identification.shaft_friction import shaft_friction


class DefaultReport:
    """Tells what is known after each sample.

    It keeps what changes rarely. That follows from the state alone: snapshots go without it.
    """

    def __init__(self) -> None:
        self._standing: Standing | None = None

    def __call__(
        self, state: DefaultState, sample: Sample, status: SampleStatus, config: DefaultConfig
    ) -> Estimate:
        """Enhanced force, tip force and their companions, for one sample."""
        standing = self._standing
        if standing is None or not standing.holds(state):
            standing = self._standing = standing_of(state)
        return estimate_at(state, sample, status, standing, config)


def estimate_at(
    state: DefaultState,
    sample: Sample,
    status: SampleStatus,
    standing: Standing,
    config: DefaultConfig,
) -> Estimate:
    """The estimate at one sample.

    Args:
        state: After the sample.
        sample: The sample.
        status: What became of it.
        standing: Of the state.
        config: Settings.
    """
    time_s, _, depth_m, speed_m_s, force_N = sample
    in_contact, fit = state.in_contact, state.fit
    force_N -= state.baseline.offset_N
    earlier_N = own_N = 0.0
    if in_contact:
        earlier_N, own_N = shaft_friction(state, sample, force_N, config)
    speed = MM * max(abs(speed_m_s), config.rest_speed_m_s)
    b, b_std = _own_friction(fit, speed)
    d, d_std = standing.cumulative or cumulative(standing.earlier, speed)
    tip_m = max(depth_m - state.layer.tip_m, 0.0)
    # By position: by name it would take three times as long, at every sample.
    return Estimate(
        time_s,
        status,
        state.rupture_state,
        in_contact,
        standing.layer,
        force_N - earlier_N,
        force_N - earlier_N - own_N,
        earlier_N + own_N,
        state.shaft_std_N,
        earlier_N + own_N + standing.stiffness[0] * tip_m,
        *standing.stiffness,
        b,
        b_std,
        in_contact and is_identified(b, b_std),
        d,
        d_std,
        state.rupture,
        state.compensated,
        state.withdrawn,
    )


def layers_now(state: DefaultState) -> tuple[LayerEstimate, ...]:
    """The layers left, as all that has been felt since tells them."""
    pending = open_rupture(state)
    fit = state.fit if pending is None else pending.left_fit
    friction = Belief(np.array(fit.values[:2]), fit.covariance[:2, :2])
    layers: list[LayerEstimate] = []
    for estimate, left in zip(reversed(state.layers), reversed(state.traversed), strict=True):
        belief = look_back(left.belief, left.thickness_m, friction)
        layers.append(revised(estimate, belief))
        friction = Belief(belief.values[:2], belief.covariance[:2, :2])
    return tuple(reversed(layers))


def _own_friction(fit: LayerFit, speed_mm_s: float) -> tuple[float, float]:
    """B of the current layer at a speed, and its standard deviation [Ns/m^2]."""
    values, spread = fit.values, fit.spread
    b = 1e6 * (values[OWN_COULOMB] / speed_mm_s + values[OWN_VISCOUS])
    variance = (
        spread.own_coulomb / speed_mm_s**2 + 2.0 * spread.own_both / speed_mm_s + spread.own_viscous
    )
    return b, 1e6 * math.sqrt(max(variance, 0.0))
