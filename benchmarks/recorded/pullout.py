"""The force with which a needle is pulled out: friction alone, the yardstick of real tissue."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

WINDOW_m = 0.5e-3
"""The force at a depth is the mean over so much travel to either side."""
HAIR_m = 1e-4
"""A difference of depth that counts as none."""
SETTLED_m = 2e-3
"""Travel back after which friction has turned round and the tip touches nothing."""


class InAndOut(NamedTuple):
    """The parts of a recording.

    Attributes:
        insertion: From its start to where the needle is within `HAIR_m` of its deepest.
        withdrawal: Where it is on its way out and friction has turned round.
    """

    insertion: slice
    withdrawal: slice


def in_and_out(depth_m: Array) -> InAndOut:
    """Split a recording of one insertion, hold and withdrawal.

    Args:
        depth_m: Depth, shape (n,).
    """
    deepest = float(depth_m.max())
    deep = np.flatnonzero(depth_m >= deepest - HAIR_m)
    back = np.flatnonzero(depth_m[deep[-1] :] < deepest - SETTLED_m)
    out = deep[-1] + (int(back[0]) if len(back) else len(depth_m))
    return InAndOut(slice(0, int(deep[0]) + 1), slice(int(out), len(depth_m)))


def mean_at_depth(depth_m: Array, values: Array, at_m: float) -> float:
    """Mean of values near a depth, nan when the needle was never there."""
    near = np.abs(depth_m - at_m) <= WINDOW_m
    return float(np.mean(values[near])) if near.any() else float("nan")
