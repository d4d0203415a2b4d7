"""What a sample asks of the published method beyond `paper_tick`: windows, ruptures, layers."""

from identification.estimate import LayerEstimate, Rupture, layers_left
from identification.force_drop import drop_interval_s
from identification.paper_compensation import compensate, identify_left
from identification.paper_config import PaperConfig
from identification.paper_state import LeftLayer, PaperState
from identification.paper_tick import PaperTick, is_window_full
from identification.rls import RlsState, reset_covariance
from identification.rupture_state import RuptureState, next_rupture_state
from identification.sample import Sample
from identification.window_history import append_window, joined
from identification.window_sums import WindowSums


def initial_paper_state(config: PaperConfig) -> PaperState:
    """State before the first sample."""
    rls = RlsState(0.0, 0.0, float(config.var_stiffness), 0.0, float(config.var_friction))
    return PaperState(PaperTick(rls), config.contact_depth_m)


def begin_paper_sample(state: PaperState, config: PaperConfig) -> PaperState:
    """Before a sample: events are over, and a layer found is now taken out of the force."""
    if state.found is not None:
        layer = state.found.layer
        return compensate(state, state.found, config)._replace(rupture=None, compensated=layer)
    if state.rupture is None and state.compensated is None:
        return state
    return state._replace(rupture=None, compensated=None)


def paper_step(
    state: PaperState, tick: PaperTick, sample: Sample, config: PaperConfig
) -> PaperState:
    """What is left of a sample that `paper_tick` has absorbed.

    Covariance resetting, state machine; after T_drop the force drop (10)(11), re-weighting (12)
    and re-run of `paper_compensation`.

    Args:
        state: Before the sample.
        tick: What `paper_tick` has made of the sample.
        sample: The sample.
        config: Settings.
    """
    state = state._replace(tick=tick)
    if sample.depth_m <= state.start_depth_m and not state.layers and state.left is None:
        return state
    if is_window_full(state.tick.window_s, config.reset_frequency_Hz):
        state = _close_window(state, config)
    state = state._replace(rupture_state=_machine(state, config))
    if state.rupture_state is RuptureState.DETECTED and state.left is None:
        return _open_layer(state, sample, config)
    if state.rupture_state is RuptureState.COMPENSATED and state.left is not None:
        return identify_left(state, sample.force_N, config)
    return state


def _close_window(state: PaperState, config: PaperConfig) -> PaperState:
    """Covariance resetting, and the sums of the reset window."""
    tick = state.tick
    rls = reset_covariance(tick.rls, config.var_stiffness, config.var_friction)
    return state._replace(
        tick=tick._replace(rls=rls, window=WindowSums(), window_s=0.0),
        windows=append_window(state.windows, tick.window, config.most_windows),
    )


def _machine(state: PaperState, config: PaperConfig) -> RuptureState:
    """One step of the state machine."""
    tick, left = state.tick, state.left
    drop_s = drop_interval_s(config.drop_travel_m, left.rupture.speed_m_s) if left else 0.0
    return next_rupture_state(
        state.rupture_state,
        is_alarm=tick.is_alarm,
        is_expected=tick.is_expected,
        is_measured=left is not None and tick.waited_s >= drop_s,
        is_settled=tick.waited_s * config.reset_frequency_Hz >= 1.0,
    )


def _open_layer(state: PaperState, sample: Sample, config: PaperConfig) -> PaperState:
    """A rupture is detected: the next layer begins here and now (d_i of Section III).

    f(t_r) of (10) is the last force before the alarming sample, which may have dropped already.
    """
    tick = state.tick
    rupture = Rupture(
        layer=layers_left(state.layers) + 1,
        alarm_s=sample.time_s,
        alarm_depth_m=sample.depth_m,
        time_s=sample.time_s,
        depth_m=sample.depth_m,
        force_N=tick.force_before_N,
        speed_m_s=sample.speed_m_s,
        confidence=1.0,
    )
    windows = joined(append_window(state.windows, tick.window, config.most_windows))
    left = LeftLayer(state.start_depth_m, windows, tick.mean_speed_m_s, rupture)
    fresh = initial_paper_state(config)
    return state._replace(
        tick=fresh.tick._replace(
            derivative_N_per_s=tick.derivative_N_per_s,
            force_N=tick.force_N,
            force_before_N=tick.force_before_N,
            predicted_N=tick.predicted_N,
            is_expected=tick.is_expected,
        ),
        start_depth_m=sample.depth_m,
        windows=fresh.windows,
        left=left,
        rupture=rupture,
    )


def paper_layers(state: PaperState) -> tuple[LayerEstimate, ...]:
    """The layers left; what follows does not change them."""
    return state.layers if state.found is None else (*state.layers, state.found.layer)
