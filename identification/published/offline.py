"""Offline identification of known layers (Section II): force models, regressors, least
squares.

Resisting force is positive here; the paper's minus signs are part of that convention.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from identification.config import Model
from identification.errors import InvalidConfigError, InvalidLogError
from identification.estimate import Array

RANK_TOLERANCE = 1e-3
"""Singular values of the scaled columns below this fraction of the largest count as
zero: a difference between columns under 0.1 % is smaller than any linear tissue model
is right."""
_FREE_FRACTION = 0.05
_BLOCKS = 60


@dataclass(frozen=True, slots=True, kw_only=True)
class LayerSpan:
    """Where and when one layer acts on the needle, known beforehand in the offline
    analysis.

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
        """Raise `InvalidConfigError` unless thickness is positive and times are
        ordered.
        """
        values = (self.start_s, self.start_depth_m, self.thickness_m, self.rupture_s)
        if not np.all(np.isfinite(values)):
            raise InvalidConfigError(f"layer span has non-finite values: {values}")
        if self.thickness_m <= 0:
            raise InvalidConfigError(
                f"thickness_m must be positive, got {self.thickness_m}"
            )
        if self.rupture_s <= self.start_s:
            raise InvalidConfigError(
                f"a layer must rupture after it starts: start {self.start_s} s, "
                f"rupture {self.rupture_s} s"
            )


def regression_matrix(
    t_s: Array,
    depth_m: Array,
    speed_m_s: Array,
    layers: Sequence[LayerSpan],
    model: Model = "ml",
) -> Array:
    """Matrix Phi = [phi_K1 phi_B1 ... phi_Kl phi_Bl] of equation (5), the l layers as
    entered.

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
            "at least one layer is needed to build a regression matrix"
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


def solve_least_squares(
    matrix: Array, target: Array
) -> tuple[Array, Array, NDArray[np.bool_], int]:
    """Solve theta = Phi^# f, equation (6), on columns scaled to unit length.

    Autocorrelated residuals are allowed for in the standard deviations.

    Returns:
        The solution of minimum norm in scaled columns, shape (p,); standard deviations,
        infinite where the data leave a parameter free; where they do not; rank of the
        scaled matrix.
    """
    scale = np.linalg.norm(matrix, axis=0)
    safe = np.where(scale > 0, scale, 1.0)
    scaled = matrix / safe
    inverse = np.linalg.pinv(scaled, rcond=RANK_TOLERANCE)
    solution = inverse @ target
    residual = target - scaled @ solution
    squared = inverse @ inverse.T
    # Sandwich covariance over contiguous blocks: residuals of tissue are far from
    # white.
    edges = np.linspace(0, len(residual), min(_BLOCKS, len(residual)) + 1).astype(int)
    scores = np.add.reduceat(scaled * residual[:, None], edges[:-1], axis=0)
    covariance = squared @ (scores.T @ scores) @ squared
    determined = np.diag(inverse @ scaled)  # of a projection, whose trace is the rank
    identified = (1.0 - determined < _FREE_FRACTION**2) & (scale > 0)
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0)) / safe
    std = np.where(identified, deviation, np.inf)
    return solution / safe, std, identified, round(float(determined.sum()))


def read_column(
    name: str, values: ArrayLike, rows: int | None = None, *, finite: bool = False
) -> Array:
    """A column as a float array of its own, shape (n,).

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
            f"{name} must be a non-empty vector, got shape {column.shape}; one value per row"
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
    """One layer identified offline; standard deviations are infinite where not
    identified.

    Attributes:
        stiffness_N_per_m: K_i.
        stiffness_identified: Whether the data separate it from the other parameters.
        friction: B_i [Ns/m^2] for `ml`, [Ns/m] for `kv`.
    """

    stiffness_N_per_m: float
    stiffness_std_N_per_m: float
    stiffness_identified: bool
    friction: float
    friction_std: float
    friction_identified: bool
    cumulative_friction_Ns_per_m: (
        float  # B_i d_i for `ml` (the values of Table I), B_i for `kv`
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OfflineIdentification:
    """Result of equation (6) over one recording.

    Attributes:
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
    t = read_column("t_s", t_s, finite=True)
    if np.any(np.diff(t) <= 0):
        raise InvalidLogError(
            "t_s must increase; sort the recording or drop repeated samples"
        )
    others = {"depth_m": depth_m, "speed_m_s": speed_m_s, "force_N": force_N}
    z, v, f = (read_column(name, others[name], len(t), finite=True) for name in others)
    matrix = regression_matrix(t, z, v, layers, model)
    *columns, rank = solve_least_squares(matrix, f)
    predicted = matrix @ columns[0]
    predicted.setflags(write=False)
    found = []
    for k, span in enumerate(layers):
        (stiffness, friction), stds, known = (
            each[2 * k : 2 * k + 2].tolist() for each in columns
        )
        found.append(
            OfflineLayer(
                stiffness_N_per_m=stiffness,
                stiffness_std_N_per_m=stds[0],
                stiffness_identified=known[0],
                friction=friction,
                friction_std=stds[1],
                friction_identified=known[1],
                cumulative_friction_Ns_per_m=friction
                * (span.thickness_m if model == "ml" else 1),
            )
        )
    return OfflineIdentification(
        model=model,
        layers=tuple(found),
        rank=rank,
        rmse_N=float(np.sqrt(np.mean((f - predicted) ** 2))),
        predicted_force_N=predicted,
    )
