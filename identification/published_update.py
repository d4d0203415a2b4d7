"""What every sample asks of the published method: equations (3) and (7) to (9), the derivative."""

import math
from typing import Any, NamedTuple

from identification.rls_windows import WindowSums
from needleforce.jit import compiled


class RlsState(NamedTuple):
    """Estimate and covariance of a two-parameter recursive least squares.

    Attributes:
        stiffness: First parameter, K.
        friction: Second parameter, B.
        var_stiffness: Psi[0, 0].
        covariance: Psi[0, 1] = Psi[1, 0].
        var_friction: Psi[1, 1].
    """

    stiffness: float
    friction: float
    var_stiffness: float
    covariance: float
    var_friction: float


def reset_covariance(state: RlsState, var_stiffness: float, var_friction: float) -> RlsState:
    """Covariance resetting (Section III-A): Psi back to Psi_0, theta kept."""
    stiffness, friction = state.stiffness, state.friction
    return RlsState(stiffness, friction, float(var_stiffness), 0.0, float(var_friction))


_ROUNDING = 1e-9
_FORGETTING = 1.0

Rls = tuple[float, float, float, float, float]
"""The fields of `RlsState`, plain."""
Sums = tuple[float, float, float, float, float, float, float]
"""The fields of `WindowSums`, plain."""
Memory = tuple[Rls, Sums, float, float, float, float, float, float, float, float, float, bool, bool]
"""The fields of `PublishedMemory`, plain."""
Outputs = tuple[Any, ...]
"""The fields of an `Estimate` from ``in_contact`` up to the events."""


class PublishedMemory(NamedTuple):
    """What every sample changes. Compiled code takes and gives plain tuples.

    Attributes:
        rls: Current estimate and covariance.
        window: Sums since the last covariance reset.
        window_s: Time since then.
        travel_s: Time spent in the layer the tip is in.
        mean_speed_m_s: Average speed in it.
        decision: g_k of equation (9).
        derivative_N_per_s: Filtered force derivative.
        force_N: Last force; nan before the first sample.
        force_before_N: The one before, or the last if there is none.
        waited_s: Time since the detection.
        predicted_N: phi' theta + B_d v before the last sample was used.
        is_alarm: Whether g exceeds its threshold.
        is_expected: Whether the derivative announces a rupture.
    """

    rls: RlsState
    window: WindowSums = WindowSums()
    window_s: float = 0.0
    travel_s: float = 0.0
    mean_speed_m_s: float = 0.0
    decision: float = 0.0
    derivative_N_per_s: float = 0.0
    force_N: float = math.nan
    force_before_N: float = math.nan
    waited_s: float = 0.0
    predicted_N: float = 0.0
    is_alarm: bool = False
    is_expected: bool = False

    @property
    def plain(self) -> tuple[Any, ...]:
        """As `update_published` takes it."""
        return tuple(self.rls), tuple(self.window), *self[2:]

    @staticmethod
    def of(plain: tuple[Any, ...]) -> "PublishedMemory":
        """From what `update_published` gave."""
        rls, window, *rest = plain
        return PublishedMemory(RlsState(*rls), WindowSums(*window), *rest)


class PublishedCoefficients(NamedTuple):
    """What `update_published` reads; changes with a layer or the rupture state only.

    Attributes:
        least_speed_m_s: Setting.
        drift: nu of equation (9).
        threshold: gamma of equation (9).
        beta: Threshold of the derivative, grown by the detections so far.
        derivative_s: Setting ``derivative_time_constant_s``.
        reset_Hz: Setting ``reset_frequency_Hz``.
        is_ml: Whether the model is (3), not (2).
        start_m: Depth at which the current layer begins.
        is_inside: Whether a layer has been left: the needle is in tissue.
        layer: Number of the current layer.
        cumulative_Ns_per_m: Sum of B_j d_j.
        is_muted: Whether the rupture state looks for no rupture.
        is_expected: Whether it expects one.
        is_due: Whether the next sample finds work to do: around a rupture, every one does.
    """

    least_speed_m_s: float
    drift: float
    threshold: float
    beta: float
    derivative_s: float
    reset_Hz: float
    is_ml: bool
    start_m: float
    is_inside: bool
    layer: int
    cumulative_Ns_per_m: float
    is_muted: bool
    is_expected: bool
    is_due: bool


Coefficients = tuple[PublishedCoefficients]


@compiled
def is_window_full(window_s: float, reset_Hz: float) -> bool:
    """Whether the covariance is to be reset (Section III-A)."""
    return window_s * reset_Hz >= 1.0 - _ROUNDING


@compiled
def regressor(layer_depth_m: float, speed_m_s: float, is_ml: bool) -> tuple[float, float]:
    """Columns (phi_K, phi_B): (dz, dz v) for `ml`, equation (3); (dz, v) for `kv`, (2)."""
    return layer_depth_m, (layer_depth_m * speed_m_s if is_ml else speed_m_s)


