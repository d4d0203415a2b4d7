"""Between time stamps of whole nanoseconds and seconds in float64, without loss."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recordings.tables.table import FloatArray

_EXACT_NS = 1 << 52
"""Up to here (52 days) a double of seconds tells nanoseconds apart."""
NS_PER_S = 1_000_000_000


def start_of_clock(first_ns: int) -> int:
    """Return the instant from which seconds are counted so that nothing is lost.

    Args:
        first_ns: the first stamp.

    Returns:
        0, so that the file's clock is kept, or the first stamp if that clock began long ago.
    """
    return 0 if abs(first_ns) < _EXACT_NS // 2 else first_ns


def to_seconds(stamps_ns: NDArray[np.int64], start_ns: int) -> FloatArray:
    """Return stamps in seconds since `start_ns`; the nearest double, from which they come back."""
    return (stamps_ns - np.int64(start_ns)) / NS_PER_S


def to_nanoseconds(t_s: ArrayLike, start_ns: int) -> NDArray[np.int64]:
    """Return seconds since `start_ns` as stamps, to the nearest nanosecond; they must be finite."""
    return np.rint(np.asarray(t_s, dtype=np.float64) * NS_PER_S).astype(np.int64) + np.int64(
        start_ns
    )
