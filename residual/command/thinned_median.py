"""The median of a stream of values, in memory that does not grow."""

import math

import numpy as np
from numpy.typing import NDArray

_MOST_VALUES = 8192


class ThinnedMedian:
    """Exact for few values; of many, the median of every second, fourth, eighth, ..."""

    def __init__(self) -> None:
        self._kept = np.empty(0)
        self._stride, self._seen = 1, 0

    def add(self, values: NDArray[np.float64]) -> None:
        """Take further values, shape (n,)."""
        first = -self._seen % self._stride
        self._kept = np.concatenate((self._kept, values[first :: self._stride]))
        self._seen += len(values)
        while len(self._kept) > _MOST_VALUES:
            self._kept = self._kept[::2]
            self._stride *= 2

    @property
    def value(self) -> float:
        """The median; nan of nothing."""
        return float(np.median(self._kept)) if len(self._kept) else math.nan
