"""The published method beyond `published_update`: windows, ruptures, layers (Section III-B)."""

from typing import NamedTuple

import numpy as np

from identification.config import PublishedConfig
from identification.estimate import (
    MUTED,
    Events,
    LayerEstimate,
    Rupture,
    RuptureState,
    Sample,
    layers_traversed,
    next_rupture_state,
)
from identification.published_update import (
    NO_WINDOWS,
    Array,
    PublishedCoefficients,
    PublishedMemory,
    RlsState,
    WindowSums,
    append_window,
    is_window_full,
    less_viscous_windows,
    rerun_windows,
    window_step,
)


class RupturedLayer(NamedTuple):
    """A layer that has ruptured, while its force drop is being measured."""

    start_depth_m: float  # Depth at which it begins
    windows: Array  # Sums of its reset windows
    mean_speed_m_s: float  # Average speed in it
    rupture: Rupture  # How it ended


class PublishedState(NamedTuple):
    """All that the published method remembers; immutable."""

    memory: PublishedMemory  # What every sample changes
    start_depth_m: float  # Depth at which the current layer begins
    windows: Array = NO_WINDOWS  # Sums of its closed reset windows
    ruptured: RupturedLayer | None = None  # The last layer, until its friction is subtracted
    rupture_state: RuptureState = RuptureState.NO_RUPTURE  # State of the rupture machine
    cumulative_friction_Ns_per_m: float = 0.0  # Sum of B_j d_j over the layers subtracted
    layers: tuple[LayerEstimate, ...] = ()  # Layers identified so far
    # That layer once identified, with its part B_i d_i of the cumulative friction, until the next
    # sample
    found: tuple[LayerEstimate, float] | None = None
    events: Events = Events()  # Of this sample; this method retracts nothing

    @property
    def known_layers(self) -> tuple[LayerEstimate, ...]:
        """The layers traversed; what follows does not change them."""
        return self.layers if self.found is None else (*self.layers, self.found[0])

    @property
    def is_due(self) -> bool:
        """Whether the next sample finds work to do: around a rupture, every one does."""
        is_quiet = self.rupture_state in (RuptureState.NO_RUPTURE, RuptureState.EXPECTED)
        return not is_quiet or self.found is not None or any(self.events)

    @property
    def sources(self) -> tuple[object, ...]:
        """What `published_coefficients` follow from."""
        return self.rupture_state, self.ruptured, self.layers, self.is_due


# Equations (10) to (12): force drop, ratios, re-weighting.

_SMALLEST_RATIO = 1e-3
_LEAST_THICKNESS_M = 1e-9
_LEAST_SPEED_M_S = 1e-6
_MOST_LAYERS = 256
"""Layers kept: far more than a needle meets; the oldest go first."""


def force_ratios(
    drop_N: float, force_at_rupture_N: float, cumulative_friction_Ns_per_m: float, speed_m_s: float
) -> tuple[float, float]:
    """Elastic and friction ratio (r_K, r_B) of the layer just traversed, equation (11).

    A drop below zero or above the whole force has no physical ratio; r_K is kept inside
    (0, 1) by a thousandth so that (12) stays positive and finite.
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
    """
    return var_friction * friction_ratio / (elastic_ratio * mean_speed_m_s * mean_speed_m_s)


