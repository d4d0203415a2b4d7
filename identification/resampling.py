"""Samples at a fixed resolution: blocks of time, points of the last millimetres, rows of a layer.

A block is a mean over a few milliseconds, the clock of detection whatever the sample rate. Its
speed is corrected for the lag of the measurement: a speed that went through a low-pass of time
constant T obeys v = s + T ds/dt exactly, with s the low-pass's output; so the depth less the
integral of s is T s and a constant. Whenever the needle changes its speed, T shows. A detector
that does not know of the lag takes the friction lost while the needle slows down for a rupture:
force falls at once, the speed it is given later.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from identification.friction_compensation import MultilayerMemory

_ROUNDING = 1e-6
_WINDOW_S = 0.1
_MEMORY = 0.998
"""Kept per window: a minute."""
_LEAST_WINDOWS = 5.0
_SIGNIFICANT = 4.0
_LEAST_LAG_S = 5e-3
_MOST_LAG_S = 0.25
"""A speed later than that is no speed of this needle."""

Array = NDArray[np.float64]


class Block(NamedTuple):
    """Mean of the samples of one short interval."""

    time_s: float  # End of the interval
    dt_s: float  # Length of the interval
    depth_m: float  # Mean depth
    speed_m_s: float  # Mean speed
    force_N: float  # Mean force
    bristle: float  # Presliding deflection at its end, -1 to 1


def least_block_s(block_s: float) -> float:
    """Length from which on a block is full: a hair less than wanted, for sums round.

    Sparse samples make blocks of one sample each.
    """
    return block_s * (1.0 - _ROUNDING)


def mean_block(memory: MultilayerMemory, time_s: float) -> Block:
    """The block that has been filled."""
    length = memory.filled_s
    means = (memory.depth_sum / length, memory.speed_sum / length, memory.force_sum / length)
    return Block(time_s, length, *means, memory.bristle)


class LagEvidence(NamedTuple):
    """Sums over windows of a tenth of a second, from which the lag follows."""

    # Of the newest window: depth less the integral of the speed; None without one
    mean_gap_m: float | None = None
    mean_speed_m_s: float = 0.0  # Of that window
    cross: float = 0.0  # Sum of changes of gap times changes of speed
    square: float = 0.0  # Sum of squared changes of speed
    residual: float = 0.0  # Sum of squared changes of gap
    windows: float = 0.0  # How many windows are in these sums


class SpeedLag(NamedTuple):
    """What is known of the lag of the speed behind the depth."""

    lag_s: float = 0.0  # Time constant of the low-pass; 0 while none is significant
    last: Block | None = None  # Newest block, lag and all; None at the start and after a gap
    gap_m: float = 0.0  # Depth less the integral of the speed
    gap_sum: float = 0.0  # Integral of the gap over the window being filled
    speed_sum: float = 0.0  # Integral of the speed over it
    time_s: float = 0.0  # Length of that window so far
    evidence: LagEvidence = LagEvidence()  # Of the windows before


def update_lag(state: SpeedLag, block: Block) -> tuple[SpeedLag, Block]:
    """Use one block and return it with the speed the needle had, not the one measured."""
    lag, last, gap, gap_sum, speed_sum, time, evidence = state
    if last is None:
        return SpeedLag(lag, block, gap, evidence=evidence._replace(mean_gap_m=None)), block
    step, speed = block.dt_s, block.speed_m_s
    dt = 0.5 * (step + last.dt_s)
    gap += block.depth_m - last.depth_m - 0.5 * (speed + last.speed_m_s) * dt
    time += step
    gap_sum += gap * step
    speed_sum += speed * step
    if time >= _WINDOW_S:
        evidence = _add_window(evidence, gap_sum / time, speed_sum / time)
        lag = _significant_lag(evidence)
        gap_sum = speed_sum = time = 0.0
    state = SpeedLag(lag, block, gap, gap_sum, speed_sum, time, evidence)
    if lag == 0.0:
        return state, block
    return state, block._replace(speed_m_s=speed + lag * (speed - last.speed_m_s) / dt)


def _add_window(known: LagEvidence, gap_m: float, speed_m_s: float) -> LagEvidence:
    if known.mean_gap_m is None:
        return known._replace(mean_gap_m=gap_m, mean_speed_m_s=speed_m_s)
    gap, speed = gap_m - known.mean_gap_m, speed_m_s - known.mean_speed_m_s
    return LagEvidence(
        gap_m,
        speed_m_s,
        _MEMORY * known.cross + gap * speed,
        _MEMORY * known.square + speed * speed,
        _MEMORY * known.residual + gap * gap,
        _MEMORY * known.windows + 1.0,
    )


def _significant_lag(known: LagEvidence) -> float:
    """Least-squares slope of gap over speed, if chance does not explain it."""
    if known.windows < _LEAST_WINDOWS or known.square <= 0.0:
        return 0.0
    lag = known.cross / known.square
    left = max(known.residual - lag * known.cross, 0.0) / (known.windows - 1.0)
    is_significant = lag > _LEAST_LAG_S and lag * lag * known.square > _SIGNIFICANT**2 * left
    return min(lag, _MOST_LAG_S) if is_significant else 0.0


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
