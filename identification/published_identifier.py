"""The published method: equations (2), (3) and (7) to (12), sample by sample.

A window between two covariance resets maps the estimate linearly, theta_k = A_k theta_{k-1} + c_k:
RLS with lambda = 1 is a regularised least squares, theta = (Psi_0^-1 + S)^-1 (Psi_0^-1 theta_prev +
b) with S = sum phi phi' and b = sum phi f. A re-run over a layer (Section III-B) needs S and b of
each window, not its samples.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from identification.config import PublishedConfig
from identification.estimate import Array, LayerEstimate, Rupture, RuptureState, Sample
from needleforce.jit import Matrix, compiled

_ROUNDING = 1e-9
_MOST_LAYERS = 256
"""Layers kept: far more than a needle meets; the oldest go first."""
_SMALLEST_RATIO = 1e-3
_LEAST_THICKNESS_M = 1e-9
_LEAST_SPEED_M_S = 1e-6
_WATCHING = (RuptureState.NO_RUPTURE, RuptureState.EXPECTED)
"""States in which a new rupture is detected."""

Pair = tuple[float, float]
Rls = tuple[float, float, float, float, float]
"""Estimate K, B and covariance Psi[0, 0], Psi[0, 1], Psi[1, 1] of a two-parameter RLS."""
Sums = tuple[float, float, float, float, float, float, float]
"""Over the samples between two covariance resets: phi_K^2, phi_K phi_B, phi_B^2, phi_K f, phi_B f;
and phi_K v, phi_B v, which with `kv` allow a later change of the cumulative friction."""
NO_SUMS: Sums = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
_KF, _BF, _KV, _BV = 3, 4, 5, 6
NO_WINDOWS = np.empty((0, len(NO_SUMS)))
"""Sums of the windows of a layer, one row of `Sums` each."""
NO_WINDOWS.setflags(write=False)
_SLACK = 16
"""Windows beyond the most before neighbours are added up: not at every window."""


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


class Tracker(NamedTuple):
    """What every sample changes."""

    rls: Rls  # Current estimate and covariance
    window: Sums = NO_SUMS  # Since the last covariance reset
    window_s: float = 0.0  # Time since then
    travel_s: float = 0.0  # Time spent in the layer the tip is in
    mean_speed_m_s: float = 0.0  # Average speed in it
    decision: float = 0.0  # g_k of equation (9)
    derivative_N_per_s: float = 0.0  # Filtered force derivative
    force_N: float = math.nan  # Last force; nan before the first sample
    force_before_N: float = math.nan  # The one before, or the last if there is none
    waited_s: float = 0.0  # Time since the detection
    predicted_N: float = 0.0  # phi' theta + B_d v before the last sample was used

    @property
    def damage(self) -> str:
        """What is wrong with the covariance, if anything."""
        *_, first, both, second = self.rls
        is_definite = min(first, second) >= 0.0 and both * both <= 1.002 * first * second
        return "" if is_definite else "its covariance is not positive semi-definite"


class PublishedState(NamedTuple):
    """All that the published method remembers; immutable."""

    tracker: Tracker
    start_depth_m: float  # Depth at which the current layer begins
    windows: Array = NO_WINDOWS  # Sums of its closed reset windows
    ruptured: RupturedLayer | None = None  # The last layer, until its friction is subtracted
    rupture_state: RuptureState = RuptureState.NO_RUPTURE  # State of the rupture machine
    cumulative_friction_Ns_per_m: float = 0.0  # Sum of B_j d_j over the layers subtracted
    layers: tuple[LayerEstimate, ...] = ()  # Layers identified so far
    ruptures: int = 0  # Detected so far


class PublishedMethod:
    """The published method, sample by sample."""

    takes_filtered_travel = False

    def __init__(self, config: PublishedConfig) -> None:
        self._config = config
        self.state = PublishedState(Tracker(_fresh_rls(config)), float(config.contact_depth_m))

    def restore(self, state: PublishedState) -> None:
        """Go on from there."""
        self.state = state

    @property
    def layers(self) -> tuple[LayerEstimate, ...]:
        """The layers traversed; what follows does not change them."""
        return self.state.layers

    def report(self) -> tuple[Any, ...]:
        """What there is to report without a sample."""
        return (self.state.rupture_state, *self._outputs(0.0, 0.0, 0.0), None, None, None)

    def update(self, sample: Sample) -> tuple[Any, ...]:
        """Use one sample: what to report of it, from the rupture state to the events."""
        _, _, depth_m, speed_m_s, _, _, force_N, *_ = sample
        before, self.state = self.state, published_step(self.state, sample, self._config)
        ruptured = self.state.ruptured if before.ruptured is None else None
        rupture = None if ruptured is None else ruptured.rupture
        layer = None if self.state.layers is before.layers else self.state.layers[-1]
        outputs = self._outputs(depth_m, speed_m_s, force_N)
        return (self.state.rupture_state, *outputs, rupture, layer, None)

    def _outputs(self, depth_m: float, speed_m_s: float, force_N: float) -> tuple[Any, ...]:
        """Enhanced force f - sum(B_j d_j) v and its companions."""
        state = self.state
        stiffness, friction, *_ = state.tracker.rls
        cumulative = state.cumulative_friction_Ns_per_m
        depth = max(depth_m - state.start_depth_m, 0.0)
        in_contact = depth > 0.0 or state.ruptures > 0
        phi = _regressor(depth, speed_m_s, self._config)
        earlier = cumulative * speed_m_s
        own = friction * phi[1] if in_contact else 0.0
        tip = force_N - earlier - own
        forces = (force_N - earlier, None, tip, None, earlier + own, None)
        found = (stiffness, None, False, friction, None, False, cumulative, None)
        layer = state.ruptures + 1 if in_contact else 0
        return (in_contact, layer, *forces, state.tracker.predicted_N, *found)


def _fresh_rls(config: PublishedConfig) -> Rls:
    return 0.0, 0.0, float(config.var_stiffness), 0.0, float(config.var_friction)


def _regressor(layer_depth_m: float, speed_m_s: float, config: PublishedConfig) -> Pair:
    """Columns (phi_K, phi_B): (dz, dz v) for `ml`, equation (3); (dz, v) for `kv`, (2)."""
    return layer_depth_m, (layer_depth_m * speed_m_s if config.model == "ml" else speed_m_s)


def rls_step(rls: Rls, phi: Pair, force_N: float) -> tuple[Rls, float]:
    """Use one force sample: equations (7) and (8) with lambda = 1, written out for two columns.

    Returns:
        The estimate after the sample, and the error e_k = f_k - phi_k' theta_{k-1}.
    """
    k, b, p11, p12, p22 = rls
    x, y = phi
    error = force_N - (x * k + y * b)
    gx = p11 * x + p12 * y
    gy = p12 * x + p22 * y
    scale = 1.0 + x * gx + y * gy
    step = error / scale
    p11, p12, p22 = p11 - gx * gx / scale, p12 - gx * gy / scale, p22 - gy * gy / scale
    return (k + gx * step, b + gy * step, p11, p12, p22), error


def add_sample(sums: Sums, phi: Pair, force_N: float, speed_m_s: float) -> Sums:
    """Add one sample to the sums of its window."""
    kk, kb, bb, kf, bf, kv, bv = sums
    x, y = phi
    kf, bf, kv, bv = kf + x * force_N, bf + y * force_N, kv + x * speed_m_s, bv + y * speed_m_s
    return kk + x * x, kb + x * y, bb + y * y, kf, bf, kv, bv


def cusum_constants(sigma0_N: float, sigma1_N: float) -> Pair:
    """Drift nu and threshold gamma [N^2] of the CUSUM on the squared error, equation (9)."""
    var0, var1 = sigma0_N * sigma0_N, sigma1_N * sigma1_N
    return (var1 + var0) / 2.0, (var1 - var0) / 2.0


def cusum_step(decision: float, error_N: float, drift: float) -> float:
    """Decision function g_k = max(g_{k-1} + e_k^2 - nu, 0), equation (9)."""
    return max(decision + error_N * error_N - drift, 0.0)


def derivative_step(
    derivative_N_per_s: float, change_N: float, dt_s: float, time_constant_s: float
) -> float:
    """First-order low-pass of df/dt (Section III-B); exact for a force linear over the step."""
    keep = math.exp(-dt_s / time_constant_s)
    return keep * derivative_N_per_s + (1.0 - keep) * change_N / dt_s


def published_step(
    state: PublishedState, sample: Sample, config: PublishedConfig
) -> PublishedState:
    """Use one sample: RLS (7)(8), CUSUM (9), the derivative criterion, the state machine.

    After T_drop = k_v / v force drop (10)(11), re-weighting (12) and re-run.
    """
    _, _, depth_m, speed_m_s, _, _, force_N, *_ = sample
    last = state.tracker
    before = force_N if math.isnan(last.force_N) else last.force_N
    if depth_m <= state.start_depth_m and not state.ruptures:
        last = last._replace(force_N=force_N, force_before_N=before, predicted_N=0.0)
        return state._replace(tracker=last)
    is_watching = state.rupture_state in _WATCHING and speed_m_s >= config.least_speed_m_s
    now = _track(state, sample, before, is_watching, config)
    windows = state.windows
    if now.window_s * config.reset_frequency_Hz >= 1.0 - _ROUNDING:
        windows = append_window(windows, now.window, config.most_windows)
        rls = (*now.rls[:2], *_fresh_rls(config)[2:])
        now = now._replace(rls=rls, window=NO_SUMS, window_s=0.0)
    at = _next_state(state, now, is_watching, config)
    state = state._replace(tracker=now, windows=windows, rupture_state=at)
    if at is RuptureState.DETECTED and state.ruptured is None:
        return _open_layer(state, sample, config)
    if at is RuptureState.FRICTION_IDENTIFIED and state.ruptured is not None:
        return _identify(state, state.ruptured, force_N, config)
    return state


def _track(
    state: PublishedState,
    sample: Sample,
    before_N: float,
    is_watching: bool,
    config: PublishedConfig,
) -> Tracker:
    last, (_, dt_s, depth_m, speed_m_s, _, _, force_N, *_) = state.tracker, sample
    phi = _regressor(max(depth_m - state.start_depth_m, 0.0), speed_m_s, config)
    earlier = state.cumulative_friction_Ns_per_m * speed_m_s
    own = force_N - earlier
    rls, error = rls_step(last.rls, phi, own)
    drift, _ = cusum_constants(config.sigma0_N, config.sigma1_N)
    travel_s = last.travel_s + dt_s
    return Tracker(
        rls=rls,
        window=add_sample(last.window, phi, own, speed_m_s),
        window_s=last.window_s + dt_s,
        travel_s=travel_s,
        mean_speed_m_s=last.mean_speed_m_s + (speed_m_s - last.mean_speed_m_s) * dt_s / travel_s,
        decision=cusum_step(last.decision, error, drift) if is_watching else 0.0,
        derivative_N_per_s=derivative_step(
            last.derivative_N_per_s, force_N - before_N, dt_s, config.derivative_time_constant_s
        ),
        force_N=force_N,
        force_before_N=before_N,
        waited_s=last.waited_s + dt_s,
        predicted_N=own - error + earlier,
    )


def _next_state(
    state: PublishedState, now: Tracker, is_watching: bool, config: PublishedConfig
) -> RuptureState:
    at, ruptured = state.rupture_state, state.ruptured
    if at in _WATCHING:
        _, threshold = cusum_constants(config.sigma0_N, config.sigma1_N)
        beta = config.derivative_threshold_N_per_s + state.ruptures * config.derivative_rise_N_per_s
        is_expected = is_watching and now.derivative_N_per_s < -beta
        at = RuptureState.EXPECTED if is_expected else RuptureState.NO_RUPTURE
        return RuptureState.DETECTED if now.decision > threshold else at
    if at is RuptureState.DETECTED:
        return RuptureState.FORCE_DROP_MEASURING
    if at is RuptureState.FRICTION_IDENTIFIED:
        is_settled = now.waited_s * config.reset_frequency_Hz >= 1.0
        return RuptureState.NO_RUPTURE if is_settled else at
    if ruptured is not None and now.waited_s >= config.drop_travel_m / ruptured.rupture.speed_m_s:
        return RuptureState.FRICTION_IDENTIFIED
    return at


def _open_layer(state: PublishedState, sample: Sample, config: PublishedConfig) -> PublishedState:
    """A rupture is detected: the next layer begins here and now (d_i of Section III).

    f(t_r) of (10) is the last force before the alarming sample, which may have dropped already. So
    may those of its whole reset window: the layer's re-run is without it.
    """
    tracker, (time_s, _, depth_m, speed_m_s, *_) = state.tracker, sample
    rupture = Rupture(
        layer=state.ruptures + 1,
        alarm_s=time_s,
        alarm_depth_m=depth_m,
        time_s=time_s,
        depth_m=depth_m,
        force_N=tracker.force_before_N,
        speed_m_s=speed_m_s,
        probability=1.0,
        is_final=True,
        contact_depth_m=float(config.contact_depth_m),
    )
    windows = state.windows
    if not len(windows):
        windows = append_window(windows, tracker.window, config.most_windows)
    fresh = Tracker(
        rls=_fresh_rls(config),
        derivative_N_per_s=tracker.derivative_N_per_s,
        force_N=tracker.force_N,
        force_before_N=tracker.force_before_N,
        predicted_N=tracker.predicted_N,
    )
    ruptured = RupturedLayer(state.start_depth_m, windows, tracker.mean_speed_m_s, rupture)
    return state._replace(
        tracker=fresh,
        start_depth_m=depth_m,
        windows=NO_WINDOWS,
        ruptured=ruptured,
        ruptures=rupture.layer,
    )


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
    windows = less_viscous_windows(np.vstack((state.windows, state.tracker.window)), damping)
    variances = _fresh_rls(config)[2:]
    rls = (*rerun_windows(windows, (variances[0], variances[2])), *variances)
    window: Any = tuple(windows[-1].tolist())
    return state._replace(
        tracker=state.tracker._replace(rls=rls, window=window, waited_s=0.0),
        windows=windows[:-1],
        cumulative_friction_Ns_per_m=state.cumulative_friction_Ns_per_m + damping,
        ruptured=None,
        layers=(*state.layers, layer)[-_MOST_LAYERS:],
    )


# The re-run over a layer.


def append_window(windows: Array, sums: Sums, most: int) -> Array:
    """Add a closed window; beyond ``most`` neighbours are added up.

    That halves their number and bounds memory in an endless layer: the re-run then resets half as
    often over that stretch. An odd last window stays alone.
    """
    grown = np.vstack((windows, sums))
    if len(grown) >= most + _SLACK:
        even = len(grown) // 2 * 2
        grown = np.concatenate((grown[0:even:2] + grown[1:even:2], grown[even:]))
    grown.setflags(write=False)
    return grown


def less_viscous_windows(windows: Array, damping_Ns_per_m: float) -> Array:
    """Windows as if ``damping_Ns_per_m * v`` had been subtracted from every force sample."""
    corrected = windows.copy()
    corrected[:, _KF] -= damping_Ns_per_m * windows[:, _KV]
    corrected[:, _BF] -= damping_Ns_per_m * windows[:, _BV]
    corrected.setflags(write=False)
    return corrected


@compiled
def rerun_windows(windows: Matrix, variances: Pair) -> Pair:
    """The estimate after all windows, as by a re-run from zero over their samples up to rounding.

    Each window begins with covariance diag(variances). Its map is written without an inverse of
    that or of S, so collinear columns and zero variances are harmless:
    theta + Psi_0 (I + S Psi_0)^-1 (b - S theta).
    """
    k = b = 0.0
    p, q = variances
    for i in range(len(windows)):
        kk, kb, bb = windows[i, 0], windows[i, 1], windows[i, 2]
        kf, bf = windows[i, 3], windows[i, 4]
        pb, qb = p * kb, q * kb
        first, second = 1.0 + q * bb, 1.0 + p * kk
        excitation = max(kk * bb - kb * kb, 0.0)
        scale = 1.0 / (second + q * bb + (p * q) * excitation)
        own_k, own_b = p * (first * kf - qb * bf) * scale, q * (second * bf - pb * kf) * scale
        k, b = (
            own_k + first * scale * k - pb * scale * b,
            own_b - qb * scale * k + second * scale * b,
        )
    return float(k), float(b)
