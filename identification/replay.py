"""A whole recording through the online identifier."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import uniform_filter1d

from identification.default_config import DEFAULT, DefaultConfig
from identification.errors import InvalidLogError
from identification.estimate import Estimate, LayerEstimate
from identification.identifier import Identifier
from identification.paper_config import PaperConfig
from identification.sign_hints import sign_hints

_SPEED_WINDOW_S = 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class Replay:
    """Online estimates of a recording.

    Attributes:
        t_s: Time stamps of the recording, shape (n,), read-only.
        estimates: One per row.
        layers: Layers left, as known at the end.
        hints: Suspicions about signs and units.
    """

    t_s: NDArray[np.float64]
    estimates: tuple[Estimate, ...]
    layers: tuple[LayerEstimate, ...]
    hints: tuple[str, ...]


def replay(
    t_s: ArrayLike,
    depth_m: ArrayLike,
    force_N: ArrayLike,
    speed_m_s: ArrayLike | None = None,
    config: DefaultConfig | PaperConfig = DEFAULT,
    advance: Callable[[int], None] | None = None,
) -> Replay:
    """Run the identifier over a recording, sample by sample.

    Rows that cannot be used (gaps, time running backwards) are reported in their estimate's
    status, not dropped.

    Args:
        t_s: Time stamps [s], shape (n,).
        depth_m: Tip depth, growing into the tissue [m], shape (n,).
        force_N: Axial force, positive when tissue pushes back [N], shape (n,).
        speed_m_s: Rate of depth [m/s]; differentiated from depth if None.
        config: `DEFAULT`, `PAPER` or a variant.
        advance: Called with the number of rows done since the last call.

    Raises:
        InvalidLogError: Empty or ragged columns.
    """
    t = _column("t_s", t_s, None)
    z, f = _column("depth_m", depth_m, len(t)), _column("force_N", force_N, len(t))
    given = None if speed_m_s is None else _column("speed_m_s", speed_m_s, len(t))
    v = derived_speed_m_s(t, z) if given is None else given
    steps = np.diff(t)
    usual = float(np.median(steps[steps > 0])) if np.any(steps > 0) else 1e-3
    dt = np.concatenate(([usual], steps))
    identifier, estimates = Identifier(config), []
    for row in zip(z.tolist(), v.tolist(), f.tolist(), dt.tolist(), strict=True):
        estimates.append(identifier.update(*row))
        if advance is not None and len(estimates) % 1000 == 0:
            advance(1000)
    t.setflags(write=False)
    return Replay(
        t_s=t,
        estimates=tuple(estimates),
        layers=identifier.layers,
        hints=sign_hints(z, given, f),
    )


def derived_speed_m_s(
    t_s: NDArray[np.float64], depth_m: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Speed from depth: difference quotient over 50 ms, centred; shape (n,)."""
    if len(t_s) < 2:
        return np.zeros(len(t_s))
    steps = np.diff(t_s)
    usual = max(float(np.median(steps)), 1e-9)
    rate = np.diff(depth_m) / np.where(steps > 0.0, steps, usual)
    rate = np.concatenate((rate[:1], rate))
    width = max(round(_SPEED_WINDOW_S / usual), 1)
    is_known = np.isfinite(rate)
    total = uniform_filter1d(np.where(is_known, rate, 0.0), width, mode="nearest")
    share = uniform_filter1d(is_known.astype(float), width, mode="nearest")
    return np.where(share > 0.0, total / np.maximum(share, 1e-12), np.nan)


def _column(name: str, values: ArrayLike, length: int | None) -> NDArray[np.float64]:
    column = np.array(values, dtype=float)
    if column.ndim != 1 or column.size == 0:
        raise InvalidLogError(
            f"{name} must be a non-empty vector, got shape {column.shape}; one value per row"
        )
    if length is not None and len(column) != length:
        raise InvalidLogError(f"{name} has {len(column)} rows where t_s has {length}")
    return column
