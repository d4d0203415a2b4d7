"""Sums of all reset windows of a layer, kept so that a re-run takes microseconds.

A window of the re-run maps the estimate linearly, theta+ = A theta + c. Maps one after the other
are one map, and composing them pair by pair takes a few array operations for thousands of windows.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from identification.window_sums import WindowSums

_CHUNK = 16


class WindowHistory(NamedTuple):
    """Windows in order of time; immutable, and appending copies only what is recent.

    Attributes:
        chunks: Older windows, one row each: the fields of `WindowSums`; shape (m, 7).
        recent: The newest ones.
    """

    chunks: tuple[NDArray[np.float64], ...] = ()
    recent: tuple[WindowSums, ...] = ()


def append_window(history: WindowHistory, sums: WindowSums, most: int) -> WindowHistory:
    """Add a closed window; beyond ``most`` neighbours are added up, see `add_neighbours`."""
    recent = (*history.recent, sums)
    if len(recent) < _CHUNK:
        return WindowHistory(history.chunks, recent)
    chunks = (*history.chunks, _frozen(np.array(recent)))
    if sum(map(len, chunks)) > most:
        chunks = (_frozen(add_neighbours(np.concatenate(chunks))),)
    return WindowHistory(chunks)


def window_rows(history: WindowHistory) -> NDArray[np.float64]:
    """All windows, one row each, shape (m, 7)."""
    parts = [*history.chunks, np.array(history.recent).reshape(-1, len(WindowSums._fields))]
    return np.concatenate(parts)


def add_neighbours(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Halve the number of windows by adding neighbours: bounds memory in an endless layer.

    The re-run then resets half as often over that stretch; an odd last window stays alone.
    """
    even = len(rows) // 2 * 2
    return np.concatenate((rows[0:even:2] + rows[1:even:2], rows[even:]))


def less_viscous_rows(history: WindowHistory, damping_Ns_per_m: float) -> WindowHistory:
    """Windows as if ``damping_Ns_per_m * v`` had been subtracted from every force sample."""
    rows = window_rows(history)
    kf, bf, kv, bv = (WindowSums._fields.index(name) for name in ("kf", "bf", "kv", "bv"))
    rows[:, kf] -= damping_Ns_per_m * rows[:, kv]
    rows[:, bf] -= damping_Ns_per_m * rows[:, bv]
    return WindowHistory((_frozen(rows),) if len(rows) else ())


def rerun_history(
    history: WindowHistory,
    variances: tuple[float, float],
    theta: tuple[float, float] = (0.0, 0.0),
) -> tuple[float, float]:
    """Re-run RLS with covariance resetting over a whole layer (Section III-B).

    Args:
        history: Windows of the layer.
        variances: Diagonal of the (re-weighted) Psi_0, restored at each window's start.
        theta: Estimate at the start of the layer.

    Returns:
        (K, B), the same as the sample-by-sample re-run up to rounding.
    """
    rows = window_rows(history)
    if not len(rows):
        return theta
    maps = _window_maps(rows, variances)
    while (count := maps.shape[2]) > 1:
        even = count // 2 * 2
        pairs = _composed(maps[:, :, 1:even:2], maps[:, :, 0:even:2])
        maps = pairs if even == count else np.concatenate((pairs, maps[:, :, even:]), axis=2)
    stiffness, friction = maps[:, :2, 0] @ np.array(theta) + maps[:, 2, 0]
    return float(stiffness), float(friction)


def _composed(later: NDArray[np.float64], earlier: NDArray[np.float64]) -> NDArray[np.float64]:
    """Each of `earlier` and after it its neighbour in `later`, as one map; shapes (2, 3, n)."""
    pairs = later[:, 0, None] * earlier[0] + later[:, 1, None] * earlier[1]
    pairs[:, 2] += later[:, 2]
    return pairs


def _window_maps(rows: NDArray[np.float64], variances: tuple[float, float]) -> NDArray[np.float64]:
    """Each window's A and c side by side, shape (2, 3, m): `window_step` written out."""
    p, q = variances
    kk, kb, bb, kf, bf = np.ascontiguousarray(rows.T[:5])
    first, second = 1.0 + q * bb, 1.0 + p * kk
    excitation = np.maximum(kk * bb - kb * kb, 0.0)
    share = 1.0 / (second + q * bb + (p * q) * excitation)
    maps = np.empty((2, 3, len(rows)))
    maps[0, 0], maps[0, 1] = first * share, -p * kb * share
    maps[1, 0], maps[1, 1] = -q * kb * share, second * share
    maps[0, 2] = p * (first * kf - q * kb * bf) * share
    maps[1, 2] = q * (second * bf - p * kb * kf) * share
    return maps


def _frozen(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    rows.setflags(write=False)
    return rows
