"""The last millimetres of the insertion at a fixed resolution of travel."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from identification.block import Block

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
