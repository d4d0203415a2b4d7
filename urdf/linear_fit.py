"""Weighted linear least squares over the joints of an arm that says what it could not determine."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# Singular values below this share of the largest are not determined by the data (unknowns in
# natural units).
_RANK_TOLERANCE = 1e-8
# Rounds of re-weighting when the noise of the joints is not given.
_REWEIGHTINGS = 3
# Enough blocks for a covariance of ten unknowns from their scatter.
_BLOCKS = 40


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LinearFit:
    """Least-squares answer ``target = regressor x + offset per joint + noise``.

    Attributes:
        solution: x, the shortest one if several fit equally, shape (p,).
        covariance: Of x, infinite variance for what is not determined, shape (p, p).
        information_root: R with ``|R (x - solution)|^2`` the weighted cost above its minimum, shape
            (p, p).
        rank: Number of determined combinations of x.
        offsets_std: Standard deviations of the constants per joint, zero if not asked for,
            shape (nv,).
    """

    solution: NDArray[np.float64]
    covariance: NDArray[np.float64]
    information_root: NDArray[np.float64]
    rank: int
    offsets_std: NDArray[np.float64]


def fit_linear(
    regressor: NDArray[np.float64],
    target: NDArray[np.float64],
    *,
    noise_std: NDArray[np.float64] | None,
    fit_offsets: bool,
) -> LinearFit:
    """Fit x, and a constant per joint if asked.

    With one weight per joint the constants drop out by taking each joint's mean off both sides.

    Args:
        regressor: Shape (n, nv, p), columns in natural units (of comparable size).
        target: Shape (n, nv).
        noise_std: Noise per joint, shape (nv,), used as weights; None to take it from the residual.
        fit_offsets: Whether each joint has an unknown constant.
    """
    mean_regressor = regressor.mean(axis=0)
    if fit_offsets:
        regressor, target = regressor - mean_regressor, target - target.mean(axis=0)
    std = np.ones(target.shape[1]) if noise_std is None else noise_std
    for _ in range(_REWEIGHTINGS if noise_std is None else 0):
        solution = _solve(regressor, target, std)[0]
        rms = np.sqrt(np.mean((target - regressor @ solution) ** 2, axis=0))
        # A joint that fits to rounding must not outweigh the others without bound.
        std = np.maximum(rms, max(1e-3 * rms.max(), 1e-12))
    solution, values, axes, rank = _solve(regressor, target, std)
    residual = (target - regressor @ solution) / std
    constants = len(std) if fit_offsets else 0
    covariance = _covariance(regressor / std[:, None], residual, values, axes[:rank], constants)
    offsets_std = np.zeros(len(std))
    if fit_offsets:
        through_x = np.einsum("jp,pr,jr->j", mean_regressor, covariance, mean_regressor)
        offsets_std = np.sqrt(np.var(residual * std, axis=0) / len(target) + through_x)
    return LinearFit(
        solution=solution,
        covariance=_with_unknowns(covariance, axes[rank:]),
        information_root=np.where(np.arange(len(values)) < rank, values, 0.0)[:, None] * axes,
        rank=rank,
        offsets_std=offsets_std,
    )


def _solve(
    regressor: NDArray[np.float64], target: NDArray[np.float64], std: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], int]:
    """Return the shortest solution, singular values, right singular vectors and rank."""
    matrix = (regressor / std[:, None]).reshape(-1, regressor.shape[2])
    # Squaring the matrix would halve the digits of the small singular values; QR keeps them.
    factor = np.asarray(np.linalg.qr(np.column_stack([matrix, (target / std).ravel()]), mode="r"))
    size = matrix.shape[1]
    triangle, right = np.zeros((size, size)), np.zeros(size)
    rows = min(size, len(factor))
    triangle[:rows], right[:rows] = factor[:rows, :size], factor[:rows, size]
    left, values, axes = np.linalg.svd(triangle)
    rank = int(np.sum(values > _RANK_TOLERANCE * max(values[0], 1e-300)))
    solution = axes[:rank].T @ ((left.T @ right)[:rank] / values[:rank])
    return solution, values, axes, rank


def _covariance(
    regressor: NDArray[np.float64],
    residual: NDArray[np.float64],
    values: NDArray[np.float64],
    axes: NDArray[np.float64],
    constants: int,
) -> NDArray[np.float64]:
    """Return the covariance on the determined subspace, from whitened data.

    Real residuals are coloured: model errors last for whole stretches of motion, so samples are far
    from independent. With enough samples the scatter of the gradient over consecutive blocks is
    used (a cluster-robust covariance); with few, the classical formula with the residual's
    variance.
    """
    rank = len(axes)
    inverse = axes.T @ np.diag(values[:rank] ** -2.0) @ axes
    count, joints = residual.shape
    if count >= 2 * _BLOCKS:
        gradient = np.einsum("njp,nj->np", regressor, residual)
        bounds = np.linspace(0, count, _BLOCKS + 1).astype(int)[:-1]
        blocks = np.add.reduceat(gradient, bounds, axis=0)
        return inverse @ (blocks.T @ blocks) @ inverse * _BLOCKS / (_BLOCKS - rank)
    freedom = count * joints - rank - constants
    variance = float(np.sum(residual**2)) / freedom if freedom > 0 else np.inf
    return inverse * max(variance, 1e-300)


def _with_unknowns(
    covariance: NDArray[np.float64], unknown_axes: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the covariance with infinite variance where a parameter is not determined."""
    covariance = covariance.copy()
    undetermined = np.linalg.norm(unknown_axes, axis=0) > 1e-6
    covariance[undetermined, :] = covariance[:, undetermined] = 0.0
    covariance[undetermined, undetermined] = np.inf
    return covariance
