"""What every sample asks of the published method: equations (3) and (7) to (9), the derivative."""

import math
from typing import Any, NamedTuple

from identification.rls_windows import WindowSums
from needleforce.jit import Vector, compiled


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


(
    LEAST_SPEED,
    DRIFT,
    THRESHOLD,
    BETA,
    DERIVATIVE_S,
    RESET_HZ,
    IS_ML,
    START_M,
    IS_INSIDE,
    LAYER,
    CUMULATIVE,
    IS_MUTED,
    IS_EXPECTED,
    IS_DUE,
    PLACES,
) = range(15)
"""Places of the numbers that `published_coefficients` lays out."""
_ROUNDING = 1e-9
_FORGETTING = 1.0

Rls = tuple[float, float, float, float, float]
"""The fields of `RlsState`, plain."""
Sums = tuple[float, float, float, float, float, float, float]
"""The fields of `WindowSums`, plain."""
Fields = tuple[Rls, Sums, float, float, float, float, float, float, float, float, float, bool, bool]
"""Of `PublishedUpdate`, plain."""
Figures = tuple[Any, ...]
"""The fields of an `Estimate` from ``in_contact`` up to the events."""


class PublishedUpdate(NamedTuple):
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
        predicted_N: phi' theta + B_d v before the last sample was absorbed.
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
        """As `published_update` takes it."""
        return tuple(self.rls), tuple(self.window), *self[2:]

    @staticmethod
    def of(plain: tuple[Any, ...]) -> "PublishedUpdate":
        """From what `published_update` gave."""
        rls, window, *rest = plain
        return PublishedUpdate(RlsState(*rls), WindowSums(*window), *rest)


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
    """Absorb one force sample: equations (7) and (8) of the paper, written out for two columns.

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
def paper_figures(
    depth_m: float, speed_m_s: float, force_N: float, tick: Fields, numbers: Vector
) -> Figures:
    """Enhanced force f - sum(B_j d_j) v and its companions; see `published_update`."""
    depth = max(depth_m - numbers[START_M], 0.0)
    in_contact = depth > 0.0 or numbers[IS_INSIDE] != 0.0
    stiffness, friction = tick[0][0], tick[0][1]
    phi = regressor(depth, speed_m_s, numbers[IS_ML] != 0.0)
    earlier = numbers[CUMULATIVE] * speed_m_s
    own = friction * phi[1] if in_contact else 0.0
    return (
        in_contact,
        int(numbers[LAYER]) if in_contact else 0,
        force_N - earlier,
        force_N - earlier - own,
        earlier + own,
        None,
        tick[10],
        stiffness,
        None,
        False,
        friction,
        None,
        False,
        numbers[CUMULATIVE],
        None,
    )


@compiled
def published_update(
    depth_m: float,
    speed_m_s: float,
    force_N: float,
    dt_s: float,
    tick: Fields,
    numbers: Vector,
) -> tuple[bool, Fields, Figures]:
    """Absorb one sample: RLS (7)(8), CUSUM (9) and the derivative criterion.

    Args:
        depth_m: Travel of the tip along the insertion axis [m].
        speed_m_s: Rate of depth [m/s].
        force_N: Axial force [N].
        dt_s: Time since the sample before [s].
        tick: `PublishedUpdate.plain`.
        numbers: All else that counts, see `published_coefficients`.

    Returns:
        Whether that was all: no window is full, the state machine stays where it is; the new
        fields, and what to tell, see `paper_figures`.
    """
    rls, window, window_s, travel_s, mean, decision, derivative, last, _, waited, _, _, was = tick
    before = force_N if math.isnan(last) else last
    layer_depth = depth_m - numbers[START_M]
    if layer_depth <= 0.0 and numbers[IS_INSIDE] == 0.0:
        so_far = (rls, window, window_s, travel_s, mean, decision, derivative)
        # Numba knows no starred parts of a tuple.
        free = so_far + (force_N, before, waited, 0.0, False, was)  # noqa: RUF005
        return True, free, paper_figures(depth_m, speed_m_s, force_N, free, numbers)
    phi = regressor(max(layer_depth, 0.0), speed_m_s, numbers[IS_ML] != 0.0)
    earlier = numbers[CUMULATIVE] * speed_m_s
    own = force_N - earlier
    rls, error = rls_step(rls, phi, own, _FORGETTING)
    window_s, travel_s, waited = window_s + dt_s, travel_s + dt_s, waited + dt_s
    is_muted = numbers[IS_MUTED] != 0.0 or speed_m_s < numbers[LEAST_SPEED]
    decision = 0.0 if is_muted else cusum_step(decision, error, numbers[DRIFT])
    derivative = derivative_step(derivative, force_N - before, dt_s, numbers[DERIVATIVE_S])
    is_alarm = decision > numbers[THRESHOLD]
    is_expected = not is_muted and derivative < -numbers[BETA]
    window = add_sample(window, phi, own, speed_m_s)
    mean += (speed_m_s - mean) * dt_s / travel_s
    so_far = (rls, window, window_s, travel_s, mean, decision, derivative)
    predicted = own - error + earlier
    new = so_far + (force_N, before, waited, predicted, is_alarm, is_expected)  # noqa: RUF005
    is_calm = not is_alarm and is_expected == (numbers[IS_EXPECTED] != 0.0)
    is_calm = is_calm and numbers[IS_DUE] == 0.0 and not is_window_full(window_s, numbers[RESET_HZ])
    return is_calm, new, paper_figures(depth_m, speed_m_s, force_N, new, numbers)
