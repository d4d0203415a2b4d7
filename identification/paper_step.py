"""One sample through the published method, equations (7) to (12)."""

from identification.cusum import cusum_constants, cusum_step
from identification.estimate import Rupture, layers_left
from identification.force_derivative import derivative_step
from identification.force_drop import drop_interval_s
from identification.paper_compensation import compensate, identify_left
from identification.paper_config import PaperConfig
from identification.paper_state import PaperState, Traverse
from identification.rls import RlsState, reset_covariance, rls_step
from identification.rupture_state import MUTED, RuptureState, next_rupture_state
from identification.sample import Sample
from identification.window_history import append_window, joined
from identification.window_sums import WindowSums, add_sample


def initial_paper_state(config: PaperConfig) -> PaperState:
    """State before the first sample."""
    rls = RlsState(0.0, 0.0, config.var_stiffness, 0.0, config.var_friction)
    return PaperState(rls, Traverse(config.contact_depth_m))


def regressor(layer_depth_m: float, speed_m_s: float, config: PaperConfig) -> tuple[float, float]:
    """Columns (phi_K, phi_B): (dz, dz v) for `ml`, equation (3); (dz, v) for `kv`, (2)."""
    if config.model == "ml":
        return layer_depth_m, layer_depth_m * speed_m_s
    return layer_depth_m, speed_m_s


def paper_step(state: PaperState, sample: Sample, config: PaperConfig) -> PaperState:
    """Absorb one sample.

    RLS with covariance resetting (7)(8), CUSUM (9) and derivative criterion, state machine; after
    T_drop the force drop (10)(11), re-weighting (12) and re-run of `paper_compensation`.
    """
    if state.found is not None:
        later = paper_step(compensate(state, state.found, config), sample, config)
        return later._replace(compensated=state.found.layer)
    layer_depth = sample.depth_m - state.traverse.start_depth_m
    before_N = sample.force_N if state.last_force_N is None else state.last_force_N
    if layer_depth <= 0.0 and not state.layers and state.left is None:
        return state._replace(last_force_N=sample.force_N, predicted_N=0.0)
    state, error = _identify(state, sample, max(layer_depth, 0.0), config)
    state = _watch(state, sample, error, config)
    if state.rupture_state is RuptureState.DETECTED and state.left is None:
        return _open_layer(state, sample, before_N, config)
    if state.rupture_state is RuptureState.COMPENSATED and state.left is not None:
        return identify_left(state, sample.force_N, config)
    return state


def _identify(
    state: PaperState, sample: Sample, layer_depth_m: float, config: PaperConfig
) -> tuple[PaperState, float]:
    """Equations (7) and (8), covariance resetting, and the sums of the reset window."""
    phi = regressor(layer_depth_m, sample.speed_m_s, config)
    earlier = state.cumulative_friction_Ns_per_m * sample.speed_m_s
    own = sample.force_N - earlier
    rls, error = rls_step(state.rls, phi, own)
    window = add_sample(state.window, phi, own, sample.speed_m_s)
    window_s = state.window_s + sample.dt_s
    traverse = state.traverse
    time = traverse.travel_s + sample.dt_s
    mean = traverse.mean_speed_m_s
    mean += (sample.speed_m_s - mean) * sample.dt_s / time
    windows = traverse.windows
    if window_s * config.reset_frequency_Hz >= 1.0 - 1e-9:
        rls = reset_covariance(rls, config.var_stiffness, config.var_friction)
        windows = append_window(windows, window, config.most_windows)
        window, window_s = WindowSums(), 0.0
    return state._replace(
        rls=rls,
        window=window,
        window_s=window_s,
        traverse=Traverse(traverse.start_depth_m, windows, time, mean),
        predicted_N=own - error + earlier,
        compensated=None,
    ), error


def _watch(state: PaperState, sample: Sample, error_N: float, config: PaperConfig) -> PaperState:
    """CUSUM (9), derivative criterion and one step of the state machine."""
    drift, threshold = cusum_constants(config.sigma0_N, config.sigma1_N)
    machine = state.rupture_state
    is_muted = machine in MUTED or sample.speed_m_s < config.least_speed_m_s
    decision = 0.0 if is_muted else cusum_step(state.decision, error_N, drift)
    change = 0.0 if state.last_force_N is None else sample.force_N - state.last_force_N
    derivative = derivative_step(
        state.derivative_N_per_s, change, sample.dt_s, config.derivative_time_constant_s
    )
    detections = layers_left(state.layers) + (state.left is not None)
    beta = config.derivative_threshold_N_per_s + detections * config.derivative_rise_N_per_s
    waited = state.waited_s + sample.dt_s
    machine = next_rupture_state(
        machine,
        is_alarm=decision > threshold,
        is_expected=not is_muted and derivative < -beta,
        is_measured=_is_drop_over(state, waited, config),
        is_settled=waited * config.reset_frequency_Hz >= 1.0,
    )
    return state._replace(
        rupture_state=machine,
        decision=decision,
        derivative_N_per_s=derivative,
        last_force_N=sample.force_N,
        waited_s=waited,
    )


def _is_drop_over(state: PaperState, waited_s: float, config: PaperConfig) -> bool:
    if state.rupture is None:
        return False
    return waited_s >= drop_interval_s(config.drop_travel_m, state.rupture.speed_m_s)


def _open_layer(
    state: PaperState, sample: Sample, before_N: float, config: PaperConfig
) -> PaperState:
    """A rupture is detected: the next layer begins here and now (d_i of Section III).

    f(t_r) of (10) is the last force before the alarming sample, which may have dropped already.
    """
    rupture = Rupture(
        layer=layers_left(state.layers) + 1,
        alarm_s=sample.time_s,
        alarm_depth_m=sample.depth_m,
        time_s=sample.time_s,
        depth_m=sample.depth_m,
        force_N=before_N,
        speed_m_s=sample.speed_m_s,
        confidence=1.0,
    )
    windows = append_window(state.traverse.windows, state.window, config.most_windows)
    rls = RlsState(0.0, 0.0, config.var_stiffness, 0.0, config.var_friction)
    return state._replace(
        rls=rls,
        window=WindowSums(),
        window_s=0.0,
        traverse=Traverse(sample.depth_m),
        left=state.traverse._replace(windows=joined(windows)),
        rupture=rupture,
        decision=0.0,
        waited_s=0.0,
    )
