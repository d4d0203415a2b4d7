"""Offline identification of known layers (Section II) by least squares.

Resisting force is positive here; the paper's minus signs are part of that convention.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from foundation.arrays import Array
from identification.config import Model
from identification.errors import (
    RIGHT_SPANS,
    InvalidConfigError,
    InvalidLogError,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class LayerSpan:
    """Where and when one layer acts on the needle, known beforehand.

    Without a membrane it ruptures as the tip leaves it; with one earlier or later.

    Attributes:
        start_s: Instant t_i at which the tip enters the layer.
        start_depth_m: Depth of the tip at that instant.
        thickness_m: Thickness d_i along the insertion axis.
        rupture_s: Instant t_r at which the layer stops pushing back elastically.
    """

    start_s: float
    start_depth_m: float
    thickness_m: float
    rupture_s: float

    def __post_init__(self) -> None:
        """Raise `InvalidConfigError` unless thickness and duration are positive."""
        values = (self.start_s, self.start_depth_m, self.thickness_m, self.rupture_s)
        is_possible = self.thickness_m > 0 and self.rupture_s > self.start_s
        if not (is_possible and np.all(np.isfinite(values))):
            raise InvalidConfigError(
                "a layer must have a positive, finite thickness_m and rupture after "
                f"its start, got {self}",
                RIGHT_SPANS,
            )


def regression_matrix(
    t_s: Array,
    depth_m: Array,
    speed_m_s: Array,
    layers: Sequence[LayerSpan],
    model: Model = "ml",
) -> Array:
    """Return Phi = [phi_K1 phi_B1 ... phi_Kl phi_Bl] of equation (5).

    The l layers stand in the order of entry.
    phi_K of equation (4) is dz_i between entry and rupture, zero elsewhere. phi_B is,
    from entry on, for `ml` embedded length times speed: dz_i inside the layer and d_i
    beyond it, which is (4); during withdrawal it shrinks, which (4) leaves open. For
    `kv` it is the speed, as long as the tip is deeper than the entry. Columns have
    shape (n,).

    Returns:
        Shape (n, 2 l); parameters in the order K_1, B_1, ..., K_l, B_l.

    Raises:
        InvalidConfigError: Unknown model, or no layer at all.
    """
    if model not in ("ml", "kv"):
        raise InvalidConfigError(f"unknown model {model!r}; choose 'ml' or 'kv'")
    if not layers:
        raise InvalidConfigError(
            "at least one layer is needed to build a regression matrix",
            RIGHT_SPANS,
        )
    columns = []
    for layer in layers:
        reach_m = depth_m - layer.start_depth_m
        is_entered = t_s > layer.start_s
        is_acting = is_entered & (t_s <= layer.rupture_s)
        columns.append(np.where(is_acting, np.maximum(reach_m, 0.0), 0.0))
        embedded = (
            np.clip(reach_m, 0.0, layer.thickness_m) if model == "ml" else reach_m > 0.0
        )
        columns.append(np.where(is_entered, embedded, 0.0) * speed_m_s)
    return np.column_stack(columns)


def read_column(
    name: str, values: ArrayLike, rows: int | None = None, *, finite: bool = False
) -> Array:
    """Return a column as a float array of its own, shape (n,).

    Raises:
        InvalidLogError: Not a vector of real numbers, an empty one, or not as expected.
    """
    try:
        if np.iscomplexobj(values):
            raise TypeError("its numbers are complex")
        column = np.array(values, dtype=float)
    except (TypeError, ValueError, OverflowError) as error:
        raise InvalidLogError(f"{name} is not a vector of numbers: {error}") from error
    if column.ndim != 1 or column.size == 0:
        raise InvalidLogError(
            f"{name} must be a non-empty vector, got shape {column.shape}; "
            "one value per row"
        )
    if rows is not None and len(column) != rows:
        raise InvalidLogError(f"{name} has {len(column)} rows where t_s has {rows}")
    bad = np.flatnonzero(~np.isfinite(column))
    if finite and len(bad):
        raise InvalidLogError(
            f"{name} is not finite at row {bad[0]} ({len(bad)} in all)"
        )
    return column


@dataclass(frozen=True, slots=True, kw_only=True)
class OfflineLayer:
    """One layer identified offline.

    Attributes:
        stiffness_N_per_m: K_i.
        stiffness_std_N_per_m: Its standard deviation, infinite where not identified.
        stiffness_identified: Whether the data separate it from the other parameters.
        friction: B_i [Ns/m^2] for `ml`, [Ns/m] for `kv`.
        friction_std: Its standard deviation, infinite where not identified.
        friction_identified: Whether the data separate it from the other parameters.
        cumulative_friction_Ns_per_m: B_i d_i for `ml` (the values of Table I), B_i for
            `kv`.
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
        model: Model of the force.
        layers: In order of entry.
        rank: Of the scaled regression matrix.
        rmse_N: Root mean square reconstruction error.
        predicted_force_N: Reconstruction Phi theta, shape (n,), read-only.
    """

    model: Model
    layers: tuple[OfflineLayer, ...]
    rank: int
    rmse_N: float
    predicted_force_N: Array


def identify_offline(
    t_s: ArrayLike,
    depth_m: ArrayLike,
    speed_m_s: ArrayLike,
    force_N: ArrayLike,
    layers: Sequence[LayerSpan],
    model: Model = "ml",
) -> OfflineIdentification:
    """Identify stiffness and friction of known layers, equations (4) to (6).

    At constant speed the columns of one layer are proportional as long as the tip is
    inside it: only data beyond its rupture separate its stiffness from its friction.
    Where they are missing both are marked as not identified; the values given are then
    the minimum-norm choice.

    Args:
        t_s: Increasing time [s], shape (n,).
        depth_m: Tip depth since first contact [m], shape (n,).
        speed_m_s: Rate of depth [m/s], shape (n,).
        force_N: Axial force, positive when tissue pushes back [N], shape (n,).
        layers: Known layers in order of entry.
        model: `ml`, equation (3), or `kv`, equation (2).

    Returns:
        Parameters per layer with standard deviations, rank, reconstruction.

    Raises:
        InvalidLogError: Empty, ragged, non-finite or unordered columns.
        InvalidConfigError: No layer, or an unknown model.
    """
    times_s = read_column("t_s", t_s, finite=True)
    if np.any(np.diff(times_s) <= 0):
        raise InvalidLogError("t_s falls or repeats, expected times that increase")
    rows = len(times_s)
    depths_m = read_column("depth_m", depth_m, rows, finite=True)
    speeds_m_s = read_column("speed_m_s", speed_m_s, rows, finite=True)
    forces_N = read_column("force_N", force_N, rows, finite=True)
    matrix = regression_matrix(times_s, depths_m, speeds_m_s, layers, model)
    # theta = Phi^# f, equation (6), on columns scaled to unit length.
    norms = np.linalg.norm(matrix, axis=0)
    scale = np.where(norms > 0, norms, 1.0)
    scaled = matrix / scale
    # A difference between columns under 0.1 % is smaller than any linear tissue model
    # is right: singular values below this fraction of the largest count as zero.
    inverse = np.asarray(np.linalg.pinv(scaled, rcond=1e-3), dtype=np.float64)
    solution = inverse @ forces_N
    parameters = solution / scale
    residual_N = forces_N - scaled @ solution
    determined = np.diag(inverse @ scaled)  # of a projection, whose trace is the rank
    # Identified: at most a twentieth of it lies in directions that the data leave free.
    are_identified = (1.0 - determined < 0.05**2) & (norms > 0)
    stds = np.where(
        are_identified, _deviations(scaled, inverse, residual_N) / scale, np.inf
    )
    predicted_N = matrix @ parameters
    predicted_N.setflags(write=False)
    return OfflineIdentification(
        model=model,
        layers=tuple(
            OfflineLayer(
                stiffness_N_per_m=float(values[0]),
                stiffness_std_N_per_m=float(value_stds[0]),
                stiffness_identified=bool(are_known[0]),
                friction=float(values[1]),
                friction_std=float(value_stds[1]),
                friction_identified=bool(are_known[1]),
                cumulative_friction_Ns_per_m=float(values[1])
                * (layer.thickness_m if model == "ml" else 1),
            )
            for layer, values, value_stds, are_known in zip(
                layers,
                parameters.reshape(-1, 2),
                stds.reshape(-1, 2),
                are_identified.reshape(-1, 2),
                strict=True,
            )
        ),
        rank=round(float(determined.sum())),
        rmse_N=float(np.sqrt(np.mean((forces_N - predicted_N) ** 2))),
        predicted_force_N=predicted_N,
    )


def _deviations(scaled: Array, inverse: Array, residual_N: Array) -> Array:
    """Return standard deviations of the scaled parameters, shape (p,).

    Sandwich covariance over contiguous blocks: residuals of tissue are far from white.

    Args:
        scaled: Matrix with columns of unit length, shape (n, p).
        inverse: Its pseudo-inverse, shape (p, n).
        residual_N: Force that the parameters leave, shape (n,).
    """
    blocks = min(60, len(residual_N))  # that count as independent
    edges = np.linspace(0, len(residual_N), blocks + 1).astype(int)
    scores = np.add.reduceat(scaled * residual_N[:, None], edges[:-1], axis=0)
    squared = inverse @ inverse.T
    covariance = squared @ (scores.T @ scores) @ squared
    return np.sqrt(np.maximum(np.diag(covariance), 0.0))