@compiled
def rls_step(
    rls: Rls, phi: tuple[float, float], force_N: float, forgetting: float
) -> tuple[Rls, float]:
    """Use one force sample: equations (7) and (8) of the paper, written out for two columns.

    Args:
        rls: Estimate before the sample, see `RlsState`.
        phi: Regressor (phi_K, phi_B).
        force_N: Force to explain, earlier layers' friction already subtracted.
        forgetting: lambda in (0, 1]; 1 keeps everything.

    Returns:
        The estimate after the sample, and the error e_k = f_k - phi_k' theta_{k-1}.
    """
    k, b, p11, p12, p22 = rls
    x, y = phi
    error = force_N - (x * k + y * b)
    gx = p11 * x + p12 * y
    gy = p12 * x + p22 * y
    scale = forgetting + x * gx + y * gy
    step = error / scale
    p11, p12, p22 = p11 - gx * gx / scale, p12 - gx * gy / scale, p22 - gy * gy / scale
    return (k + gx * step, b + gy * step, p11, p12, p22), error


@compiled
def add_sample(sums: Sums, phi: tuple[float, float], force_N: float, speed_m_s: float) -> Sums:
    """Add one sample to the sums of its window, see `WindowSums`."""
    kk, kb, bb, kf, bf, kv, bv = sums
    x, y = phi
    return (
        kk + x * x,
        kb + x * y,
        bb + y * y,
        kf + x * force_N,
        bf + y * force_N,
        kv + x * speed_m_s,
        bv + y * speed_m_s,
    )


@compiled
def cusum_step(decision: float, error_N: float, drift: float) -> float:
    """Decision function g_k = max(g_{k-1} + e_k^2 - nu, 0), equation (9)."""
    return max(decision + error_N * error_N - drift, 0.0)


@compiled
def derivative_step(
    derivative_N_per_s: float, change_N: float, dt_s: float, time_constant_s: float
) -> float:
    """Advance the first-order low-pass of df/dt; exact for a force linear over the step.

    The second criterion of Section III-B.

    Args:
        derivative_N_per_s: Filtered derivative so far.
        change_N: f_k - f_{k-1}.
        dt_s: Time between the two samples.
        time_constant_s: Of the low-pass.
    """
    keep = math.exp(-dt_s / time_constant_s)
    return keep * derivative_N_per_s + (1.0 - keep) * change_N / dt_s


@compiled
def published_outputs(
    depth_m: float, speed_m_s: float, force_N: float, memory: Memory, coefficients: Coefficients
) -> Outputs:
    """Enhanced force f - sum(B_j d_j) v and its companions; see `update_published`."""
    c = coefficients[0]
    depth = max(depth_m - c.start_m, 0.0)
    in_contact = depth > 0.0 or c.is_inside
    stiffness, friction = memory[0][0], memory[0][1]
    phi = regressor(depth, speed_m_s, c.is_ml)
    earlier = c.cumulative_Ns_per_m * speed_m_s
    own = friction * phi[1] if in_contact else 0.0
    return (
        in_contact,
        c.layer if in_contact else 0,
        force_N - earlier,
        force_N - earlier - own,
        earlier + own,
        None,
        memory[10],
        stiffness,
        None,
        False,
        friction,
        None,
        False,
        c.cumulative_Ns_per_m,
        None,
    )


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

    Args:
        depth_m: Travel of the tip along the insertion axis [m].
        speed_m_s: Rate of depth [m/s].
        force_N: Axial force [N].
        dt_s: Time since the sample before [s].
        memory: `PublishedMemory.plain`.
        coefficients: All else that counts.

    Returns:
        Whether that was all: no window is full, the rupture state stays what it is; the new
        memory, and what to report, see `published_outputs`.
    """
    c = coefficients[0]
    rls, window, window_s, travel_s, mean, decision, derivative, last, _, waited, _, _, was = memory
    before = force_N if math.isnan(last) else last
    layer_depth = depth_m - c.start_m
    if layer_depth <= 0.0 and not c.is_inside:
        so_far = (rls, window, window_s, travel_s, mean, decision, derivative)
        # Numba knows no starred parts of a tuple.
        free = so_far + (force_N, before, waited, 0.0, False, was)  # noqa: RUF005
        return True, free, published_outputs(depth_m, speed_m_s, force_N, free, coefficients)
    phi = regressor(max(layer_depth, 0.0), speed_m_s, c.is_ml)
    earlier = c.cumulative_Ns_per_m * speed_m_s
    own = force_N - earlier
    rls, error = rls_step(rls, phi, own, _FORGETTING)
    window_s, travel_s, waited = window_s + dt_s, travel_s + dt_s, waited + dt_s
    is_muted = c.is_muted or speed_m_s < c.least_speed_m_s
    decision = 0.0 if is_muted else cusum_step(decision, error, c.drift)
    derivative = derivative_step(derivative, force_N - before, dt_s, c.derivative_s)
    is_alarm = decision > c.threshold
    is_expected = not is_muted and derivative < -c.beta
    window = add_sample(window, phi, own, speed_m_s)
    mean += (speed_m_s - mean) * dt_s / travel_s
    so_far = (rls, window, window_s, travel_s, mean, decision, derivative)
    predicted = own - error + earlier
    new = so_far + (force_N, before, waited, predicted, is_alarm, is_expected)  # noqa: RUF005
    is_all = not is_alarm and is_expected == c.is_expected
    is_all = is_all and not c.is_due and not is_window_full(window_s, c.reset_Hz)
    return is_all, new, published_outputs(depth_m, speed_m_s, force_N, new, coefficients)
