"""What this toolkit's own identification tells about a sample."""

import math

from identification.default_config import DefaultConfig
from identification.default_state import DefaultState
from identification.estimate import Estimate
from identification.layer_close import is_identified
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
    usual = MM * state.layers[-1].rupture.speed_m_s if state.layers else speed
    d = MM * (fit[COULOMB] / usual + fit[VISCOUS])
    d_var = spread.coulomb / usual**2 + 2.0 * spread.both / usual + spread.viscous
    tip = max(sample.depth_m - state.layer.tip_m, 0.0)
    return Estimate(
        time_s=sample.time_s,
        status=status,
        rupture_state=state.rupture_state,
        in_contact=state.in_contact,
        layer=len(state.layers) + _is_open(state) + 1 if state.in_contact else 0,
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
        cumulative_friction_std_Ns_per_m=MM * math.sqrt(max(d_var, 0.0)),
        rupture=state.rupture,
        compensated=state.compensated,
    )


def _is_open(state: DefaultState) -> bool:
    """Whether a rupture has been alarmed whose layer is not identified yet."""
    return state.pending is not None and not state.pending.is_closed
