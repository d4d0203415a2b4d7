"""The published method beyond `published_update`: windows, ruptures, layers (Section III-B)."""

from typing import NamedTuple

from identification.config import PublishedConfig
from identification.estimate import (
    MUTED,
    Events,
    LayerEstimate,
    Rupture,
    RuptureState,
    layers_left,
    next_rupture_state,
)
from identification.input_validation import Sample
from identification.published_update import (
    NO_WINDOWS,
    Array,
    PublishedCoefficients,
    PublishedMemory,
    RlsState,
    WindowSums,
    append_window,
    is_window_full,
    less_viscous_force,
    less_viscous_windows,
    rerun_windows,
    reset_covariance,
    window_step,
)


class LeftLayer(NamedTuple):
    """A layer just left, while its force drop is being measured."""

    start_depth_m: float  # Depth at which it begins
    windows: Array  # Sums of its reset windows
    mean_speed_m_s: float  # Average speed in it
    rupture: Rupture  # How it ended


class PublishedState(NamedTuple):
    """All that the published method remembers; immutable."""

    memory: PublishedMemory  # What every sample changes
    start_depth_m: float  # Depth at which the current layer begins
    windows: Array = NO_WINDOWS  # Sums of its closed reset windows
    left: LeftLayer | None = None  # The layer just left, until its friction is subtracted
    rupture_state: RuptureState = RuptureState.NO_RUPTURE  # State of the rupture machine
    cumulative_friction_Ns_per_m: float = 0.0  # Sum of B_j d_j over the layers subtracted
    layers: tuple[LayerEstimate, ...] = ()  # Layers identified so far
    # The layer just left once it is identified, with its part B_i d_i of the cumulative friction,
    # until the next sample
    found: tuple[LayerEstimate, float] | None = None
    rupture: Rupture | None = None  # Raised by this sample
    # The layer whose friction is subtracted from this sample on, if any
    identified_layer: LayerEstimate | None = None

    @property
    def events(self) -> Events:
        """What the last three fields of an `Estimate` report; this method retracts nothing."""
        return self.rupture, self.identified_layer, None

    @property
    def is_due(self) -> bool:
        """Whether the next sample finds work to do: around a rupture, every one does."""
        is_quiet = self.rupture_state in (RuptureState.NO_RUPTURE, RuptureState.EXPECTED)
        return not is_quiet or self.found is not None or self.identified_layer is not None

    @property
    def sources(self) -> tuple[object, ...]:
        """What `published_coefficients` follow from."""
        return self.rupture_state, self.left, self.layers, self.is_due


# Equations (10) to (12): force drop, ratios, re-weighting.

_SMALLEST_RATIO = 1e-3
_LEAST_THICKNESS_M = 1e-9
_LEAST_SPEED_M_S = 1e-6
_MOST_LAYERS = 256
"""Layers kept: far more than a needle meets; the oldest go first."""


def drop_interval_s(travel_m: float, speed_m_s: float) -> float:
    """Waiting time T_drop = k_v / v (Section VI-A); the published k_v = 1 is in millimetres."""
    return travel_m / speed_m_s


def force_drop_N(force_at_rupture_N: float, force_after_N: float) -> float:
    """Force drop f(t_r) - f(t_r + T_drop), equation (10)."""
    return force_at_rupture_N - force_after_N


def force_ratios(
    drop_N: float,
    force_at_rupture_N: float,
    cumulative_friction_Ns_per_m: float,
    speed_m_s: float,
) -> tuple[float, float]:
    """Elastic and friction ratio (r_K, r_B) of the layer just left, equation (11).

    A drop below zero or above the whole force has no physical ratio; r_K is kept inside
    (0, 1) by a thousandth so that (12) stays positive and finite.

    Args:
        drop_N: Force drop of equation (10).
        force_at_rupture_N: f(t_r).
        cumulative_friction_Ns_per_m: Sum of B_j d_j over the layers before; zero for the first.
        speed_m_s: v(t_r).
    """
    own_N = force_at_rupture_N - cumulative_friction_Ns_per_m * speed_m_s
    raw = drop_N / own_N if own_N > 0.0 else 1.0
    elastic = min(max(raw, _SMALLEST_RATIO), 1.0 - _SMALLEST_RATIO)
    return elastic, 1.0 - elastic


