"""Re-run of RLS with covariance resetting over a whole layer (Section III-B), in one solve.

A window maps the estimate linearly, theta_k = A_k theta_{k-1} + c_k. All windows of a layer are one
triangular system, a narrow band, which a single call solves in microseconds.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import get_blas_funcs

from identification.window_history import WindowHistory, window_rows

_solve_band: Any = get_blas_funcs("tbsv", dtype=np.float64)


def rerun_history(
    history: WindowHistory,
    variances: tuple[float, float],
    theta: tuple[float, float] = (0.0, 0.0),
) -> tuple[float, float]:
    """Estimate at the end of a layer.

    Args:
        history: Windows of the layer.
        variances: Diagonal of the (re-weighted) Psi_0, restored at each window's start.
        theta: Estimate at the start of the layer.

    Returns:
        (K, B), the same as the sample-by-sample re-run up to rounding.
    """
    rows = window_rows(history)
    band, estimates = _system(rows, variances, theta)
    solved = _solve_band(
        3, band.reshape(-1, 4).T, estimates.reshape(-1), lower=1, diag=1, overwrite_x=1
    )
    stiffness, friction = solved[-2:].tolist()
    return stiffness, friction


def _system(
    rows: NDArray[np.float64], variances: tuple[float, float], theta: tuple[float, float]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """theta_k - A_k theta_{k-1} = c_k, with A and c those of `window_step` written out.

    Returns:
        Columns of the band below the diagonal of ones (K and B of every window; BLAS names entries
        by their distance below it), shape (m + 1, 2, 4), and right-hand sides, shape (m + 1, 2).
    """
    p, q = variances
    kk, kb, bb, kf, bf = rows.T[:5]
    pb, qb = p * kb, q * kb
    first, second = 1.0 + q * bb, 1.0 + p * kk
    excitation = np.maximum(kk * bb - kb * kb, 0.0)
    share = 1.0 / (second + q * bb + (p * q) * excitation)
    band, right = np.zeros((len(rows) + 1, 2, 4)), np.empty((len(rows) + 1, 2))
    right[0] = theta
    np.multiply(p * (first * kf - qb * bf), share, out=right[1:, 0])
    np.multiply(q * (second * bf - pb * kf), share, out=right[1:, 1])
    np.multiply(pb, share, out=band[:-1, 1, 1])
    np.multiply(qb, share, out=band[:-1, 0, 3])
    np.negative(share, out=share)
    np.multiply(first, share, out=band[:-1, 0, 2])
    np.multiply(second, share, out=band[:-1, 1, 2])
    return band, right
