"""The published method: equations (2), (3) and (7) to (12), sample by sample.

A window between two covariance resets maps the estimate linearly, theta_k = A_k
theta_{k-1} + c_k: RLS with lambda = 1 is a regularised least squares, theta = (Psi_0^-1
+ S)^-1 (Psi_0^-1 theta_prev + b) with S = sum phi phi' and b = sum phi f. A re-run over
a layer (Section III-B) needs S and b of each window, not its samples.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from foundation.arrays import Matrix, Vector, WrittenVector
from foundation.jit import compiled
from identification.config import PublishedConfig
from identification.estimate import (
    Array,
    LayerEstimate,
    Outputs,
    Rupture,
    RuptureState,
    Sample,
)

_FULL = 1.0 - 1e-9  # length of a reset window in periods, but for rounding
_MOST_LAYERS = 256  # layers kept: far more than a needle meets; the oldest go first
_SMALLEST_RATIO = 1e-3
_LEAST_THICKNESS_M = 1e-9
_LEAST_SPEED_M_S = 1e-6
_STATES = tuple(RuptureState)  # a new rupture is detected in the first two
_NO_RUPTURE, _EXPECTED, _DETECTED, _MEASURING, _IDENTIFIED = range(5)

Motion = tuple[float, float, float, float]  # interval, depth, speed, force
Pair = tuple[float, float]
Rls = tuple[
    float, float, float, float, float
]  # K, B, covariance Psi[0, 0], Psi[0, 1], Psi[1, 1]
Sums = tuple[float, float, float, float, float, float, float]
"""Over the samples between two covariance resets: phi_K^2, phi_K phi_B, phi_B^2, phi_K
f, phi_B f; and phi_K v, phi_B v, which with `kv` allow a later change of the cumulative
friction."""
NO_SUMS: Sums = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
_OF_FORCE = slice(3, 5)
_OF_SPEED = slice(5, 7)
Setting = tuple[bool, float, float, float, float, float]
"""Whether `ml`; drift and threshold of (9), reset frequency, time constant and least
speed."""
# Places in the memory. What the samples change: an `Rls`; the `Sums` since the last
# covariance reset and the time since; g_k of (9); time and mean speed in the layer;
# filtered derivative; the last force, whether there is one, the one before; time since
# the detection; phi' theta + B_d v before the last sample was used.
_RLS = 0
_COVARIANCE = 2
_SUMS = 5
_WINDOW_S = 12
_DECISION = 13
_TRAVEL_S = 14
_MEAN_SPEED = 15
_DERIVATIVE, _FORCE, _HAS_FORCE, _FORCE_BEFORE, _WAITED_S, _PREDICTED = range(16, 22)
# What a rupture changes: start of the layer, sum of B_j d_j, threshold beta of the
# derivative, T_drop, ruptures detected; number of the rupture machine's state.
_START_M, _CUMULATIVE, _BETA, _DROP_S, _RUPTURES, _STATE, _SIZE = range(22, 29)
NO_WINDOWS = np.empty(
    (0, len(NO_SUMS))
)  # sums of the windows of a layer, one row of `Sums` each
NO_WINDOWS.setflags(write=False)


class RupturedLayer(NamedTuple):
    """A layer that has ruptured, while its force drop is being measured.

    Attributes:
        start_depth_m: Depth at which it begins.
        windows: Sums of its reset windows.
        mean_speed_m_s: Average speed in it.
        rupture: How it ended.
    """

    start_depth_m: float
    windows: Array
    mean_speed_m_s: float
    rupture: Rupture

    @property
    def damage(self) -> str:
        """What is wrong with a restored one, if anything; checked before compiled
        code reads it.
        """
        shape = np.shape(self.windows)
        return (
            ""
            if shape[1:] == NO_WINDOWS.shape[1:]
            else f"its windows have the shape {shape}"
        )


class PublishedState(NamedTuple):
    """All that the published method remembers; immutable.

    Attributes:
        memory: What every sample changes, shape (28,).
        windows: Sums of the closed reset windows of the current layer.
        layers: Layers identified so far.
    """

    memory: Array
    windows: Array = NO_WINDOWS
    ruptured: RupturedLayer | None = (
        None  # The last layer, until its friction is subtracted
    )
    layers: tuple[LayerEstimate, ...] = ()

    @property
    def damage(self) -> str:
        """What is wrong with the covariance, if anything."""
        first, both, second = np.ravel(self.memory)[_COVARIANCE:_SUMS].tolist()
        is_definite = (
            min(first, second) >= 0.0 and both * both <= 1.002 * first * second
        )
        return (
            ""
            if is_definite
            else "the covariance in its memory is not positive semi-definite"
        )


class PublishedMethod:
    """The published method, sample by sample."""

    takes_filtered_travel = False
    contact_depth_m = None  # a setting, nothing that is found

    def __init__(self, config: PublishedConfig) -> None:
        self._config = config
        cusum = cusum_constants(config.sigma0_N, config.sigma1_N)
        rates = (
            config.reset_frequency_Hz,
            config.derivative_time_constant_s,
            config.least_speed_m_s,
        )
        self._setting: Any = config.model == "ml", *map(float, (*cusum, *rates))
        self._psi0 = float(config.var_stiffness), 0.0, float(config.var_friction)
        memory = np.zeros(_SIZE)
        memory[_COVARIANCE:_SUMS] = self._psi0
        memory[[_START_M, _BETA]] = (
            config.contact_depth_m,
            config.derivative_threshold_N_per_s,
        )
        self.restore(PublishedState(memory))

    @property
    def state(self) -> PublishedState:
        """All that it remembers."""
        memory = np.array(self._memory)
        return PublishedState(memory, self._windows, self._ruptured, self.layers)

    def restore(self, state: PublishedState) -> None:
        """Go on from there."""
        self._memory = state.memory.copy()
        _, self._windows, self._ruptured, self.layers = state

    def report(
        self, motion: Motion = (0.0, 0.0, 0.0, 0.0), *events: Any
    ) -> tuple[Any, ...]:
        """What there is to report without a sample, or of the last one."""
        outputs = published_outputs(motion, self._memory, self._setting)
        state = _STATES[int(self._memory[_STATE])]
        return (state, *outputs, *(events or (None, None)), None)

    def update(self, sample: Sample) -> tuple[Any, ...]:
        """Use one sample: what to report of it, from the rupture state to the
        events.
        """
        motion = sample[1], sample[2], sample[3], sample[6]
        at, is_full, is_news, outputs = published_step(
            motion, self._memory, self._setting
        )
        if not (is_full or is_news):
            return (_STATES[at], *outputs, None, None, None)
        rupture = layer = None
        if is_news and at == _DETECTED:
            rupture = self._open_layer(sample)
        elif is_full:
            self._windows = self._closed(self._windows)
            self._reset_covariance()
        if is_news and at == _IDENTIFIED and self._ruptured is not None:
            layer = self._identify(self._ruptured, sample[6])
        return self.report(motion, rupture, layer)

    def _closed(self, windows: Array) -> Array:
        return append_window(
            windows, self._memory[_SUMS:_WINDOW_S], self._config.most_windows
        )

    def _reset_covariance(self) -> None:
        self._memory[_COVARIANCE:_SUMS] = self._psi0
        self._memory[_SUMS:_DECISION] = [0.0] * (_DECISION - _SUMS)

    def _open_layer(self, sample: Sample) -> Rupture:
        """A rupture is detected: the next layer begins here and now (d_i of Section
        III).

        f(t_r) of (10) is the last force before the alarming sample, which may have
        dropped already. So may those of its whole reset window: the layer's re-run is
        without it.
        """
        m = self._memory
        config = self._config
        time_s, _, depth_m, speed_m_s, *_ = sample
        rupture = Rupture(
            layer=int(m[_RUPTURES]) + 1,
            alarm_s=time_s,
            alarm_depth_m=depth_m,
            time_s=time_s,
            depth_m=depth_m,
            force_N=float(m[_FORCE_BEFORE]),
            speed_m_s=speed_m_s,
            probability=1.0,
            is_final=True,
            contact_depth_m=float(config.contact_depth_m),
        )
        windows = self._windows if len(self._windows) else self._closed(NO_WINDOWS)
        start_m = float(m[_START_M])
        mean_m_s = float(m[_MEAN_SPEED])
        self._ruptured = RupturedLayer(start_m, windows, mean_m_s, rupture)
        self._windows = NO_WINDOWS
        self._reset_covariance()
        for k in (_RLS, _RLS + 1, _DECISION, _TRAVEL_S, _MEAN_SPEED, _WAITED_S):
            m[k] = 0.0
        m[_RUPTURES] = float(rupture.layer)
        m[_START_M] = depth_m
        rise_N_per_s = rupture.layer * config.derivative_rise_N_per_s
        m[_BETA] = config.derivative_threshold_N_per_s + rise_N_per_s
        m[_DROP_S] = config.drop_travel_m / max(speed_m_s, config.least_speed_m_s)
        return rupture

    def _identify(self, ruptured: RupturedLayer, force_N: float) -> LayerEstimate:
        """After T_drop = k_v / v identify the layer, (10) to (12), and take its
        friction out.

        The sums of the layer after it are corrected for the friction now known, so its
        estimate goes on as if that friction had been subtracted from the rupture
        onwards.
        """
        m = self._memory
        rupture = ruptured.rupture
        known = float(self._memory[_CUMULATIVE])
        drop = rupture.force_N - force_N  # (10): f(t_r) - f(t_r + T_drop)
        elastic, friction_ratio = force_ratios(
            drop, rupture.force_N, known, rupture.speed_m_s
        )
        speed = max(abs(ruptured.mean_speed_m_s), _LEAST_SPEED_M_S)
        stiff, _, damp = self._psi0
        variance = reweighted_friction_variance(damp, elastic, friction_ratio, speed)
        stiffness, friction = rerun_windows(ruptured.windows, (stiff, float(variance)))
        thickness = max(rupture.depth_m - ruptured.start_depth_m, _LEAST_THICKNESS_M)
        damping = friction * (thickness if self._config.model == "ml" else 1.0)
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
        windows = np.vstack((self._windows, m[_SUMS:_WINDOW_S]))
        windows[:, _OF_FORCE] -= (
            damping * windows[:, _OF_SPEED]
        )  # as if it were not felt
        windows.setflags(write=False)
        m[_RLS:_SUMS] = *rerun_windows(windows, (stiff, damp)), *self._psi0
        m[_SUMS:_WINDOW_S] = windows[-1].tolist()
        m[_WAITED_S] = 0.0
        m[_CUMULATIVE] = known + damping
        self._windows = windows[:-1]
        self._ruptured = None
        self.layers = (*self.layers, layer)[-_MOST_LAYERS:]
        return layer


@compiled
def _regressor(layer_depth_m: float, speed_m_s: float, is_ml: bool) -> Pair:
    """Columns (phi_K, phi_B): (dz, dz v) for `ml`, equation (3); (dz, v) for `kv`,
    (2).
    """
    return layer_depth_m, (layer_depth_m * speed_m_s if is_ml else speed_m_s)


@compiled
def rls_step(rls: Rls, phi: Pair, force_N: float) -> tuple[Rls, float]:
    """Use one force sample: equations (7) and (8) with lambda = 1, written out for two
    columns.

    Returns the estimate after the sample, and the error e_k = f_k - phi_k' theta_{k-1}.
    """
    k, b, p11, p12, p22 = rls
    x, y = phi
    error = force_N - (x * k + y * b)
    gx = p11 * x + p12 * y
    gy = p12 * x + p22 * y
    scale = 1.0 + x * gx + y * gy
    step = error / scale
    p11 = p11 - gx * gx / scale
    p12 = p12 - gx * gy / scale
    p22 = p22 - gy * gy / scale
    return (k + gx * step, b + gy * step, p11, p12, p22), error


@compiled
def add_sample(sums: Sums, phi: Pair, force_N: float, speed_m_s: float) -> Sums:
    """Add one sample to the sums of its window."""
    kk, kb, bb, kf, bf, kv, bv = sums
    x, y = phi
    kf = kf + x * force_N
    bf = bf + y * force_N
    kv = kv + x * speed_m_s
    bv = bv + y * speed_m_s
    return kk + x * x, kb + x * y, bb + y * y, kf, bf, kv, bv


def cusum_constants(sigma0_N: float, sigma1_N: float) -> Pair:
    """Drift nu and threshold gamma [N^2] of the CUSUM on the squared error, equation
    (9).
    """
    var0 = sigma0_N * sigma0_N
    var1 = sigma1_N * sigma1_N
    return (var1 + var0) / 2.0, (var1 - var0) / 2.0


@compiled
def cusum_step(decision: float, error_N: float, drift: float) -> float:
    """Decision function g_k = max(g_{k-1} + e_k^2 - nu, 0), equation (9)."""
    return max(decision + error_N * error_N - drift, 0.0)


@compiled
def derivative_step(
    derivative_N_per_s: float, change_N: float, dt_s: float, time_constant_s: float
) -> float:
    """First-order low-pass of df/dt (Section III-B); exact for a force linear over
    the step.
    """
    keep = math.exp(-dt_s / time_constant_s)
    return keep * derivative_N_per_s + (1.0 - keep) * change_N / dt_s


@compiled
def published_outputs(motion: Motion, m: Vector, setting: Setting) -> Outputs:
    """Enhanced force f - sum(B_j d_j) v and its companions, from ``in_contact`` to
    the events.
    """
    _, depth_m, speed_m_s, force_N = motion
    cumulative = m[_CUMULATIVE]
    depth = max(depth_m - m[_START_M], 0.0)
    friction = m[_RLS + 1]
    in_contact = depth > 0.0 or m[_RUPTURES] > 0.0
    earlier = cumulative * speed_m_s
    own = friction * _regressor(depth, speed_m_s, setting[0])[1] if in_contact else 0.0
    enhanced = force_N - earlier
    number = int(m[_RUPTURES]) + 1 if in_contact else 0
    forces = (enhanced, None, enhanced - own, None, earlier + own, None, m[_PREDICTED])
    found = (m[_RLS], None, False, friction, None, False, cumulative, None)
    # Numba knows no starred parts of a tuple.
    return (in_contact, number) + forces + found  # noqa: RUF005


@compiled
def _next_state(m: Vector, threshold: float, reset_Hz: float, is_watching: bool) -> int:
    """Number of the rupture machine's state after a sample."""
    at = int(m[_STATE])
    if at <= _EXPECTED:
        if m[_DECISION] > threshold:
            return _DETECTED
        return _EXPECTED if is_watching and m[_DERIVATIVE] < -m[_BETA] else _NO_RUPTURE
    if at == _DETECTED:
        return _MEASURING
    if at == _IDENTIFIED:
        return _NO_RUPTURE if m[_WAITED_S] * reset_Hz >= 1.0 else at
    return _IDENTIFIED if m[_WAITED_S] >= m[_DROP_S] else at


