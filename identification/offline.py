"""Offline identification with known layers and ruptures (Section II)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from identification.errors import InvalidLogError
from identification.least_squares import LeastSquaresFit, solve_least_squares
from identification.log_column import read_column
from identification.regressor import LayerSpan, Model, regression_matrix


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
        cumulative_friction_Ns_per_m: Share of this layer in the cumulative friction: B_i d_i for
            `ml` (the figures of Table I), B_i for `kv`.
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
