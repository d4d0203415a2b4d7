"""Sudden falls of a recorded force, found offline with the whole curve at hand."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

Array = NDArray[np.float64]

LEAST_N = 0.15
"""The smallest internal rupture described for the liver recordings; twenty times their noise."""
LONGEST_m = 2e-3
"""A rupture of liver releases over 0.5 to 2 mm; what takes longer is no rupture."""
SMOOTHING = 21
"""Samples of the centred mean that comes first."""


class Fall(NamedTuple):
    """One fall of the force.

    Attributes:
        from_m: Depth at its top.
        to_m: Depth at its foot.
        drop_N: Its height.
    """

    from_m: float
    to_m: float
    drop_N: float


NEAR_m = 0.5e-3
"""An alarm belongs to a fall when it lies between its top and its foot, or so close to either."""


def force_falls(depth_m: Array, force_N: Array, least_N: float = LEAST_N) -> list[Fall]:
    """Every fall by at least `least_N` within `LONGEST_m` of travel.

    Overlapping falls are one. The last `LONGEST_m` do not count: there the needle slows down.

    Args:
        depth_m: Depth of the advancing needle, shape (n,), not decreasing but for noise.
        force_N: Axial force, shape (n,).
        least_N: The smallest fall that counts.
    """
    depth = np.maximum.accumulate(depth_m)
    force = uniform_filter1d(force_N, SMOOTHING, mode="nearest")
    begin = np.searchsorted(depth, depth - LONGEST_m)
    inside = np.flatnonzero(depth < depth[-1] - LONGEST_m)
    found: list[Fall] = []
    for k in inside.tolist():
        top = int(begin[k]) + int(np.argmax(force[begin[k] : k + 1]))
        drop = float(force[top] - force[k])
        if drop < least_N:
            continue
        fall = Fall(float(depth[top]), float(depth[k]), drop)
        if not found or fall.from_m > found[-1].to_m:
            found.append(fall)
        elif drop > found[-1].drop_N:
            found[-1] = fall
    return found


def falls_found(falls: Sequence[Fall], alarms_m: Sequence[float]) -> int:
    """How many falls have an alarm of their own or share one.

    Args:
        falls: Found offline.
        alarms_m: Depths of the alarms.
    """
    return sum(any(_is_at(alarm, fall) for alarm in alarms_m) for fall in falls)


def alarms_at_falls(alarms_m: Sequence[float], falls: Sequence[Fall]) -> int:
    """How many alarms have a fall; several may share one.

    Args:
        alarms_m: Depths of the alarms.
        falls: Found offline.
    """
    return sum(any(_is_at(alarm, fall) for fall in falls) for alarm in alarms_m)


def _is_at(alarm_m: float, fall: Fall) -> bool:
    return fall.from_m - NEAR_m <= alarm_m <= fall.to_m + NEAR_m
