"""Sums per covariance-reset window, from which a layer can be re-identified at once.

Between two resets RLS with lambda = 1 is a regularised least squares,
theta = (Psi_0^-1 + S)^-1 (Psi_0^-1 theta_prev + b) with S = sum phi phi' and b = sum phi f:
a re-run over the layer needs S and b of each window, not its samples.
"""

from typing import NamedTuple


class WindowSums(NamedTuple):
    """Sums over the samples between two covariance resets.

    Attributes:
        kk: Sum of phi_K^2.
        kb: Sum of phi_K phi_B.
        bb: Sum of phi_B^2.
        kf: Sum of phi_K f.
        bf: Sum of phi_B f.
        kv: Sum of phi_K v.
        bv: Sum of phi_B v; with `kv` it allows a later change of the cumulative friction.
    """

    kk: float = 0.0
    kb: float = 0.0
    bb: float = 0.0
    kf: float = 0.0
    bf: float = 0.0
    kv: float = 0.0
    bv: float = 0.0


def less_viscous_force(sums: WindowSums, damping_Ns_per_m: float) -> WindowSums:
    """Sums as if `damping_Ns_per_m * v` had been subtracted from every force sample."""
    return sums._replace(
        kf=sums.kf - damping_Ns_per_m * sums.kv, bf=sums.bf - damping_Ns_per_m * sums.bv
    )


def window_step(
    theta: tuple[float, float], sums: WindowSums, variances: tuple[float, float]
) -> tuple[float, float]:
    """Estimate after one window that began with covariance diag(variances) at `theta`.

    Written as theta + Psi_0 (I + S Psi_0)^-1 (b - S theta): no inverse of Psi_0 or S is needed,
    so collinear columns and zero variances are harmless.
    """
    k, b = theta
    p, q = variances
    rk = sums.kf - sums.kk * k - sums.kb * b
    rb = sums.bf - sums.kb * k - sums.bb * b
    m11, m12 = 1.0 + sums.kk * p, sums.kb * q
    m21, m22 = sums.kb * p, 1.0 + sums.bb * q
    excitation = max(sums.kk * sums.bb - sums.kb * sums.kb, 0.0)
    determinant = 1.0 + sums.kk * p + sums.bb * q + p * q * excitation
    return (
        k + p * (m22 * rk - m12 * rb) / determinant,
        b + q * (m11 * rb - m21 * rk) / determinant,
    )