def reweighted_friction_variance(
    var_friction: float, elastic_ratio: float, friction_ratio: float, mean_speed_m_s: float
) -> float:
    """sigma'^2_B,0 = (1 / v^2) (r_B / r_K) sigma^2_B,0, equation (12).

    With collinear columns least squares moves the estimate along Psi phi, so that
    (B v dz) / (K dz) settles at sigma'^2_B v^2 / sigma^2_K = r_B / r_K.

    Args:
        var_friction: sigma^2_B,0.
        elastic_ratio: r_K of equation (11), positive.
        friction_ratio: r_B of equation (11).
        mean_speed_m_s: Average speed while traversing the layer, not zero.
    """
    return var_friction * friction_ratio / (elastic_ratio * mean_speed_m_s * mean_speed_m_s)


def identify_left(state: PublishedState, force_N: float, config: PublishedConfig) -> PublishedState:
    """Identify the layer just left: equations (10) to (12) and the re-run."""
    left = state.left
    if left is None:
        return state
    rupture = left.rupture
    drop = force_drop_N(rupture.force_N, force_N)
    elastic, friction_ratio = force_ratios(
        drop, rupture.force_N, state.cumulative_friction_Ns_per_m, rupture.speed_m_s
    )
    speed = max(abs(left.mean_speed_m_s), _LEAST_SPEED_M_S)
    variance = reweighted_friction_variance(config.var_friction, elastic, friction_ratio, speed)
    start = (float(config.var_stiffness), float(variance))
    stiffness, friction = rerun_windows(left.windows, start, (0.0, 0.0))
    thickness = max(rupture.depth_m - left.start_depth_m, _LEAST_THICKNESS_M)
    damping = friction * (thickness if config.model == "ml" else 1.0)
    layer = LayerEstimate(
        layer=rupture.layer,
        is_final=True,
        start_depth_m=left.start_depth_m,
        thickness_m=thickness,
        rupture=rupture,
        force_drop_N=drop,
        stiffness_N_per_m=stiffness,
        stiffness_identified=drop > 0.0,
        friction_Ns_per_m2=friction,
        friction_identified=drop > 0.0,
        friction_N=damping * rupture.speed_m_s,
    )
    return state._replace(found=(layer, damping))


def begin_published_sample(state: PublishedState, config: PublishedConfig) -> PublishedState:
    """Before a sample: events are over, and a layer found is now taken out of the force."""
    if state.found is not None:
        return _subtract_friction(state, *state.found, config)
    if state.rupture is None and state.identified_layer is None:
        return state
    return state._replace(rupture=None, identified_layer=None)


def _subtract_friction(
    state: PublishedState, layer: LayerEstimate, friction: float, config: PublishedConfig
) -> PublishedState:
    """Take the friction of the layer left out of the force of the next one.

    The sums of the new layer are corrected for the friction now known, so its estimate goes on
    as if that friction had been subtracted from the rupture onwards. This is the second half of
    the re-run's work, done before the next sample is used.
    """
    memory = state.memory
    windows = less_viscous_windows(state.windows, friction)
    window = less_viscous_force(memory.window, friction)
    start = (float(config.var_stiffness), float(config.var_friction))
    stiffness, own = window_step(rerun_windows(windows, start, (0.0, 0.0)), window, start)
    return state._replace(
        memory=memory._replace(
            rls=RlsState(stiffness, own, start[0], 0.0, start[1]),
            window=window,
            waited_s=0.0,
        ),
        windows=windows,
        left=None,
        cumulative_friction_Ns_per_m=state.cumulative_friction_Ns_per_m + friction,
        layers=(*state.layers, layer)[-_MOST_LAYERS:],
        found=None,
        rupture=None,
        identified_layer=layer,
    )


def initial_published_state(config: PublishedConfig) -> PublishedState:
    """State before the first sample."""
    rls = RlsState(0.0, 0.0, float(config.var_stiffness), 0.0, float(config.var_friction))
    return PublishedState(PublishedMemory(rls), config.contact_depth_m)


def published_step(
    state: PublishedState, memory: PublishedMemory, sample: Sample, config: PublishedConfig
) -> PublishedState:
    """What is left of a sample that `update_published` has used.

    Covariance resetting, state machine; after T_drop force drop (10)(11), re-weighting (12) and
    re-run.
    """
    state = state._replace(memory=memory)
    if sample.depth_m <= state.start_depth_m and not state.layers and state.left is None:
        return state
    if is_window_full(memory.window_s, config.reset_frequency_Hz):
        state = _close_window(state, config)
    state = state._replace(rupture_state=_next_state(state, config))
    if state.rupture_state is RuptureState.DETECTED and state.left is None:
        return _open_layer(state, sample, config)
    if state.rupture_state is RuptureState.FRICTION_IDENTIFIED and state.left is not None:
        return identify_left(state, sample.force_N, config)
    return state


