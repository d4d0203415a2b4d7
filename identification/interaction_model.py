"""Force models of the paper and their regressors, equations (1) to (5).

Resisting force is positive here; the paper's minus signs are part of that convention.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from identification.errors import InvalidConfigError

Model = Literal["ml", "kv"]
"""`ml`: multi-layer, equation (3); `kv`: Kelvin-Voigt, equation (2)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LayerSpan:
    """Where and when one layer acts on the needle, known beforehand in the offline analysis.

    Attributes:
        start_s: Instant t_i at which the tip enters the layer.
        start_depth_m: Depth of the tip at that instant.
        thickness_m: Thickness d_i along the insertion axis.
        rupture_s: Instant t_r at which the layer stops pushing back elastically. Without a
            membrane it is the instant the tip leaves the layer; with one it is earlier or later.
    """

    start_s: float
    start_depth_m: float
    thickness_m: float
    rupture_s: float

    def __post_init__(self) -> None:
        """Raise `InvalidConfigError` unless thickness is positive and times are ordered."""
        values = (self.start_s, self.start_depth_m, self.thickness_m, self.rupture_s)
        if not np.all(np.isfinite(values)):
            raise InvalidConfigError(f"layer span has non-finite values: {values}")
        if self.thickness_m <= 0:
            raise InvalidConfigError(f"thickness_m must be positive, got {self.thickness_m}")
        if self.rupture_s <= self.start_s:
            raise InvalidConfigError(
                f"a layer must rupture after it starts: start {self.start_s} s, "
                f"rupture {self.rupture_s} s"
            )


def elastic_column(
    t_s: NDArray[np.float64], depth_m: NDArray[np.float64], layer: LayerSpan
) -> NDArray[np.float64]:
    """Column phi_K of equation (4): dz_i between entry and rupture, zero elsewhere. Shape (n,)."""
    acting = (t_s > layer.start_s) & (t_s <= layer.rupture_s)
    return np.where(acting, np.maximum(depth_m - layer.start_depth_m, 0.0), 0.0)


def friction_column(
    t_s: NDArray[np.float64],
    depth_m: NDArray[np.float64],
    speed_m_s: NDArray[np.float64],
    layer: LayerSpan,
    model: Model,
) -> NDArray[np.float64]:
    """Column phi_B of equation (4). Shape (n,).

    `ml`: embedded length times speed. During an insertion the embedded length is dz_i inside the
    layer and d_i beyond it, which is (4); during withdrawal it shrinks, which (4) leaves open.
    `kv`: the speed, from entry on and as long as the tip is deeper than the entry.
    """
    reach_m = depth_m - layer.start_depth_m
    if model == "kv":
        return np.where((t_s > layer.start_s) & (reach_m > 0), speed_m_s, 0.0)
    return np.where(t_s > layer.start_s, np.clip(reach_m, 0.0, layer.thickness_m), 0.0) * speed_m_s


def regression_matrix(
    t_s: NDArray[np.float64],
    depth_m: NDArray[np.float64],
    speed_m_s: NDArray[np.float64],
    layers: Sequence[LayerSpan],
    model: Model = "ml",
) -> NDArray[np.float64]:
    """Matrix Phi = [phi_K1 phi_B1 ... phi_Kl phi_Bl] of equation (5).

    Args:
        t_s: Time [s], shape (n,).
        depth_m: Tip depth [m], shape (n,).
        speed_m_s: Rate of depth [m/s], shape (n,).
        layers: The l layers in order of entry.
        model: `ml` or `kv`.

    Returns:
        Shape (n, 2 l); parameters in the order K_1, B_1, ..., K_l, B_l.

    Raises:
        InvalidConfigError: Unknown model, or no layer at all.
    """
    if model not in ("ml", "kv"):
        raise InvalidConfigError(f"unknown model {model!r}; choose 'ml' or 'kv'")
    if not layers:
        raise InvalidConfigError("at least one layer is needed to build a regression matrix")
    columns = []
    for layer in layers:
        columns.append(elastic_column(t_s, depth_m, layer))
        columns.append(friction_column(t_s, depth_m, speed_m_s, layer, model))
    return np.column_stack(columns)
