"""After T_drop: force drop, re-weighting, re-run over the layer just left (Section III-B)."""

from identification.estimate import LayerEstimate, Rupture
from identification.force_drop import force_drop_N, force_ratios
from identification.paper_config import PaperConfig
from identification.paper_state import PaperState, Traverse
from identification.reweighting import reweighted_friction_variance
from identification.rls import RlsState
from identification.window_history import less_viscous_rows, rerun_history
from identification.window_sums import less_viscous_force, window_step

_LEAST_THICKNESS_M = 1e-9
_LEAST_SPEED_M_S = 1e-6
_MOST_LAYERS = 256


def compensate(state: PaperState, force_N: float, config: PaperConfig) -> PaperState:
    """Identify the layer just left and take its friction out of the force of the next one.

    The sums of the new layer are corrected for the friction now known, so its estimate goes on
    as if that friction had been subtracted from the rupture onwards.

    Args:
        state: State in COMPENSATED with `left` and `rupture` set.
        force_N: f(t_r + T_drop).
        config: Settings.
    """
    left, rupture = state.left, state.rupture
    if left is None or rupture is None:
        return state
    layer, friction = _identify_layer(state, left, rupture, force_N, config)
    traverse = state.traverse
    windows = less_viscous_rows(traverse.windows, friction)
    window = less_viscous_force(state.window, friction)
    start = (config.var_stiffness, config.var_friction)
    stiffness, own = window_step(rerun_history(windows, start), window, start)
    return state._replace(
        rls=RlsState(stiffness, own, config.var_stiffness, 0.0, config.var_friction),
        window=window,
        traverse=traverse._replace(windows=windows),
        left=None,
        rupture=None,
        waited_s=0.0,
        cumulative_friction_Ns_per_m=state.cumulative_friction_Ns_per_m + friction,
        layers=(*state.layers, layer)[-_MOST_LAYERS:],
    )


def _identify_layer(
    state: PaperState, left: Traverse, rupture: Rupture, force_N: float, config: PaperConfig
) -> tuple[LayerEstimate, float]:
    """Equations (10) to (12) and the re-run; returns the layer and its share B_i d_i."""
    drop = force_drop_N(rupture.force_N, force_N)
    elastic, friction_share = force_ratios(
        drop, rupture.force_N, state.cumulative_friction_Ns_per_m, rupture.speed_m_s
    )
    speed = max(abs(left.mean_speed_m_s), _LEAST_SPEED_M_S)
    variance = reweighted_friction_variance(config.var_friction, elastic, friction_share, speed)
    stiffness, friction = rerun_history(left.windows, (config.var_stiffness, variance))
    thickness = max(rupture.depth_m - left.start_depth_m, _LEAST_THICKNESS_M)
    share = friction * (thickness if config.model == "ml" else 1.0)
    return LayerEstimate(
        layer=rupture.layer,
        start_depth_m=left.start_depth_m,
        thickness_m=thickness,
        rupture=rupture,
        force_drop_N=drop,
        stiffness_N_per_m=stiffness,
        stiffness_identified=drop > 0.0,
        friction_Ns_per_m2=friction,
        friction_identified=drop > 0.0,
        friction_N=share * rupture.speed_m_s,
    ), share
