"""The whole current layer at a coarse resolution of travel, in bounded memory."""

import numpy as np
from numpy.typing import NDArray

from identification.track import BLOCKS, DEPTH

MOST_ROWS = 128
_SUMMED = BLOCKS
"""Columns from this one on (blocks, travel) add up, those before it are means."""
NO_ROWS = np.empty((0, 6))
"""A layer of which nothing is known."""
NO_ROWS.setflags(write=False)


def add_layer_row(rows: NDArray[np.float64], point: NDArray[np.float64]) -> NDArray[np.float64]:
    """Append a pooled point; when there are too many, neighbours are merged.

    Args:
        rows: Rows so far, shape (n, 6), columns as those of a track point.
        point: Newest one, shape (6,).
    """
    if len(rows) >= MOST_ROWS:
        rows = merge_rows(rows, 2)
    grown = np.vstack((rows, point))
    grown.setflags(write=False)
    return grown


def merge_rows(rows: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """Merge every `count` neighbours, from the newest back; older ones that do not fill up go.

    Args:
        rows: Shape (n, 6).
        count: Rows that become one.
    """
    kept = len(rows) // count * count
    groups = rows[len(rows) - kept :].reshape(-1, count, rows.shape[1])
    weight = groups[:, :, BLOCKS : BLOCKS + 1]
    total = weight.sum(axis=1)
    means = (groups[:, :, :_SUMMED] * weight).sum(axis=1) / total
    return np.hstack((means, groups[:, :, _SUMMED:].sum(axis=1)))


def rows_of_track(points: NDArray[np.float64], from_m: float, row_m: float) -> NDArray[np.float64]:
    """Rows of about `row_m` of travel each from the track beyond `from_m`."""
    side = points[points[:, DEPTH] > from_m]
    if len(side) == 0:
        return NO_ROWS
    travel = float(side[-1, DEPTH] - side[0, DEPTH])
    rows = merge_rows(side, max(round(len(side) * row_m / max(travel, row_m)), 1))
    rows.setflags(write=False)
    return rows
