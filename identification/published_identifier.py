"""The published method beyond `published_update`: windows, ruptures, layers."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from identification import published_update as at
from identification.estimate import (
    MUTED,
    LayerEstimate,
    Rupture,
    RuptureState,
    layers_left,
    next_rupture_state,
)
from identification.input_validation import Sample, packed
from identification.published_config import PublishedConfig
from identification.published_update import (
    PublishedUpdate,
    RlsState,
    is_window_full,
    reset_covariance,
)
from identification.rls_windows import (
    WindowHistory,
    WindowSums,
    append_window,
    joined,
    less_viscous_force,
    less_viscous_rows,
    rerun_history,
    window_step,
)

# Memory of the published method between two samples.


class LeftLayer(NamedTuple):
    """A layer just left, while its force drop is being measured.

    Attributes:
        start_depth_m: Depth at which it begins.
        windows: Sums of its reset windows.
        mean_speed_m_s: Average speed in it.
        rupture: How it ended.
    """

    start_depth_m: float
    windows: WindowHistory
    mean_speed_m_s: float
    rupture: Rupture


class FoundLayer(NamedTuple):
    """A layer identified whose friction is not subtracted yet.

    Attributes:
        layer: What was found.
        damping_Ns_per_m: Its share B_i d_i of the cumulative friction.
    """

    layer: LayerEstimate
    damping_Ns_per_m: float


class PublishedState(NamedTuple):
    """Immutable state of the published method.

    Attributes:
        tick: What every sample changes.
        start_depth_m: Depth at which the current layer begins.
        windows: Sums of its closed reset windows.
        left: The layer just left, until its friction is subtracted.
        rupture_state: State of the rupture machine.
        cumulative_friction_Ns_per_m: Sum of B_j d_j over compensated layers.
        layers: Layers identified so far.
        found: The layer just left once it is identified, until the next sample.
        rupture: Raised by this sample.
        compensated: The layer whose friction is subtracted from this sample on, if any.
    """

    tick: PublishedUpdate
    start_depth_m: float
    windows: WindowHistory = WindowHistory()
    left: LeftLayer | None = None
    rupture_state: RuptureState = RuptureState.NO_RUPTURE
    cumulative_friction_Ns_per_m: float = 0.0
    layers: tuple[LayerEstimate, ...] = ()
    found: FoundLayer | None = None
    rupture: Rupture | None = None
    compensated: LayerEstimate | None = None

    @property
    def events(self) -> tuple[Rupture | None, LayerEstimate | None, None]:
        """What the last three fields of an `Estimate` tell; this method withdraws nothing."""
        return self.rupture, self.compensated, None


# What a rupture tells about elastic and friction force, equations (10) and (11).


_SMALLEST_RATIO = 1e-3


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


# Re-weighting of the friction variance after a rupture, equation (12).


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


# After T_drop: force drop, re-weighting, re-run over the layer just left (Section III-B).


_LEAST_THICKNESS_M = 1e-9
_LEAST_SPEED_M_S = 1e-6
_MOST_LAYERS = 256


def identify_left(state: PublishedState, force_N: float, config: PublishedConfig) -> PublishedState:
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


def compensate(state: PublishedState, found: FoundLayer, config: PublishedConfig) -> PublishedState:
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


def initial_paper_state(config: PublishedConfig) -> PublishedState:
    """State before the first sample."""
    rls = RlsState(0.0, 0.0, float(config.var_stiffness), 0.0, float(config.var_friction))
    return PublishedState(PublishedUpdate(rls), config.contact_depth_m)


def begin_paper_sample(state: PublishedState, config: PublishedConfig) -> PublishedState:
    """Before a sample: events are over, and a layer found is now taken out of the force."""
    if state.found is not None:
        layer = state.found.layer
        return compensate(state, state.found, config)._replace(rupture=None, compensated=layer)
    if state.rupture is None and state.compensated is None:
        return state
    return state._replace(rupture=None, compensated=None)


def published_step(
    state: PublishedState, tick: PublishedUpdate, sample: Sample, config: PublishedConfig
) -> PublishedState:
    """What is left of a sample that `published_update` has absorbed.

    Covariance resetting, state machine; after T_drop the force drop (10)(11), re-weighting (12)
    and re-run of `published_compensation`.

    Args:
        state: Before the sample.
        tick: What `published_update` has made of the sample.
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


def _close_window(state: PublishedState, config: PublishedConfig) -> PublishedState:
    """Covariance resetting, and the sums of the reset window."""
    tick = state.tick
    rls = reset_covariance(tick.rls, config.var_stiffness, config.var_friction)
    return state._replace(
        tick=tick._replace(rls=rls, window=WindowSums(), window_s=0.0),
        windows=append_window(state.windows, tick.window, config.most_windows),
    )


