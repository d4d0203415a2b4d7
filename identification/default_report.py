"""What this toolkit's own identification tells about a sample."""

import math

import numpy as np

from identification.default_config import DefaultConfig
from identification.default_state import DefaultState, Pending
from identification.estimate import Estimate, LayerEstimate, layers_left
from identification.layer_figures import is_identified, revised
from identification.layer_hindsight import Belief, look_back
from identification.layer_model import (
    COULOMB,
    MM,
    OWN_COULOMB,
    OWN_VISCOUS,
    STIFFNESS,
    VISCOUS,
)
from identification.sample import Sample
from identification.sample_check import SampleStatus
from identification.shaft_friction import ShaftFriction, shaft_friction


def report_default(
    state: DefaultState, sample: Sample, status: SampleStatus, config: DefaultConfig
) -> Estimate:
    """Enhanced force, tip force and their companions, for one sample."""
    force = sample.force_N - state.baseline.offset_N
    friction = (
        shaft_friction(state, sample, force, config)
        if state.in_contact
        else ShaftFriction(0.0, 0.0)
    )
    fit, spread = state.fit.values, state.fit.spread
    k, k_std = MM * fit[STIFFNESS], MM * math.sqrt(spread.stiffness)
    speed = MM * max(abs(sample.speed_m_s), config.rest_speed_m_s)
    b = 1e6 * (fit[OWN_COULOMB] / speed + fit[OWN_VISCOUS])
    b_var = spread.own_coulomb / speed**2 + 2.0 * spread.own_both / speed + spread.own_viscous
    b_std = 1e6 * math.sqrt(max(b_var, 0.0))
    d, d_std = _cumulative(state, speed)
    tip = max(sample.depth_m - state.layer.tip_m, 0.0)
    return Estimate(
        time_s=sample.time_s,
        status=status,
        rupture_state=state.rupture_state,
        in_contact=state.in_contact,
        layer=layers_left(state.layers) + (_open(state) is not None) + 1 if state.in_contact else 0,
        enhanced_force_N=force - friction.earlier_N,
        tip_force_N=force - friction.earlier_N - friction.own_N,
        shaft_friction_N=friction.earlier_N + friction.own_N,
        shaft_friction_std_N=state.shaft_std_N,
        predicted_force_N=friction.earlier_N + friction.own_N + k * tip,
        stiffness_N_per_m=k,
        stiffness_std_N_per_m=k_std,
        stiffness_identified=state.in_contact and is_identified(k, k_std),
        friction_Ns_per_m2=b,
        friction_std_Ns_per_m2=b_std,
        friction_identified=state.in_contact and is_identified(b, b_std),
        cumulative_friction_Ns_per_m=d,
        cumulative_friction_std_Ns_per_m=d_std,
        rupture=state.rupture,
        compensated=state.compensated,
        withdrawn=state.withdrawn,
    )


def layers_now(state: DefaultState) -> tuple[LayerEstimate, ...]:
    """The layers left, as all that has been felt since tells them."""
    pending = _open(state)
    fit = state.fit if pending is None else pending.left_fit
    friction = Belief(np.array(fit.values[:2]), fit.covariance[:2, :2])
    layers: list[LayerEstimate] = []
    for estimate, left in zip(reversed(state.layers), reversed(state.traversed), strict=True):
        belief = look_back(left.belief, left.thickness_m, friction)
        layers.append(revised(estimate, belief))
        friction = Belief(belief.values[:2], belief.covariance[:2, :2])
    return tuple(reversed(layers))


def _cumulative(state: DefaultState, speed_mm_s: float) -> tuple[float, float]:
    """Sum of B_j d_j at the speed of the last rupture, and its standard deviation [Ns/m]."""
    pending = _open(state)
    fit = state.fit if pending is None else pending.left_fit
    speed = MM * state.layers[-1].rupture.speed_m_s if state.layers else speed_mm_s
    spread = fit.spread
    variance = spread.coulomb / speed**2 + 2.0 * spread.both / speed + spread.viscous
    mean = fit.values[COULOMB] / speed + fit.values[VISCOUS]
    return MM * mean, MM * math.sqrt(max(variance, 0.0))


def _open(state: DefaultState) -> Pending | None:
    """The rupture alarmed whose layer is not identified yet, if any."""
    pending = state.pending
    return None if pending is None or pending.is_closed else pending