@compiled
def published_step(
    motion: Motion, m: WrittenVector, setting: Setting
) -> tuple[int, bool, bool, Outputs]:
    """Use one sample: RLS (7)(8), CUSUM (9), the derivative criterion, the state
    machine.

    Returns the number of the rupture machine's state, whether the reset window is full,
    whether that state is a new one, and what to report if neither is.
    """
    dt_s, depth_m, speed_m_s, force_N = motion
    before = int(m[_STATE])
    is_ml, drift, threshold, reset_Hz, constant_s, least_m_s = setting
    before_N = m[_FORCE] if m[_HAS_FORCE] > 0.0 else force_N
    m[_FORCE] = force_N
    m[_FORCE_BEFORE] = before_N
    m[_HAS_FORCE] = 1.0
    if depth_m <= m[_START_M] and m[_RUPTURES] == 0.0:
        m[_PREDICTED] = 0.0
        return before, False, False, published_outputs(motion, m, setting)
    is_watching = before <= _EXPECTED and speed_m_s >= least_m_s
    phi = _regressor(max(depth_m - m[_START_M], 0.0), speed_m_s, is_ml)
    earlier = m[_CUMULATIVE] * speed_m_s
    own = force_N - earlier
    rls, error = rls_step((m[0], m[1], m[2], m[3], m[4]), phi, own)
    m[0], m[1], m[2], m[3], m[4] = rls
    sums = add_sample((m[5], m[6], m[7], m[8], m[9], m[10], m[11]), phi, own, speed_m_s)
    m[5], m[6], m[7], m[8], m[9], m[10], m[11] = sums
    for k in (_WINDOW_S, _TRAVEL_S, _WAITED_S):
        m[k] += dt_s
    m[_MEAN_SPEED] += (speed_m_s - m[_MEAN_SPEED]) * dt_s / m[_TRAVEL_S]
    m[_DECISION] = cusum_step(m[_DECISION], error, drift) if is_watching else 0.0
    m[_DERIVATIVE] = derivative_step(
        m[_DERIVATIVE], force_N - before_N, dt_s, constant_s
    )
    m[_PREDICTED] = own - error + earlier
    at = _next_state(m, threshold, reset_Hz, is_watching)
    is_full = m[_WINDOW_S] * reset_Hz >= _FULL
    m[_STATE] = float(at)
    return at, is_full, at != before, published_outputs(motion, m, setting)


