"""Samples at a fixed resolution: blocks of time, points of the last millimetres, rows of a layer.

A block is a mean over a few milliseconds, the clock of detection whatever the sample rate.
"""

from typing import NamedTuple

import numpy as np

from identification.estimate import Array
from identification.friction_compensation import MultilayerMemory

_ROUNDING = 1e-6


class Block(NamedTuple):
    """Mean of the samples of one short interval."""

    time_s: float  # End of the interval
    dt_s: float  # Length of the interval
    depth_m: float  # Mean depth
    speed_m_s: float  # Mean speed
    force_N: float  # Mean force
    bristle: float  # Presliding deflection at its end, -1 to 1


def least_block_s(block_s: float) -> float:
    """Length from which on a block is full: a hair less than set, for sums round.

    Sparse samples make blocks of one sample each.
    """
    return block_s * (1.0 - _ROUNDING)


def mean_block(memory: MultilayerMemory, time_s: float) -> Block:
    """The block that has been filled."""
    length = memory.filled_s
    means = (memory.depth_sum / length, memory.speed_sum / length, memory.force_sum / length)
    return Block(time_s, length, *means, memory.bristle)


LENGTH = 512
DEPTH, SPEED, FORCE, BRISTLE, BLOCKS, TRAVEL = range(6)
"""Columns of points and rows."""
NO_ROWS = np.empty((0, 6))
"""No points, or a layer of which nothing is known."""
NO_ROWS.setflags(write=False)


class Track(NamedTuple):
    """Points of the recent past, newest last."""

    # Shape (n, 6), n up to `LENGTH`: depth [m], speed [m/s], force [N], bristle, number of blocks
    # averaged, travel since the previous point [m]
    points: Array = NO_ROWS
    # The point being filled: sums of depth, speed, force, bristle, blocks
    sums: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    from_m: float | None = None  # Depth at which the previous point was closed


def update_track(track: Track, block: Block, step_m: float) -> tuple[Track, Array | None]:
    """Add one forward-moving block; return the point once it spans `step_m` of travel."""
    start = block.depth_m if track.from_m is None else track.from_m
    z, v, f, w, n = track.sums
    z, v, f = z + block.depth_m, v + block.speed_m_s, f + block.force_N
    w, n = w + block.bristle, n + 1.0
    travel = block.depth_m - start
    if travel < step_m:
        return Track(track.points, (z, v, f, w, n), start), None
    point = np.array((z / n, v / n, f / n, w / n, n, travel))
    kept = track.points[-(LENGTH - 1) :]
    points = np.empty((len(kept) + 1, kept.shape[1]))
    points[:-1], points[-1] = kept, point
    points.setflags(write=False)
    return Track(points, from_m=block.depth_m), point


MOST_ROWS = 128
_SUMMED = BLOCKS
"""Columns from this one on (blocks, travel) add up, those before it are means."""


def add_layer_row(rows: Array, point: Array) -> Array:
    """Append a pooled point; when there are too many, neighbours are merged."""
    if len(rows) >= MOST_ROWS:
        rows = merge_rows(rows, 2)
    grown = np.vstack((rows, point))
    grown.setflags(write=False)
    return grown


def merge_rows(rows: Array, count: int) -> Array:
    """Merge every `count` neighbours, from the newest back; older ones that do not fill up go."""
    kept = len(rows) // count * count
    groups = rows[len(rows) - kept :].reshape(-1, count, rows.shape[1])
    weight = groups[:, :, BLOCKS : BLOCKS + 1]
    total = weight.sum(axis=1)
    means = (groups[:, :, :_SUMMED] * weight).sum(axis=1) / total
    return np.hstack((means, groups[:, :, _SUMMED:].sum(axis=1)))


def rows_of_track(points: Array, from_m: float, row_m: float) -> Array:
    """Rows of about `row_m` of travel each from the track beyond `from_m`."""
    side = points[points[:, DEPTH] > from_m]
    if len(side) == 0:
        return NO_ROWS
    travel = float(side[-1, DEPTH] - side[0, DEPTH])
    rows = merge_rows(side, max(round(len(side) * row_m / max(travel, row_m)), 1))
    rows.setflags(write=False)
    return rows