def _close_window(state: PublishedState, config: PublishedConfig) -> PublishedState:
    """Covariance resetting, and the sums of the reset window."""
    memory = state.memory
    rls = reset_covariance(memory.rls, config.var_stiffness, config.var_friction)
    return state._replace(
        memory=memory._replace(rls=rls, window=WindowSums(), window_s=0.0),
        windows=append_window(state.windows, memory.window, config.most_windows),
    )


def _next_state(state: PublishedState, config: PublishedConfig) -> RuptureState:
    memory, left = state.memory, state.left
    drop_s = drop_interval_s(config.drop_travel_m, left.rupture.speed_m_s) if left else 0.0
    return next_rupture_state(
        state.rupture_state,
        is_alarm=memory.is_alarm,
        is_expected=memory.is_expected,
        is_measured=left is not None and memory.waited_s >= drop_s,
        is_settled=memory.waited_s * config.reset_frequency_Hz >= 1.0,
    )


def _open_layer(state: PublishedState, sample: Sample, config: PublishedConfig) -> PublishedState:
    """A rupture is detected: the next layer begins here and now (d_i of Section III).

    f(t_r) of (10) is the last force before the alarming sample, which may have dropped already.
    """
    memory = state.memory
    rupture = Rupture(
        layer=layers_left(state.layers) + 1,
        alarm_s=sample.time_s,
        alarm_depth_m=sample.depth_m,
        time_s=sample.time_s,
        depth_m=sample.depth_m,
        force_N=memory.force_before_N,
        speed_m_s=sample.speed_m_s,
        confidence=1.0,
        contact_depth_m=float(config.contact_depth_m),
    )
    windows = append_window(state.windows, memory.window, config.most_windows)
    left = LeftLayer(state.start_depth_m, windows, memory.mean_speed_m_s, rupture)
    fresh = initial_published_state(config)
    return state._replace(
        memory=fresh.memory._replace(
            derivative_N_per_s=memory.derivative_N_per_s,
            force_N=memory.force_N,
            force_before_N=memory.force_before_N,
            predicted_N=memory.predicted_N,
            is_expected=memory.is_expected,
        ),
        start_depth_m=sample.depth_m,
        windows=fresh.windows,
        left=left,
        rupture=rupture,
    )


def published_layers(state: PublishedState) -> tuple[LayerEstimate, ...]:
    """The layers left; what follows does not change them."""
    return state.layers if state.found is None else (*state.layers, state.found[0])


def cusum_constants(sigma0_N: float, sigma1_N: float) -> tuple[float, float]:
    """Drift nu and threshold gamma [N^2] of the CUSUM on the squared error, equation (9).

    Returns:
        nu = (sigma1^2 + sigma0^2) / 2 and gamma = (sigma1^2 - sigma0^2) / 2.
    """
    var0, var1 = sigma0_N * sigma0_N, sigma1_N * sigma1_N
    return (var1 + var0) / 2.0, (var1 - var0) / 2.0


def published_coefficients(state: PublishedState, config: PublishedConfig) -> PublishedCoefficients:
    """What follows from a state and seldom changes; beta grows at each detection."""
    left = layers_left(state.layers) + (state.left is not None)
    drift, threshold = cusum_constants(config.sigma0_N, config.sigma1_N)
    return PublishedCoefficients(
        least_speed_m_s=config.least_speed_m_s,
        drift=drift,
        threshold=threshold,
        beta=config.derivative_threshold_N_per_s + left * config.derivative_rise_N_per_s,
        derivative_s=config.derivative_time_constant_s,
        reset_Hz=config.reset_frequency_Hz,
        is_ml=config.model == "ml",
        start_m=state.start_depth_m,
        is_inside=left > 0,
        layer=left + 1,
        cumulative_Ns_per_m=state.cumulative_friction_Ns_per_m,
        is_muted=state.rupture_state in MUTED,
        is_expected=state.rupture_state is RuptureState.EXPECTED,
        is_due=state.is_due,
    )
