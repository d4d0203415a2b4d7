"""The published method beyond `published_update`: ruptures and layers, equations (10) to (12)."""

from typing import Any, NamedTuple

import numpy as np

from identification.config import PublishedConfig
from identification.estimate import (
    Array,
    LayerEstimate,
    Rupture,
    RuptureState,
    Sample,
    layers_traversed,
)
from identification.published_update import (
    NO_SUMS,
    NO_WINDOWS,
    ROUNDING,
    Coefficients,
    Pair,
    PublishedMemory,
    append_window,
    less_viscous_windows,
    published_outputs,
    rerun_windows,
    update_published,
)

_MOST_LAYERS = 256
"""Layers kept: far more than a needle meets; the oldest go first."""
_SMALLEST_RATIO = 1e-3
_LEAST_THICKNESS_M = 1e-9
_LEAST_SPEED_M_S = 1e-6
_WATCHING = (RuptureState.NO_RUPTURE, RuptureState.EXPECTED)
"""States in which a new rupture is detected."""


class RupturedLayer(NamedTuple):
    """A layer that has ruptured, while its force drop is being measured."""

    start_depth_m: float  # Depth at which it begins
    windows: Array  # Sums of its reset windows
    mean_speed_m_s: float  # Average speed in it
    rupture: Rupture  # How it ended

    @property
    def damage(self) -> str:
        """What is wrong with a restored one, if anything; checked before compiled code reads it."""
        shape = np.shape(self.windows)
        return "" if shape[1:] == NO_WINDOWS.shape[1:] else f"its windows have the shape {shape}"


class PublishedState(NamedTuple):
    """All that the published method remembers; immutable."""

    memory: PublishedMemory  # What every sample changes
    start_depth_m: float  # Depth at which the current layer begins
    windows: Array = NO_WINDOWS  # Sums of its closed reset windows
    ruptured: RupturedLayer | None = None  # The last layer, until its friction is subtracted
    rupture_state: RuptureState = RuptureState.NO_RUPTURE  # State of the rupture machine
    cumulative_friction_Ns_per_m: float = 0.0  # Sum of B_j d_j over the layers subtracted
    layers: tuple[LayerEstimate, ...] = ()  # Layers identified so far


class PublishedMethod:
    """The published method, sample by sample."""

    takes_filtered_travel = False

    def __init__(self, config: PublishedConfig) -> None:
        self._config = config
        self.restore(PublishedState(_fresh_memory(config), float(config.contact_depth_m)))

    @property
    def state(self) -> PublishedState:
        """All that it remembers."""
        return self._state._replace(memory=PublishedMemory._make(self._memory))

    def restore(self, state: PublishedState) -> None:
        """Go on from there."""
        self._state, self._memory = state, state.memory[:]
        self._coefficients = published_coefficients(state, self._config)

    @property
    def layers(self) -> tuple[LayerEstimate, ...]:
        """The layers traversed; what follows does not change them."""
        return self._state.layers

    def report(self) -> tuple[Any, ...]:
        """What there is to report without a sample."""
        outputs = published_outputs(0.0, 0.0, 0.0, self._memory, self._coefficients)
        return (self._state.rupture_state, *outputs, None, None, None)

    def update(self, sample: Sample) -> tuple[Any, ...]:
        """Use one sample: what to report of it, from the rupture state to the events."""
        _, dt_s, depth_m, speed_m_s, _, _, force_N, *_ = sample
        is_all, memory, outputs = update_published(
            depth_m, speed_m_s, force_N, dt_s, self._memory, self._coefficients
        )
        if is_all:
            self._memory = memory
            return (self._state.rupture_state, *outputs, None, None, None)
        before, self._memory = self.state, memory
        state = published_step(self.state, sample, self._config)
        self.restore(state)
        ruptured = state.ruptured if before.ruptured is None else None
        rupture = None if ruptured is None else ruptured.rupture
        outputs = published_outputs(depth_m, speed_m_s, force_N, self._memory, self._coefficients)
        layer = None if state.layers is before.layers else state.layers[-1]
        return (state.rupture_state, *outputs, rupture, layer, None)


def _fresh_memory(config: PublishedConfig) -> PublishedMemory:
    return PublishedMemory((0.0, 0.0, float(config.var_stiffness), 0.0, float(config.var_friction)))


def cusum_constants(sigma0_N: float, sigma1_N: float) -> Pair:
    """Drift nu and threshold gamma [N^2] of the CUSUM on the squared error, equation (9)."""
    var0, var1 = sigma0_N * sigma0_N, sigma1_N * sigma1_N
    return (var1 + var0) / 2.0, (var1 - var0) / 2.0


def published_coefficients(state: PublishedState, config: PublishedConfig) -> Coefficients:
    """What `update_published` reads and a sample seldom changes; beta grows at each detection."""
    count = layers_traversed(state.layers) + (state.ruptured is not None)
    drift, threshold = cusum_constants(config.sigma0_N, config.sigma1_N)
    is_expected = state.rupture_state is RuptureState.EXPECTED
    return (
        float(config.least_speed_m_s),
        float(drift),
        float(threshold),
        float(config.derivative_threshold_N_per_s + count * config.derivative_rise_N_per_s),
        float(config.derivative_time_constant_s),
        float(config.reset_frequency_Hz),
        config.model == "ml",
        float(state.start_depth_m),
        count > 0,
        count + 1,
        float(state.cumulative_friction_Ns_per_m),
        state.rupture_state not in _WATCHING,
        is_expected,
    )


