"""Sums of all reset windows of a layer, kept so that a re-run needs no samples."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from identification.window_sums import WindowSums

_CHUNK = 16
_KF, _BF, _KV, _BV = (WindowSums._fields.index(name) for name in ("kf", "bf", "kv", "bv"))


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
    """All windows, one row each, shape (m, 7); not to be written to."""
    if len(history.chunks) == 1 and not history.recent:
        return history.chunks[0]
    parts = [*history.chunks, np.array(history.recent).reshape(-1, len(WindowSums._fields))]
    return np.concatenate(parts)


def joined(history: WindowHistory) -> WindowHistory:
    """The same windows in one piece, field by field: what a later re-run need not do."""
    rows = np.asfortranarray(window_rows(history))
    return WindowHistory((_frozen(rows),) if len(rows) else ())


def add_neighbours(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Halve the number of windows by adding neighbours: bounds memory in an endless layer.

    The re-run then resets half as often over that stretch; an odd last window stays alone.
    """
    even = len(rows) // 2 * 2
    return np.concatenate((rows[0:even:2] + rows[1:even:2], rows[even:]))


def less_viscous_rows(history: WindowHistory, damping_Ns_per_m: float) -> WindowHistory:
    """Windows as if ``damping_Ns_per_m * v`` had been subtracted from every force sample."""
    rows = np.array(window_rows(history), order="F")
    rows[:, _KF] -= damping_Ns_per_m * rows[:, _KV]
    rows[:, _BF] -= damping_Ns_per_m * rows[:, _BV]
    return WindowHistory((_frozen(rows),) if len(rows) else ())


def _frozen(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    rows.setflags(write=False)
    return rows
