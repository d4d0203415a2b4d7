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
from identification.estimate import Array, LayerEstimate, Outputs, Rupture, RuptureState, Sample
from needleforce.jit import Matrix, Vector, WrittenVector, compiled, working_copy

_FULL = 1.0 - 1e-9  # length of a reset window in periods, but for rounding
_MOST_LAYERS = 256  # layers kept: far more than a needle meets; the oldest go first
_SMALLEST_RATIO = 1e-3
_LEAST_THICKNESS_M = 1e-9
_LEAST_SPEED_M_S = 1e-6
_STATES = tuple(RuptureState)  # a new rupture is detected in the first two
_NO_RUPTURE, _EXPECTED, _DETECTED, _MEASURING, _IDENTIFIED = range(5)

Motion = tuple[float, float, float, float]  # interval, depth, speed, force
Pair = tuple[float, float]
Rls = tuple[float, float, float, float, float]  # K, B, covariance Psi[0, 0], Psi[0, 1], Psi[1, 1]
Sums = tuple[float, float, float, float, float, float, float]
"""Over the samples between two covariance resets: phi_K^2, phi_K phi_B, phi_B^2, phi_K f, phi_B f;
and phi_K v, phi_B v, which with `kv` allow a later change of the cumulative friction."""
NO_SUMS: Sums = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
_OF_FORCE, _OF_SPEED = slice(3, 5), slice(5, 7)
# Places in the memory: the numbers of a `Tracker`, in its order.
_RLS, _WINDOW, _WINDOW_S, _TRAVEL_S, _MEAN_SPEED, _DECISION = 0, 5, 12, 13, 14, 15
_DERIVATIVE, _FORCE, _FORCE_BEFORE, _WAITED_S, _PREDICTED = range(16, 21)
Setting = tuple[bool, float, float, float, float, float, float, float, float, float, int, int]
"""What holds for many samples: whether `ml`; drift and threshold of (9), reset frequency, time
constant and least speed; start of the layer, cumulative friction, threshold beta of the derivative,
T_drop; ruptures so far, number of the rupture machine's state."""
NO_WINDOWS = np.empty((0, len(NO_SUMS)))  # sums of the windows of a layer, one row of `Sums` each
NO_WINDOWS.setflags(write=False)
_SLACK = 16  # windows beyond the most before neighbours are added up: not at every window


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
        self.restore(PublishedState(Tracker(_fresh_rls(config)), float(config.contact_depth_m)))

    @property
    def state(self) -> PublishedState:
        """All that it remembers."""
        numbers: Any = np.array(self._memory).tolist()
        rls, window = tuple(numbers[:_WINDOW]), tuple(numbers[_WINDOW:_WINDOW_S])
        return self._state._replace(tracker=Tracker(rls, window, *numbers[_WINDOW_S:]))

    def restore(self, state: PublishedState) -> None:
        """Go on from there."""
        config, ruptured, (rls, window, *numbers) = self._config, state.ruptured, state.tracker
        self._state, self._memory = state, working_copy(np.array((*rls, *window, *numbers)))
        beta = config.derivative_threshold_N_per_s + state.ruptures * config.derivative_rise_N_per_s
        speed = math.inf if ruptured is None else ruptured.rupture.speed_m_s
        drop_s = config.drop_travel_m / max(speed, config.least_speed_m_s)
        cusum = cusum_constants(config.sigma0_N, config.sigma1_N)
        rates = config.reset_frequency_Hz, config.derivative_time_constant_s, config.least_speed_m_s
        layer = state.start_depth_m, state.cumulative_friction_Ns_per_m, beta, drop_s
        counts = state.ruptures, _STATES.index(state.rupture_state)
        self._now: Any = config.model == "ml", *map(float, (*cusum, *rates, *layer)), *counts

    @property
    def layers(self) -> tuple[LayerEstimate, ...]:
        """The layers traversed; what follows does not change them."""
        return self._state.layers

    def report(self, motion: Motion = (0.0, 0.0, 0.0, 0.0), *events: Any) -> tuple[Any, ...]:
        """What there is to report without a sample, or of the last one."""
        outputs = published_outputs(motion, self._memory, self._now)
        return (self._state.rupture_state, *outputs, *(events or (None, None)), None)

    def update(self, sample: Sample) -> tuple[Any, ...]:
        """Use one sample: what to report of it, from the rupture state to the events."""
        motion = sample[1], sample[2], sample[3], sample[6]
        at, is_full, outputs = published_step(motion, self._memory, self._now)
        if not is_full and at == self._now[-1]:
            return (_STATES[at], *outputs, None, None, None)
        before, state = self._state, self.state._replace(rupture_state=_STATES[at])
        state = _next(state, sample, self._config, is_full)
        self.restore(state)
        ruptured = state.ruptured if before.ruptured is None else None
        rupture = None if ruptured is None else ruptured.rupture
        layer = None if state.layers is before.layers else state.layers[-1]
        return self.report(motion, rupture, layer)


