"""Re-run of RLS with covariance resetting over a whole layer (Section III-B), window by window.

A window maps the estimate linearly, theta_k = A_k theta_{k-1} + c_k. Compiled code follows the
estimate from one window to the next. Without a compiler all windows of a layer are one triangular
system, a narrow band, which a single call solves: no loop of Python over thousands of windows.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import get_blas_funcs

from identification.window_history import WindowHistory, window_rows
from speedup import COMPILER, Matrix, compiled

_solve_band: Any = get_blas_funcs("tbsv", dtype=np.float64)

Pair = tuple[float, float]


def rerun_history(
    history: WindowHistory, variances: Pair, theta: Pair = (0.0, 0.0)
) -> tuple[float, float]:
    """Estimate at the end of a layer.

    Args:
        history: Windows of the layer.
        variances: Diagonal of the (re-weighted) Psi_0, restored at each window's start.
        theta: Estimate at the start of the layer.

    Returns:
        (K, B), the same as the sample-by-sample re-run up to rounding.
    """
    columns = np.ascontiguousarray(window_rows(history).T)
    return (follow_windows if COMPILER else solve_windows)(columns, variances, theta)


@compiled
def _window_map(kk: Any, kb: Any, bb: Any, kf: Any, bf: Any, variances: Pair) -> Any:
    """A and c of a window with these sums, or of many: those of `window_step` written out.

    Returns:
        Entries of A (two on, two off the diagonal), the latter with the sign turned; then of c.
    """
    p, q = variances
    pb, qb = p * kb, q * kb
    first, second = 1.0 + q * bb, 1.0 + p * kk
    excitation = np.maximum(kk * bb - kb * kb, 0.0)
    share = 1.0 / (second + q * bb + (p * q) * excitation)
    own = p * (first * kf - qb * bf) * share, q * (second * bf - pb * kf) * share
    return first * share, second * share, pb * share, qb * share, own[0], own[1]


@compiled
def follow_windows(columns: Matrix, variances: Pair, theta: Pair) -> Pair:
    """The estimate after all windows, one after the other.

    Args:
        columns: The fields of `WindowSums`, shape (7, m).
        variances: See `rerun_history`.
        theta: Estimate before them.
    """
    k, b = theta
    kk, kb, bb, kf, bf = columns[0], columns[1], columns[2], columns[3], columns[4]
    for i in range(columns.shape[1]):
        kept_k, kept_b, b_to_k, k_to_b, own_k, own_b = _window_map(
            kk[i], kb[i], bb[i], kf[i], bf[i], variances
        )
        k, b = own_k + kept_k * k - b_to_k * b, own_b - k_to_b * k + kept_b * b
    return k, b


def solve_windows(columns: NDArray[np.float64], variances: Pair, theta: Pair) -> Pair:
    """The same by one call: theta_k - A_k theta_{k-1} = c_k for all windows at once.

    BLAS takes the columns of the band below the diagonal of ones (K and B of every window) and
    names entries by their distance below it.
    """
    kk, kb, bb, kf, bf = columns[:5]
    kept_k, kept_b, b_to_k, k_to_b, own_k, own_b = _window_map(kk, kb, bb, kf, bf, variances)
    band, right = np.zeros((columns.shape[1] + 1, 2, 4)), np.empty((columns.shape[1] + 1, 2))
    right[0], right[1:, 0], right[1:, 1] = theta, own_k, own_b
    band[:-1, 0, 2], band[:-1, 1, 2] = -kept_k, -kept_b
    band[:-1, 1, 1], band[:-1, 0, 3] = b_to_k, k_to_b
    solved = _solve_band(
        3, band.reshape(-1, 4).T, right.reshape(-1), lower=1, diag=1, overwrite_x=1
    )
    stiffness, friction = solved[-2:].tolist()
    return stiffness, friction
