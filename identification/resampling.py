"""The last millimetres of the insertion at a fixed resolution of travel."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from identification.friction_compensation import MultilayerUpdate

# Means over a few milliseconds: the clock of detection, whatever the sample rate.


_ROUNDING = 1e-6


class Block(NamedTuple):
    """Mean of the samples of one short interval.

    Attributes:
        time_s: End of the interval.
        dt_s: Length of the interval.
        depth_m: Mean depth.
        speed_m_s: Mean speed.
        force_N: Mean force.
        bristle: Presliding deflection at its end, -1 to 1.
    """

    time_s: float
    dt_s: float
    depth_m: float
    speed_m_s: float
    force_N: float
    bristle: float

    def less(self, offset_N: float) -> "Block":
        """With an offset taken out of the force."""
        time_s, dt_s, depth_m, speed_m_s, force_N, bristle = self
        return Block(time_s, dt_s, depth_m, speed_m_s, force_N - offset_N, bristle)


def is_block_full(filled_s: float, block_s: float) -> bool:
    """Whether a block is long enough; sparse samples make blocks of one sample each."""
    return filled_s >= least_block_s(block_s)


def least_block_s(block_s: float) -> float:
    """Length from which on a block is full: a hair less than wanted, for sums round."""
    return block_s * (1.0 - _ROUNDING)


def mean_block(tick: MultilayerUpdate, time_s: float) -> Block:
    """The block that has been filled."""
    length = tick.filled_s
    means = (tick.depth_sum / length, tick.speed_sum / length, tick.force_sum / length)
    return Block(time_s, length, *means, tick.bristle)


def emptied(tick: MultilayerUpdate) -> MultilayerUpdate:
    """To begin the next block with."""
    return MultilayerUpdate(0.0, 0.0, 0.0, 0.0, *tick[4:])


LENGTH = 512
DEPTH, SPEED, FORCE, BRISTLE, BLOCKS, TRAVEL = range(6)


class Track(NamedTuple):
    """Points of the recent past, newest last.

    Attributes:
        points: Shape (n, 6), n up to `LENGTH`: depth [m], speed [m/s], force [N], bristle,
            number of blocks averaged, travel since the previous point [m].
        sums: The point being filled: sums of depth, speed, force, bristle, blocks.
        from_m: Depth at which the previous point was closed.
    """

    points: NDArray[np.float64]
    sums: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    from_m: float | None = None


def initial_track() -> Track:
    """No points yet."""
    return Track(np.empty((0, 6)))


def track_step(
    track: Track, block: Block, step_m: float
) -> tuple[Track, NDArray[np.float64] | None]:
    """Add one forward-moving block; hand out the point once it spans `step_m` of travel."""
    start = block.depth_m if track.from_m is None else track.from_m
    z, v, f, w, n = track.sums
    sums = (
        z + block.depth_m,
        v + block.speed_m_s,
        f + block.force_N,
        w + block.bristle,
        n + 1.0,
    )
    travel = block.depth_m - start
    if travel < step_m:
        return Track(track.points, sums, start), None
    z, v, f, w, n = sums
    point = np.array((z / n, v / n, f / n, w / n, n, travel))
    kept = track.points[-(LENGTH - 1) :]
    points = np.empty((len(kept) + 1, kept.shape[1]))
    points[:-1], points[-1] = kept, point
    points.setflags(write=False)
    return Track(points, from_m=block.depth_m), point


# The whole current layer at a coarse resolution of travel, in bounded memory.


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
