"""What every sample asks of the published method: equations (3) and (7) to (9), the derivative.

A window between two covariance resets maps the estimate linearly, theta_k = A_k theta_{k-1} + c_k:
RLS with lambda = 1 is a regularised least squares, theta = (Psi_0^-1 + S)^-1 (Psi_0^-1 theta_prev +
b) with S = sum phi phi' and b = sum phi f. A re-run over a layer (Section III-B) needs S and b of
each window, not its samples.
"""

import math
from typing import NamedTuple

import numpy as np

from identification.estimate import Array, Outputs
from needleforce.jit import Matrix, compiled

ROUNDING = 1e-9

Pair = tuple[float, float]
Rls = tuple[float, float, float, float, float]
"""Estimate K, B and covariance Psi[0, 0], Psi[0, 1], Psi[1, 1] of a two-parameter RLS."""
Sums = tuple[float, float, float, float, float, float, float]
"""Over the samples between two covariance resets: phi_K^2, phi_K phi_B, phi_B^2, phi_K f, phi_B f;
and phi_K v, phi_B v, which with `kv` allow a later change of the cumulative friction."""
NO_SUMS: Sums = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
_KF, _BF, _KV, _BV = 3, 4, 5, 6
Memory = tuple[Rls, Sums, float, float, float, float, float, float, float, float, float, bool, bool]
"""The fields of `PublishedMemory`."""
Coefficients = tuple[
    float, float, float, float, float, float, bool, float, bool, int, float, bool, bool
]  # fmt: skip
"""What `published_identifier.published_coefficients` returns."""


class PublishedMemory(NamedTuple):
    """What every sample changes. Compiled code takes and gives plain tuples."""

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
    is_alarm: bool = False  # Whether g exceeds its threshold
    is_expected: bool = False  # Whether the derivative announces a rupture

    @property
    def damage(self) -> str:
        """What is wrong with the covariance, if anything."""
        *_, first, both, second = self.rls
        is_definite = min(first, second) >= 0.0 and both * both <= 1.002 * first * second
        return "" if is_definite else "its covariance is not positive semi-definite"


@compiled
def regressor(layer_depth_m: float, speed_m_s: float, is_ml: bool) -> Pair:
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
def published_outputs(
    depth_m: float, speed_m_s: float, force_N: float, memory: Memory, coefficients: Coefficients
) -> Outputs:
    """Enhanced force f - sum(B_j d_j) v and its companions; see `update_published`."""
    _, _, _, _, _, _, is_ml, start_m, is_inside, layer, cumulative, _, _ = coefficients
    depth = max(depth_m - start_m, 0.0)
    in_contact = depth > 0.0 or is_inside
    stiffness, friction = memory[0][0], memory[0][1]
    phi = regressor(depth, speed_m_s, is_ml)
    earlier = cumulative * speed_m_s
    own = friction * phi[1] if in_contact else 0.0
    tip = force_N - earlier - own
    forces = (force_N - earlier, None, tip, None, earlier + own, None, memory[10])
    found = (stiffness, None, False, friction, None, False, cumulative, None)
    # Numba knows no starred parts of a tuple.
    return (in_contact, layer if in_contact else 0) + forces + found  # noqa: RUF005


@compiled
def update_published(
    depth_m: float,
    speed_m_s: float,
    force_N: float,
    dt_s: float,
    memory: Memory,
    coefficients: Coefficients,
) -> tuple[bool, Memory, Outputs]:
    """Use one sample: RLS (7)(8), CUSUM (9) and the derivative criterion.

    Returns:
        Whether that was all: no window is full, the rupture state stays what it is; the new
        memory, and what to report, see `published_outputs`.
    """
    least_speed, drift, threshold, beta, derivative_s, reset_Hz = coefficients[:6]
    is_ml, start_m, is_inside, _, cumulative, is_muted, was_expected = coefficients[6:]
    rls, window, window_s, travel_s, mean, decision, derivative, last, _, waited, _, _, was = memory
    before = force_N if math.isnan(last) else last
    layer_depth = depth_m - start_m
    if layer_depth <= 0.0 and not is_inside:
        so_far = (rls, window, window_s, travel_s, mean, decision, derivative)
        free = so_far + (force_N, before, waited, 0.0, False, was)  # noqa: RUF005
        return True, free, published_outputs(depth_m, speed_m_s, force_N, free, coefficients)
    phi = regressor(max(layer_depth, 0.0), speed_m_s, is_ml)
    earlier = cumulative * speed_m_s
    own = force_N - earlier
    rls, error = rls_step(rls, phi, own)
    window_s, travel_s, waited = window_s + dt_s, travel_s + dt_s, waited + dt_s
    is_quiet = is_muted or speed_m_s < least_speed
    decision = 0.0 if is_quiet else cusum_step(decision, error, drift)
    derivative = derivative_step(derivative, force_N - before, dt_s, derivative_s)
    is_alarm = decision > threshold
    is_expected = not is_quiet and derivative < -beta
    window = add_sample(window, phi, own, speed_m_s)
    mean += (speed_m_s - mean) * dt_s / travel_s
    so_far = (rls, window, window_s, travel_s, mean, decision, derivative)
    predicted = own - error + earlier
    new = so_far + (force_N, before, waited, predicted, is_alarm, is_expected)  # noqa: RUF005
    is_all = not (is_alarm or is_muted) and is_expected == was_expected
    is_all = is_all and window_s * reset_Hz < 1.0 - ROUNDING
    return is_all, new, published_outputs(depth_m, speed_m_s, force_N, new, coefficients)


# The re-run over a layer.

_SLACK = 16
"""Windows beyond the most before neighbours are added up: not at every window."""
NO_WINDOWS = np.empty((0, len(NO_SUMS)))
"""Sums of the windows of a layer, one row of `Sums` each."""
NO_WINDOWS.setflags(write=False)


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