def _machine(state: PublishedState, config: PublishedConfig) -> RuptureState:
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


def _open_layer(state: PublishedState, sample: Sample, config: PublishedConfig) -> PublishedState:
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


def published_layers(state: PublishedState) -> tuple[LayerEstimate, ...]:
    """The layers left; what follows does not change them."""
    return state.layers if state.found is None else (*state.layers, state.found.layer)


# Constants of the CUSUM on the squared prediction error, equation (9).


def cusum_constants(sigma0_N: float, sigma1_N: float) -> tuple[float, float]:
    """Drift nu and threshold gamma [N^2] of equation (9).

    Args:
        sigma0_N: Standard deviation of the error in the standard case.
        sigma1_N: Standard deviation of the error at an abrupt change.

    Returns:
        nu = (sigma1^2 + sigma0^2) / 2 and gamma = (sigma1^2 - sigma0^2) / 2.
    """
    var0, var1 = sigma0_N * sigma0_N, sigma1_N * sigma1_N
    return (var1 + var0) / 2.0, (var1 - var0) / 2.0


# What `published_update` reads until a layer ends or the rupture machine moves: worked out then.


class PublishedCoefficients(NamedTuple):
    """What follows from a state and seldom changes.

    Attributes:
        numbers: What `published_update` takes.
        rupture_state: Of the state that it was worked out from, as the next two.
        left: See `PublishedState`.
        layers: See `PublishedState`.
        is_due: Whether the next sample finds work to do.
    """

    numbers: Any
    rupture_state: RuptureState
    left: LeftLayer | None
    layers: tuple[LayerEstimate, ...]
    is_due: bool

    def holds(self, state: PublishedState) -> bool:
        """Whether it still says what holds of a state."""
        return (
            self.rupture_state is state.rupture_state
            and self.left is state.left
            and self.layers is state.layers
            and self.is_due == is_due(state)
        )


def is_due(state: PublishedState) -> bool:
    """Whether the next sample finds work to do: around a rupture, every one does."""
    is_quiet = state.rupture_state in (RuptureState.NO_RUPTURE, RuptureState.EXPECTED)
    return not is_quiet or state.found is not None or state.compensated is not None


def published_coefficients(state: PublishedState, config: PublishedConfig) -> PublishedCoefficients:
    """Work it out of a state; beta grows at each detection."""
    numbers = [0.0] * at.PLACES
    left = layers_left(state.layers) + (state.left is not None)
    rise = left * config.derivative_rise_N_per_s
    numbers[at.LEAST_SPEED] = config.least_speed_m_s
    numbers[at.DRIFT], numbers[at.THRESHOLD] = cusum_constants(config.sigma0_N, config.sigma1_N)
    numbers[at.BETA] = config.derivative_threshold_N_per_s + rise
    numbers[at.DERIVATIVE_S] = config.derivative_time_constant_s
    numbers[at.RESET_HZ] = config.reset_frequency_Hz
    numbers[at.IS_ML] = config.model == "ml"
    numbers[at.START_M] = state.start_depth_m
    numbers[at.IS_INSIDE] = left > 0
    numbers[at.LAYER] = left + 1
    numbers[at.CUMULATIVE] = state.cumulative_friction_Ns_per_m
    numbers[at.IS_MUTED] = state.rupture_state in MUTED
    numbers[at.IS_EXPECTED] = state.rupture_state is RuptureState.EXPECTED
    numbers[at.IS_DUE] = is_due(state)
    return PublishedCoefficients(
        packed(numbers), state.rupture_state, state.left, state.layers, is_due(state)
    )


# A line through weighted points, in closed form: three sums need no matrices.


class Line(NamedTuple):
    """Level at zero offset and slope, with their covariance.

    Attributes:
        level: Value at zero.
        slope: Growth per offset.
        level_var: Variance of the level.
        both: Covariance of the two.
        slope_var: Variance of the slope.
    """

    level: float
    slope: float
    level_var: float
    both: float
    slope_var: float


def fit_line(
    offset: NDArray[np.float64], value: NDArray[np.float64], weight: NDArray[np.float64]
) -> Line:
    """Weighted least squares.

    Args:
        offset: Shape (n,), at least two different ones.
        value: Shape (n,).
        weight: Inverse variances, shape (n,).
    """
    leaning = weight * offset
    s, x, y = float(weight.sum()), float(leaning.sum()), float(weight @ value)
    xx, xy = float(leaning @ offset), float(leaning @ value)
    determinant = s * xx - x * x
    return Line(
        level=(xx * y - x * xy) / determinant,
        slope=(s * xy - x * y) / determinant,
        level_var=xx / determinant,
        both=-x / determinant,
        slope_var=s / determinant,
    )