def force_ratios(
    drop_N: float,
    force_at_rupture_N: float,
    cumulative_friction_Ns_per_m: float,
    speed_m_s: float,
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
    var_friction: float,
    elastic_ratio: float,
    friction_ratio: float,
    mean_speed_m_s: float,
) -> float:
    """sigma'^2_B,0 = (1 / v^2) (r_B / r_K) sigma^2_B,0, equation (12).

    With collinear columns least squares moves the estimate along Psi phi, so that
    (B v dz) / (K dz) settles at sigma'^2_B v^2 / sigma^2_K = r_B / r_K.
    """
    return (
        var_friction
        * friction_ratio
        / (elastic_ratio * mean_speed_m_s * mean_speed_m_s)
    )


def append_window(windows: Array, sums: Sums | Array, most: int) -> Array:
    """Add a closed window; beyond ``most`` neighbours are added up.

    That halves their number and bounds memory in an endless layer: the re-run then
    resets half as often over that stretch. An odd last window stays alone.
    """
    grown = np.vstack((windows, sums))
    if len(grown) > most:
        even = len(grown) // 2 * 2
        grown = np.concatenate((grown[0:even:2] + grown[1:even:2], grown[even:]))
    grown.setflags(write=False)
    return grown


@compiled
def rerun_windows(windows: Matrix, variances: Pair) -> Pair:
    """The estimate after all windows, as by a re-run from zero over their samples up to
    rounding.

    Each window begins with covariance diag(variances). Its map is written without an
    inverse of that or of S, so collinear columns and zero variances are harmless: theta
    + Psi_0 (I + S Psi_0)^-1 (b - S theta).
    """
    k = b = 0.0
    p, q = variances
    for i in range(len(windows)):
        kk = windows[i, 0]
        kb = windows[i, 1]
        bb = windows[i, 2]
        kf = windows[i, 3]
        bf = windows[i, 4]
        pb = p * kb
        qb = q * kb
        first = 1.0 + q * bb
        second = 1.0 + p * kk
        excitation = max(kk * bb - kb * kb, 0.0)
        scale = 1.0 / (second + q * bb + (p * q) * excitation)
        own_k = p * (first * kf - qb * bf) * scale
        own_b = q * (second * bf - pb * kf) * scale
        k_before, k = k, own_k + first * scale * k - pb * scale * b
        b = own_b - qb * scale * k_before + second * scale * b
    return float(k), float(b)
