"""Offline identification with known layers and ruptures (Section II)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from identification.errors import InvalidLogError
from identification.interaction_model import LayerSpan, Model, regression_matrix

RANK_TOLERANCE = 1e-3
"""Singular values of the scaled columns below this fraction of the largest count as zero: a
difference between columns under 0.1 % is smaller than any linear tissue model is right."""
_FREE_FRACTION = 0.05
_BLOCKS = 60


class LeastSquaresFit(NamedTuple):
    """Answer of a linear least squares with an assessment of itself."""

    parameters: NDArray[np.float64]  # Minimum-norm solution in scaled columns, shape (p,)
    standard_deviations: NDArray[np.float64]  # Shape (p,); infinite where not identified
    identified: NDArray[np.bool_]  # Shape (p,); False where the data leave the parameter free
    rank: int  # Numerical rank of the scaled matrix
    condition_number: float  # Of the scaled matrix; infinite for an empty column
    rmse: float  # Root mean square residual, in units of the right-hand side


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
    # Sandwich covariance over contiguous blocks: residuals of tissue are far from white.
    edges = np.linspace(0, len(residual), min(_BLOCKS, len(residual)) + 1).astype(int)
    scores = np.add.reduceat(scaled * residual[:, None], edges[:-1], axis=0)
    covariance = pseudo_inverse @ (scores.T @ scores) @ pseudo_inverse
    free = 1.0 - np.sum(vt[kept] ** 2, axis=0)
    identified = (free < _FREE_FRACTION**2) & (scale > 0)
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0)) / safe
    return LeastSquaresFit(
        parameters=solution / safe,
        standard_deviations=np.where(identified, deviation, np.inf),
        identified=identified,
        rank=int(np.count_nonzero(kept)),
        condition_number=float(s[0] / s[-1]) if s[-1] > 0 else float("inf"),
        rmse=float(np.sqrt(np.mean(residual**2))),
    )


def read_column(
    name: str, values: ArrayLike, rows: int | None = None, *, finite: bool = False
) -> NDArray[np.float64]:
    """Return a column as a float array of its own.

    Returns:
        The same numbers, shape (n,), a copy.

    Raises:
        InvalidLogError: Not a vector of real numbers, an empty one, or not as wanted.
    """
    try:
        if np.iscomplexobj(values):
            raise TypeError("its numbers are complex")
        column = np.array(values, dtype=float)
    except (TypeError, ValueError, OverflowError) as error:
        raise InvalidLogError(f"{name} is not a vector of numbers: {error}") from error
    if column.ndim != 1 or column.size == 0:
        raise InvalidLogError(
            f"{name} must be a non-empty vector, got shape {column.shape}; one value per row"
        )
    if rows is not None and len(column) != rows:
        raise InvalidLogError(f"{name} has {len(column)} rows where t_s has {rows}")
    bad = np.flatnonzero(~np.isfinite(column))
    if finite and len(bad):
        raise InvalidLogError(f"{name} is not finite at row {bad[0]} ({len(bad)} in all)")
    return column


@dataclass(frozen=True, slots=True, kw_only=True)
class OfflineLayer:
    """One layer identified offline.

    Attributes:
        stiffness_N_per_m: K_i.
        stiffness_std_N_per_m: Its standard deviation; infinite when not identified.
        stiffness_identified: Whether the data separate it from the other parameters.
        friction: B_i [Ns/m^2] for `ml`, [Ns/m] for `kv`.
        friction_std: Its standard deviation; infinite when not identified.
        friction_identified: Whether the data separate it from the other parameters.
        cumulative_friction_Ns_per_m: Part of this layer in the cumulative friction: B_i d_i for
            `ml` (the values of Table I), B_i for `kv`.
    """

    stiffness_N_per_m: float
    stiffness_std_N_per_m: float
    stiffness_identified: bool
    friction: float
    friction_std: float
    friction_identified: bool
    cumulative_friction_Ns_per_m: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OfflineIdentification:
    """Result of equation (6) over one recording.

    Attributes:
        model: `ml` or `kv`.
        layers: One entry per layer, in order of entry.
        rank: Numerical rank of the scaled regression matrix.
        condition_number: Of the scaled regression matrix.
        rmse_N: Root mean square reconstruction error.
        predicted_force_N: Reconstruction Phi theta, shape (n,), read-only.
    """

    model: Model
    layers: tuple[OfflineLayer, ...]
    rank: int
    condition_number: float
    rmse_N: float
    predicted_force_N: NDArray[np.float64]


def _layer(fit: LeastSquaresFit, index: int, span: LayerSpan, model: Model) -> OfflineLayer:
    k, b = 2 * index, 2 * index + 1
    friction = float(fit.parameters[b])
    return OfflineLayer(
        stiffness_N_per_m=float(fit.parameters[k]),
        stiffness_std_N_per_m=float(fit.standard_deviations[k]),
        stiffness_identified=bool(fit.identified[k]),
        friction=friction,
        friction_std=float(fit.standard_deviations[b]),
        friction_identified=bool(fit.identified[b]),
        cumulative_friction_Ns_per_m=friction * (span.thickness_m if model == "ml" else 1.0),
    )


def identify_offline(
    t_s: ArrayLike,
    depth_m: ArrayLike,
    speed_m_s: ArrayLike,
    force_N: ArrayLike,
    layers: Sequence[LayerSpan],
    model: Model = "ml",
) -> OfflineIdentification:
    """Identify stiffness and friction of known layers, equations (4) to (6).

    At constant speed the columns of one layer are proportional as long as the tip is inside it:
    only data beyond its rupture separate its stiffness from its friction. Where they are missing
    both are marked as not identified; the values given are then the minimum-norm choice.

    Args:
        t_s: Increasing time [s], shape (n,).
        depth_m: Tip depth since first contact [m], shape (n,).
        speed_m_s: Rate of depth [m/s], shape (n,).
        force_N: Axial force, positive when tissue pushes back [N], shape (n,).
        layers: Known layers in order of entry.
        model: `ml`, equation (3), or `kv`, equation (2).

    Returns:
        Parameters per layer with standard deviations, rank, condition number, reconstruction.

    Raises:
        InvalidLogError: Empty, ragged, non-finite or unordered columns.
        InvalidConfigError: No layer, or an unknown model.
    """
    t = read_column("t_s", t_s, finite=True)
    z, v, f = (
        read_column(name, values, len(t), finite=True)
        for name, values in (("depth_m", depth_m), ("speed_m_s", speed_m_s), ("force_N", force_N))
    )
    if np.any(np.diff(t) <= 0):
        raise InvalidLogError("t_s must increase; sort the recording or drop repeated samples")
    matrix = regression_matrix(t, z, v, layers, model)
    fit = solve_least_squares(matrix, f)
    predicted = matrix @ fit.parameters
    predicted.setflags(write=False)
    return OfflineIdentification(
        model=model,
        layers=tuple(_layer(fit, i, span, model) for i, span in enumerate(layers)),
        rank=fit.rank,
        condition_number=fit.condition_number,
        rmse_N=fit.rmse,
        predicted_force_N=predicted,
    )
