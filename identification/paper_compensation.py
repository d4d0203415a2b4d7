"""After T_drop: force drop, re-weighting, re-run over the layer just left (Section III-B)."""

from identification.estimate import LayerEstimate
from identification.force_drop import force_drop_N, force_ratios
from identification.paper_config import PaperConfig
from identification.paper_state import FoundLayer, PaperState
from identification.reweighting import reweighted_friction_variance
from identification.rls import RlsState
from identification.window_history import less_viscous_rows
from identification.window_rerun import rerun_history
from identification.window_sums import less_viscous_force, window_step

_LEAST_THICKNESS_M = 1e-9
_LEAST_SPEED_M_S = 1e-6
_MOST_LAYERS = 256


def identify_left(state: PaperState, force_N: float, config: PaperConfig) -> PaperState:
    """Identify the layer just left: equations (10) to (12) and the re-run.

    Args:
        state: State in COMPENSATED with `left` set.
        force_N: f(t_r + T_drop).
        config: Settings.
    """
    left = state.left
    if left is None:
        return state
    rupture = left.rupture
    drop = force_drop_N(rupture.force_N, force_N)
    elastic, friction_share = force_ratios(
        drop, rupture.force_N, state.cumulative_friction_Ns_per_m, rupture.speed_m_s
    )
    speed = max(abs(left.mean_speed_m_s), _LEAST_SPEED_M_S)
    variance = reweighted_friction_variance(config.var_friction, elastic, friction_share, speed)
    stiffness, friction = rerun_history(
        left.windows, (float(config.var_stiffness), float(variance))
    )
    thickness = max(rupture.depth_m - left.start_depth_m, _LEAST_THICKNESS_M)
    share = friction * (thickness if config.model == "ml" else 1.0)
    layer = LayerEstimate(
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
    )
    return state._replace(found=FoundLayer(layer, share))


def compensate(state: PaperState, found: FoundLayer, config: PaperConfig) -> PaperState:
    """Take the friction of the layer left out of the force of the next one.

    The sums of the new layer are corrected for the friction now known, so its estimate goes on
    as if that friction had been subtracted from the rupture onwards. This is the second half of
    the re-run's work, done before the next sample is absorbed.

    Args:
        state: State in which the layer was identified.
        found: That layer.
        config: Settings.
    """
    friction, tick = found.damping_Ns_per_m, state.tick
    windows = less_viscous_rows(state.windows, friction)
    window = less_viscous_force(tick.window, friction)
    start = (float(config.var_stiffness), float(config.var_friction))
    stiffness, own = window_step(rerun_history(windows, start), window, start)
    return state._replace(
        tick=tick._replace(
            rls=RlsState(stiffness, own, start[0], 0.0, start[1]),
            window=window,
            waited_s=0.0,
        ),
        windows=windows,
        left=None,
        cumulative_friction_Ns_per_m=state.cumulative_friction_Ns_per_m + friction,
        layers=(*state.layers, found.layer)[-_MOST_LAYERS:],
        found=None,
    )
