"""Least squares (6) that says which parameters the data determine."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

RANK_TOLERANCE = 1e-3
"""Singular values of the scaled columns below this share of the largest count as zero: a
difference between columns under 0.1 % is smaller than any linear tissue model is right."""
_NULL_SHARE = 0.05
_BLOCKS = 60


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LeastSquaresFit:
    """Answer of a linear least squares that grades itself.

    Attributes:
        parameters: Minimum-norm solution in scaled columns, shape (p,).
        standard_deviations: Shape (p,); infinite where not identified.
        identified: Shape (p,); False where the data leave the parameter (partly) free.
        rank: Numerical rank of the scaled matrix.
        condition_number: Of the scaled matrix; infinite for an empty column.
        rmse: Root mean square residual, in units of the right-hand side.
    """

    parameters: NDArray[np.float64]
    standard_deviations: NDArray[np.float64]
    identified: NDArray[np.bool_]
    rank: int
    condition_number: float
    rmse: float


def _block_covariance(
    scaled: NDArray[np.float64], residual: NDArray[np.float64], inverse: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Sandwich covariance over contiguous blocks: residuals of tissue are far from white."""
    edges = np.linspace(0, len(residual), min(_BLOCKS, len(residual)) + 1).astype(int)
    scores = np.add.reduceat(scaled * residual[:, None], edges[:-1], axis=0)
    return inverse @ (scores.T @ scores) @ inverse


def solve_least_squares(
    matrix: NDArray[np.float64], target: NDArray[np.float64]
) -> LeastSquaresFit:
    """Solve theta = Phi^# f, equation (6), on columns scaled to unit length.

    Args:
        matrix: Phi, shape (n, p).
        target: f, shape (n,).

    Returns:
        Parameters with standard deviations (autocorrelated residuals allowed for), rank and
        condition number of the scaled columns, and which parameters are identified.
    """
    scale = np.linalg.norm(matrix, axis=0)
    safe = np.where(scale > 0, scale, 1.0)
    scaled = matrix / safe
    u, s, vt = np.linalg.svd(scaled, full_matrices=False)
    kept = s > RANK_TOLERANCE * max(float(s[0]), np.finfo(float).tiny)
    solution = vt[kept].T @ ((u[:, kept].T @ target) / s[kept])
    residual = target - scaled @ solution
    pseudo_inverse = (vt[kept].T / s[kept] ** 2) @ vt[kept]
    covariance = _block_covariance(scaled, residual, pseudo_inverse)
    free_share = 1.0 - np.sum(vt[kept] ** 2, axis=0)
    identified = (free_share < _NULL_SHARE**2) & (scale > 0)
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0)) / safe
    return LeastSquaresFit(
        parameters=solution / safe,
        standard_deviations=np.where(identified, deviation, np.inf),
        identified=identified,
        rank=int(np.count_nonzero(kept)),
        condition_number=float(s[0] / s[-1]) if s[-1] > 0 else float("inf"),
        rmse=float(np.sqrt(np.mean(residual**2))),
    )