def _fresh_rls(config: PublishedConfig) -> Rls:
    return 0.0, 0.0, float(config.var_stiffness), 0.0, float(config.var_friction)


@compiled
def _regressor(layer_depth_m: float, speed_m_s: float, is_ml: bool) -> Pair:
    """Columns (phi_K, phi_B): (dz, dz v) for `ml`, equation (3); (dz, v) for `kv`, (2)."""
    return layer_depth_m, (layer_depth_m * speed_m_s if is_ml else speed_m_s)


@compiled
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


@compiled
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


@compiled
def cusum_step(decision: float, error_N: float, drift: float) -> float:
    """Decision function g_k = max(g_{k-1} + e_k^2 - nu, 0), equation (9)."""
    return max(decision + error_N * error_N - drift, 0.0)


@compiled
def derivative_step(
    derivative_N_per_s: float, change_N: float, dt_s: float, time_constant_s: float
) -> float:
    """First-order low-pass of df/dt (Section III-B); exact for a force linear over the step."""
    keep = math.exp(-dt_s / time_constant_s)
    return keep * derivative_N_per_s + (1.0 - keep) * change_N / dt_s


@compiled
def published_outputs(motion: Motion, memory: Vector, now: Setting) -> Outputs:
    """Enhanced force f - sum(B_j d_j) v and its companions, from ``in_contact`` to the events."""
    (_, depth_m, speed_m_s, force_N), (start_m, cumulative), ruptures = motion, now[6:8], now[10]
    depth, friction = max(depth_m - start_m, 0.0), memory[_RLS + 1]
    in_contact = depth > 0.0 or ruptures > 0
    earlier = cumulative * speed_m_s
    own = friction * _regressor(depth, speed_m_s, now[0])[1] if in_contact else 0.0
    enhanced, number = force_N - earlier, ruptures + 1 if in_contact else 0
    forces = (enhanced, None, enhanced - own, None, earlier + own, None, memory[_PREDICTED])
    found = (memory[_RLS], None, False, friction, None, False, cumulative, None)
    # Numba knows no starred parts of a tuple.
    return (in_contact, number) + forces + found  # noqa: RUF005


@compiled
def _next_state(memory: Vector, now: Setting, is_watching: bool) -> int:
    """Number of the rupture machine's state after a sample."""
    _, _, threshold, reset_Hz, _, _, _, _, beta, drop_s, _, at = now
    if at <= _EXPECTED:
        if memory[_DECISION] > threshold:
            return _DETECTED
        return _EXPECTED if is_watching and memory[_DERIVATIVE] < -beta else _NO_RUPTURE
    if at == _DETECTED:
        return _MEASURING
    if at == _IDENTIFIED:
        return _NO_RUPTURE if memory[_WAITED_S] * reset_Hz >= 1.0 else at
    return _IDENTIFIED if memory[_WAITED_S] >= drop_s else at


@compiled
def published_step(motion: Motion, m: WrittenVector, now: Setting) -> tuple[int, bool, Outputs]:
    """Use one sample: RLS (7)(8), CUSUM (9), the derivative criterion, the state machine.

    Returns:
        Number of the rupture machine's state, whether the reset window is full, and what to report
        if neither is news.
    """
    dt_s, depth_m, speed_m_s, force_N = motion
    is_ml, drift, _, reset_Hz, constant_s, least_m_s, start_m, cumulative, _, _, ruptures, at = now
    before_N = force_N if math.isnan(m[_FORCE]) else m[_FORCE]
    m[_FORCE], m[_FORCE_BEFORE] = force_N, before_N
    if depth_m <= start_m and ruptures == 0:
        m[_PREDICTED] = 0.0
        return at, False, published_outputs(motion, m, now)
    is_watching = at <= _EXPECTED and speed_m_s >= least_m_s
    phi = _regressor(max(depth_m - start_m, 0.0), speed_m_s, is_ml)
    earlier = cumulative * speed_m_s
    own = force_N - earlier
    rls, error = rls_step((m[0], m[1], m[2], m[3], m[4]), phi, own)
    m[0], m[1], m[2], m[3], m[4] = rls
    sums = add_sample((m[5], m[6], m[7], m[8], m[9], m[10], m[11]), phi, own, speed_m_s)
    m[5], m[6], m[7], m[8], m[9], m[10], m[11] = sums
    for k in (_WINDOW_S, _TRAVEL_S, _WAITED_S):
        m[k] += dt_s
    m[_MEAN_SPEED] += (speed_m_s - m[_MEAN_SPEED]) * dt_s / m[_TRAVEL_S]
    m[_DECISION] = cusum_step(m[_DECISION], error, drift) if is_watching else 0.0
    m[_DERIVATIVE] = derivative_step(m[_DERIVATIVE], force_N - before_N, dt_s, constant_s)
    m[_PREDICTED] = own - error + earlier
    at, is_full = _next_state(m, now, is_watching), m[_WINDOW_S] * reset_Hz >= _FULL
    return at, is_full, published_outputs(motion, m, now)