def _identify(
    state: PublishedState, ruptured: RupturedLayer, force_N: float, config: PublishedConfig
) -> PublishedState:
    """Identify the layer that ruptured: equations (10) to (12) and the re-run."""
    rupture = ruptured.rupture
    drop = rupture.force_N - force_N  # (10): f(t_r) - f(t_r + T_drop)
    elastic, friction_ratio = force_ratios(
        drop, rupture.force_N, state.cumulative_friction_Ns_per_m, rupture.speed_m_s
    )
    speed = max(abs(ruptured.mean_speed_m_s), _LEAST_SPEED_M_S)
    variance = reweighted_friction_variance(config.var_friction, elastic, friction_ratio, speed)
    start = (float(config.var_stiffness), float(variance))
    stiffness, friction = rerun_windows(ruptured.windows, start, (0.0, 0.0))
    thickness = max(rupture.depth_m - ruptured.start_depth_m, _LEAST_THICKNESS_M)
    damping = friction * (thickness if config.model == "ml" else 1.0)
    layer = LayerEstimate(
        layer=rupture.layer,
        is_final=True,
        start_depth_m=ruptured.start_depth_m,
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
    """Before a sample: take the friction of a layer found out of the force.

    The sums of the new layer are corrected for the friction now known, so its estimate goes on
    as if that friction had been subtracted from the rupture onwards. This is the second half of
    the re-run's work, done before the next sample is used.
    """
    if state.found is None:
        return state
    (layer, friction), memory = state.found, state.memory
    windows = less_viscous_windows(np.vstack((state.windows, memory.window)), friction)
    windows, window = windows[:-1], WindowSums(*windows[-1].tolist())
    start = (float(config.var_stiffness), float(config.var_friction))
    stiffness, own = window_step(rerun_windows(windows, start, (0.0, 0.0)), window, start)
    return state._replace(
        memory=memory._replace(
            rls=RlsState(stiffness, own, start[0], 0.0, start[1]), window=window, waited_s=0.0
        ),
        windows=windows,
        ruptured=None,
        cumulative_friction_Ns_per_m=state.cumulative_friction_Ns_per_m + friction,
        layers=(*state.layers, layer)[-_MOST_LAYERS:],
        found=None,
        events=Events(identified_layer=layer),
    )


def initial_published_state(config: PublishedConfig) -> PublishedState:
    """State before the first sample."""
    rls = RlsState(0.0, 0.0, float(config.var_stiffness), 0.0, float(config.var_friction))
    return PublishedState(PublishedMemory(rls), config.contact_depth_m)


def published_step(
    state: PublishedState, memory: PublishedMemory, sample: Sample, config: PublishedConfig
) -> PublishedState:
    """The rest of a sample that `update_published` has used.

    Covariance resetting, state machine; after T_drop = k_v / v force drop (10)(11), re-weighting
    (12) and re-run.
    """
    ruptured = state.ruptured
    if sample.depth_m <= state.start_depth_m and not state.layers and ruptured is None:
        return state._replace(memory=memory)
    windows, drop_s = state.windows, 0.0
    if is_window_full(memory.window_s, config.reset_frequency_Hz):
        windows = append_window(windows, memory.window, config.most_windows)
        rls = memory.rls._replace(
            var_stiffness=float(config.var_stiffness),
            covariance=0.0,
            var_friction=float(config.var_friction),
        )
        memory = memory._replace(rls=rls, window=WindowSums(), window_s=0.0)
    if ruptured is not None:
        drop_s = config.drop_travel_m / ruptured.rupture.speed_m_s
    rupture_state = next_rupture_state(
        state.rupture_state,
        is_alarm=memory.is_alarm,
        is_expected=memory.is_expected,
        is_measured=ruptured is not None and memory.waited_s >= drop_s,
        is_settled=memory.waited_s * config.reset_frequency_Hz >= 1.0,
    )
    state = state._replace(memory=memory, windows=windows, rupture_state=rupture_state)
    if rupture_state is RuptureState.DETECTED and ruptured is None:
        return _open_layer(state, sample, config)
    if rupture_state is RuptureState.FRICTION_IDENTIFIED and ruptured is not None:
        return _identify(state, ruptured, sample.force_N, config)
    return state


def _open_layer(state: PublishedState, sample: Sample, config: PublishedConfig) -> PublishedState:
    """A rupture is detected: the next layer begins here and now (d_i of Section III).

    f(t_r) of (10) is the last force before the alarming sample, which may have dropped already.
    """
    memory = state.memory
    rupture = Rupture(
        layer=layers_traversed(state.layers) + 1,
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
    ruptured = RupturedLayer(state.start_depth_m, windows, memory.mean_speed_m_s, rupture)
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
        ruptured=ruptured,
        events=Events(rupture),
    )


def cusum_constants(sigma0_N: float, sigma1_N: float) -> tuple[float, float]:
    """Drift nu and threshold gamma [N^2] of the CUSUM on the squared error, equation (9)."""
    var0, var1 = sigma0_N * sigma0_N, sigma1_N * sigma1_N
    return (var1 + var0) / 2.0, (var1 - var0) / 2.0


def published_coefficients(state: PublishedState, config: PublishedConfig) -> PublishedCoefficients:
    """What follows from a state and seldom changes; beta grows at each detection."""
    count = layers_traversed(state.layers) + (state.ruptured is not None)
    drift, threshold = cusum_constants(config.sigma0_N, config.sigma1_N)
    return PublishedCoefficients(
        least_speed_m_s=config.least_speed_m_s,
        drift=drift,
        threshold=threshold,
        beta=config.derivative_threshold_N_per_s + count * config.derivative_rise_N_per_s,
        derivative_s=config.derivative_time_constant_s,
        reset_Hz=config.reset_frequency_Hz,
        is_ml=config.model == "ml",
        start_m=state.start_depth_m,
        is_inside=count > 0,
        layer=count + 1,
        cumulative_Ns_per_m=state.cumulative_friction_Ns_per_m,
        is_muted=state.rupture_state in MUTED,
        is_expected=state.rupture_state is RuptureState.EXPECTED,
        is_due=state.is_due,
    )
