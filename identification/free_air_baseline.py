"""What the force sensor reads while the needle touches nothing."""

import itertools
import math
from typing import NamedTuple

from identification.resampling import Block

SEGMENT_S = 0.25
"""Length of the means whose wander is learned."""
_MOST = 40
_LEAST = 4
_LOWER_HALF = 0.143
"""Mean of the lower half of a squared standard normal."""


class Segment(NamedTuple):
    """Mean of a quarter of a second.

    Attributes:
        force_N: Mean force.
        depth_m: Depth at its end.
    """

    force_N: float
    depth_m: float


class Baseline(NamedTuple):
    """Free-air force of the last ten seconds.

    Attributes:
        segments: Quarter-second means, newest last.
        sum_Ns: Integral of the force over the segment being filled.
        time_s: Length of that segment so far.
        offset_N: Mean force before contact, the paper's r_0 seen from the force side.
        variance: Mean square of the segments around it [N^2]: the sensor's slow error.
    """

    segments: tuple[Segment, ...] = ()
    sum_Ns: float = 0.0
    time_s: float = 0.0
    offset_N: float = 0.0
    variance: float = 0.0


def baseline_step(state: Baseline, block: Block) -> Baseline:
    """Absorb one block of free-air force."""
    total = state.sum_Ns + block.force_N * block.dt_s
    time = state.time_s + block.dt_s
    if time < SEGMENT_S:
        return state._replace(sum_Ns=total, time_s=time)
    segments = (*state.segments, Segment(total / time, block.depth_m))[-_MOST:]
    return state._replace(segments=segments, sum_Ns=0.0, time_s=0.0)


def level_score(state: Baseline, interval_s: float, noise_N2: float) -> float:
    """Newest segment's height above the older half, over the height chance would reach.

    Above 1, chance explains it less than once per `interval_s`. The spread comes from the
    differences between neighbours, which a slow rise hardly touches; it is widened while few
    segments are known, as Student's t is.

    Args:
        state: Free-air force.
        interval_s: Wanted time between false alarms.
        noise_N2: Variance that noise alone gives a segment.
    """
    forces = [segment.force_N for segment in state.segments]
    if len(forces) < _LEAST or state.time_s > 0.0:
        return 0.0
    half = forces[: len(forces) // 2]
    squared = 2.0 * math.log(max(interval_s / SEGMENT_S, math.e))
    squared *= 1.0 + squared / (2.0 * len(forces))
    spread = max(_neighbour_variance(forces), noise_N2) * (1.0 + 1.0 / len(half))
    height = forces[-1] - sum(half) / len(half)
    return height / math.sqrt(max(squared * spread, 1e-18))


def height_over_wander(state: Baseline, force_N: float, noise_N2: float) -> float:
    """Height of a force above the older half of the segments, in units of their wander.

    Zero while too little of free air is known.

    Args:
        state: Free-air force.
        force_N: The force.
        noise_N2: Variance that noise alone gives a segment.
    """
    forces = [segment.force_N for segment in state.segments]
    if len(forces) < 2:
        return 0.0
    half = forces[: max(len(forces) // 2, 1)]
    height = force_N - sum(half) / len(half)
    return height / math.sqrt(max(_neighbour_variance(forces), noise_N2, 1e-18))


def settle_baseline(state: Baseline, contact_m: float) -> Baseline:
    """Offset and slow error from what was felt before the contact at `contact_m`."""
    before = [s.force_N for s in state.segments if s.depth_m < contact_m]
    if not before:
        return state
    offset = sum(before) / len(before)
    variance = sum((f - offset) ** 2 for f in before) / max(len(before) - 1, 1)
    return state._replace(offset_N=offset, variance=variance)


def _neighbour_variance(forces: list[float]) -> float:
    """Half the mean square difference between neighbours (von Neumann), from its lower half.

    The upper half may hold the contact itself.
    """
    squares = sorted((b - a) ** 2 for a, b in itertools.pairwise(forces))
    kept = squares[: max(len(squares) // 2, 1)]
    return 0.5 * sum(kept) / len(kept) / _LOWER_HALF