def published_step(
    state: PublishedState, sample: Sample, config: PublishedConfig
) -> PublishedState:
    """The rest of a sample that `update_published` has used.

    Covariance resetting, state machine; after T_drop = k_v / v force drop (10)(11), re-weighting
    (12) and re-run.
    """
    memory, ruptured, windows = state.memory, state.ruptured, state.windows
    if memory.window_s * config.reset_frequency_Hz >= 1.0 - ROUNDING:
        windows = append_window(windows, memory.window, config.most_windows)
        rls = (*memory.rls[:2], *_fresh_memory(config).rls[2:])
        memory = memory._replace(rls=rls, window=NO_SUMS, window_s=0.0)
    now, waited_s = state.rupture_state, memory.waited_s
    if now in _WATCHING:
        now = RuptureState.EXPECTED if memory.is_expected else RuptureState.NO_RUPTURE
        now = RuptureState.DETECTED if memory.is_alarm else now
    elif now is RuptureState.DETECTED:
        now = RuptureState.FORCE_DROP_MEASURING
    elif now is RuptureState.FRICTION_IDENTIFIED:
        is_settled = waited_s * config.reset_frequency_Hz >= 1.0
        now = RuptureState.NO_RUPTURE if is_settled else now
    elif ruptured is not None and waited_s >= config.drop_travel_m / ruptured.rupture.speed_m_s:
        now = RuptureState.FRICTION_IDENTIFIED
    state = state._replace(memory=memory, windows=windows, rupture_state=now)
    if now is RuptureState.DETECTED and ruptured is None:
        return _open_layer(state, sample, config)
    if now is RuptureState.FRICTION_IDENTIFIED and ruptured is not None:
        return _identify(state, ruptured, sample[6], config)
    return state


def _open_layer(state: PublishedState, sample: Sample, config: PublishedConfig) -> PublishedState:
    """A rupture is detected: the next layer begins here and now (d_i of Section III).

    f(t_r) of (10) is the last force before the alarming sample, which may have dropped already. So
    may those of its whole reset window: the layer's re-run is without it.
    """
    memory, (time_s, _, depth_m, speed_m_s, *_) = state.memory, sample
    rupture = Rupture(
        layer=layers_traversed(state.layers) + 1,
        alarm_s=time_s,
        alarm_depth_m=depth_m,
        time_s=time_s,
        depth_m=depth_m,
        force_N=memory.force_before_N,
        speed_m_s=speed_m_s,
        probability=1.0,
        is_final=True,
        contact_depth_m=float(config.contact_depth_m),
    )
    windows = state.windows
    if not len(windows):
        windows = append_window(windows, memory.window, config.most_windows)
    fresh = _fresh_memory(config)
    return state._replace(
        memory=memory._replace(
            rls=fresh.rls, window=NO_SUMS, **dict.fromkeys(_OF_A_LAYER, 0.0), is_alarm=False
        ),
        start_depth_m=depth_m,
        windows=NO_WINDOWS,
        ruptured=RupturedLayer(state.start_depth_m, windows, memory.mean_speed_m_s, rupture),
    )


_OF_A_LAYER = ("window_s", "travel_s", "mean_speed_m_s", "decision", "waited_s")


def force_ratios(
    drop_N: float, force_at_rupture_N: float, cumulative_friction_Ns_per_m: float, speed_m_s: float
) -> Pair:
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
    """Identify the layer that ruptured, (10) to (12), and take its friction out of the force.

    The sums of the layer after it are corrected for the friction now known, so its estimate goes
    on as if that friction had been subtracted from the rupture onwards.
    """
    rupture = ruptured.rupture
    drop = rupture.force_N - force_N  # (10): f(t_r) - f(t_r + T_drop)
    elastic, friction_ratio = force_ratios(
        drop, rupture.force_N, state.cumulative_friction_Ns_per_m, rupture.speed_m_s
    )
    speed = max(abs(ruptured.mean_speed_m_s), _LEAST_SPEED_M_S)
    variance = reweighted_friction_variance(config.var_friction, elastic, friction_ratio, speed)
    stiffness, friction = rerun_windows(
        ruptured.windows, (float(config.var_stiffness), float(variance))
    )
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
    windows = less_viscous_windows(np.vstack((state.windows, state.memory.window)), damping)
    variances = _fresh_memory(config).rls[2:]
    rls = (*rerun_windows(windows, (variances[0], variances[2])), *variances)
    window: Any = tuple(windows[-1].tolist())
    return state._replace(
        memory=state.memory._replace(rls=rls, window=window, waited_s=0.0),
        windows=windows[:-1],
        cumulative_friction_Ns_per_m=state.cumulative_friction_Ns_per_m + damping,
        ruptured=None,
        layers=(*state.layers, layer)[-_MOST_LAYERS:],
    )
