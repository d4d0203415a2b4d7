"""Recursive least squares in two unknowns, equations (7) and (8)."""

from typing import NamedTuple


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


def rls_step(
    state: RlsState, phi: tuple[float, float], force_N: float, forgetting: float = 1.0
) -> tuple[RlsState, float]:
    """Absorb one force sample: equations (7) and (8) of the paper, written out for two columns.

    Args:
        state: Estimate before the sample.
        phi: Regressor (phi_K, phi_B).
        force_N: Force to explain, earlier layers' friction already subtracted.
        forgetting: lambda in (0, 1]; 1 keeps everything.

    Returns:
        The estimate after the sample, and the error e_k = f_k - phi_k' theta_{k-1}.
    """
    k, b, p11, p12, p22 = state
    x, y = phi
    error = force_N - (x * k + y * b)
    gx = p11 * x + p12 * y
    gy = p12 * x + p22 * y
    scale = forgetting + x * gx + y * gy
    step = error / scale
    return (
        RlsState(
            k + gx * step,
            b + gy * step,
            p11 - gx * gx / scale,
            p12 - gx * gy / scale,
            p22 - gy * gy / scale,
        ),
        error,
    )


def reset_covariance(state: RlsState, var_stiffness: float, var_friction: float) -> RlsState:
    """Covariance resetting (Section III-A): Psi back to Psi_0, theta kept."""
    return RlsState(state.stiffness, state.friction, var_stiffness, 0.0, var_friction)
