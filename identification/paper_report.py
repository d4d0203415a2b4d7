"""What the published method tells about a sample."""

from identification.estimate import Estimate, LayerEstimate, Rupture, layers_left
from identification.paper_config import PaperConfig
from identification.paper_state import PaperState
from identification.paper_step import regressor
from identification.sample import Sample
from identification.sample_check import SampleStatus


def report_paper(
    state: PaperState, sample: Sample, status: SampleStatus, config: PaperConfig
) -> Estimate:
    """Enhanced force f - sum(B_j d_j) v and its companions, for one sample."""
    depth = max(sample.depth_m - state.traverse.start_depth_m, 0.0)
    _, phi_b = regressor(depth, sample.speed_m_s, config)
    in_contact = depth > 0.0 or bool(state.layers) or state.left is not None
    earlier = state.cumulative_friction_Ns_per_m * sample.speed_m_s
    own = state.rls.friction * phi_b if in_contact else 0.0
    return Estimate(
        time_s=sample.time_s,
        status=status,
        rupture_state=state.rupture_state,
        in_contact=in_contact,
        layer=(layers_left(state.layers) + (state.left is not None) + 1) if in_contact else 0,
        enhanced_force_N=sample.force_N - earlier,
        tip_force_N=sample.force_N - earlier - own,
        shaft_friction_N=earlier + own,
        shaft_friction_std_N=None,
        predicted_force_N=state.predicted_N,
        stiffness_N_per_m=state.rls.stiffness,
        stiffness_std_N_per_m=None,
        stiffness_identified=False,
        friction_Ns_per_m2=state.rls.friction,
        friction_std_Ns_per_m2=None,
        friction_identified=False,
        cumulative_friction_Ns_per_m=state.cumulative_friction_Ns_per_m,
        cumulative_friction_std_Ns_per_m=None,
        rupture=_event(state, sample),
        compensated=state.compensated,
    )


def _event(state: PaperState, sample: Sample) -> Rupture | None:
    rupture = state.rupture
    return rupture if rupture is not None and rupture.alarm_s == sample.time_s else None


def paper_layers(state: PaperState) -> tuple[LayerEstimate, ...]:
    """The layers left; what follows does not change them."""
    return state.layers if state.found is None else (*state.layers, state.found.layer)