def _next(
    state: PublishedState, sample: Sample, config: PublishedConfig, is_full: bool
) -> PublishedState:
    """A window or a layer ends; after T_drop = k_v / v force drop (10)(11), (12) and re-run."""
    at, ruptured, now = state.rupture_state, state.ruptured, state.tracker
    if is_full:
        windows = append_window(state.windows, now.window, config.most_windows)
        now = now._replace(rls=now.rls[:2] + _fresh_rls(config)[2:], window=NO_SUMS, window_s=0.0)
        state = state._replace(tracker=now, windows=windows)
    if at is RuptureState.DETECTED and ruptured is None:
        return _open_layer(state, sample, config)
    if at is RuptureState.FRICTION_IDENTIFIED and ruptured is not None:
        return _identify(state, ruptured, sample[6], config)
    return state


def _open_layer(state: PublishedState, sample: Sample, config: PublishedConfig) -> PublishedState:
    """A rupture is detected: the next layer begins here and now (d_i of Section III).

    f(t_r) of (10) is the last force before the alarming sample, which may have dropped already. So
    may those of its whole reset window: the layer's re-run is without it.
    """
    (*_, derivative, force_N, before_N, _, predicted_N) = tracker = state.tracker
    time_s, _, depth_m, speed_m_s, *_ = sample
    rupture = Rupture(
        layer=state.ruptures + 1,
        alarm_s=time_s,
        alarm_depth_m=depth_m,
        time_s=time_s,
        depth_m=depth_m,
        force_N=before_N,
        speed_m_s=speed_m_s,
        probability=1.0,
        is_final=True,
        contact_depth_m=float(config.contact_depth_m),
    )
    first = append_window(NO_WINDOWS, tracker.window, config.most_windows)
    windows = state.windows if len(state.windows) else first
    goes_on = derivative, force_N, before_N, 0.0, predicted_N
    fresh = Tracker(_fresh_rls(config), NO_SUMS, 0.0, 0.0, 0.0, 0.0, *goes_on)
    ruptured = RupturedLayer(state.start_depth_m, windows, tracker.mean_speed_m_s, rupture)
    state = state._replace(ruptured=ruptured, ruptures=rupture.layer, start_depth_m=depth_m)
    return state._replace(tracker=fresh, windows=NO_WINDOWS)


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
    known = state.cumulative_friction_Ns_per_m
    elastic, friction_ratio = force_ratios(drop, rupture.force_N, known, rupture.speed_m_s)
    speed = max(abs(ruptured.mean_speed_m_s), _LEAST_SPEED_M_S)
    variance = reweighted_friction_variance(config.var_friction, elastic, friction_ratio, speed)
    variances = float(config.var_stiffness), float(variance)
    stiffness, friction = rerun_windows(ruptured.windows, variances)
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
    windows = np.vstack((state.windows, state.tracker.window))
    windows[:, _OF_FORCE] -= damping * windows[:, _OF_SPEED]  # as if its friction were not felt
    windows.setflags(write=False)
    fresh = _fresh_rls(config)[2:]
    rls = (*rerun_windows(windows, (fresh[0], fresh[2])), *fresh)
    window: Any = tuple(windows[-1].tolist())
    return state._replace(
        tracker=state.tracker._replace(rls=rls, window=window, waited_s=0.0),
        windows=windows[:-1],
        cumulative_friction_Ns_per_m=known + damping,
        ruptured=None,
        layers=(*state.layers, layer)[-_MOST_LAYERS:],
    )


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
        k_before, k = k, own_k + first * scale * k - pb * scale * b
        b = own_b - qb * scale * k_before + second * scale * b
    return float(k), float(b)
