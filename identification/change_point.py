"""Dates a kink of the force after the alarm."""

from functools import cache

import numpy as np
from numpy.typing import NDArray

_EDGE = 3


@cache
def _kink_columns(length: int) -> NDArray[np.float64]:
    """Unit kink columns max(t - k, 0) with their line removed, shape (candidates, length)."""
    time = np.arange(length, dtype=float)
    line = np.column_stack([np.ones(length), time])
    starts = np.arange(_EDGE, length - 1)
    columns = np.maximum(time[None, :] - starts[:, None], 0.0)
    columns = columns - (columns @ np.linalg.pinv(line).T) @ line.T
    columns /= np.linalg.norm(columns, axis=1, keepdims=True)
    columns.setflags(write=False)
    return columns


def blocks_since_kink(force_N: NDArray[np.float64], sign: float) -> int:
    """Most likely number of blocks since the force left its line.

    Maximises the likelihood of f = a + b t + c max(t - k, 0) over k: the argmax of the detector's
    own statistic, so the date is earlier than the alarm.

    Args:
        force_N: Forces of equally long blocks, newest last.
        sign: Direction of the kink, -1 for a fall, +1 for a rise.

    Returns:
        Blocks between the kink and the newest block, at least one.
    """
    evidence = sign * (_kink_columns(len(force_N)) @ force_N)
    return len(force_N) - 1 - (_EDGE + int(np.argmax(evidence)))
