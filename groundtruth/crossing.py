"""When a sampled signal first reaches a level, to a fraction of a sample."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def first_crossing_s(t_s: Array, signal: Array, level: float, *, after_s: float = -np.inf) -> float:
    """Time at which the signal first reaches the level from below, by linear interpolation.

    Args:
        t_s: Sample times, shape (n,).
        signal: Samples, shape (n,).
        level: The level, in the unit of the signal.
        after_s: Only samples at or after this time count.

    Returns:
        The time, or nan when the level is not reached.
    """
    reached = np.flatnonzero((signal >= level) & (t_s >= after_s))
    if reached.size == 0:
        return float("nan")
    k = int(reached[0])
    if k == 0 or signal[k - 1] >= level:
        return float(t_s[k])
    share = (level - signal[k - 1]) / (signal[k] - signal[k - 1])
    return float(t_s[k - 1] + share * (t_s[k] - t_s[k - 1]))
