"""The log's clock beside the identifier's, which never goes back."""

from bisect import bisect_right

import numpy as np
from numpy.typing import NDArray

_SET_S = 1e-3
"""A smaller difference is rounding."""


class LogClock:
    """Tells when on the log's clock something was, though that clock was set in between."""

    def __init__(self) -> None:
        self._from_s: list[float] = []
        self._zeros_s: list[float] = []

    def add(self, stamps_s: NDArray[np.float64], times_s: NDArray[np.float64]) -> None:
        """Take further rows whose time was counted.

        Args:
            stamps_s: Their stamps [s], shape (n,).
            times_s: Their times on the identifier's clock [s], shape (n,), ascending.
        """
        zeros_s = stamps_s - times_s
        before_s = self._zeros_s[-1:] or [np.inf]
        for k in np.flatnonzero(np.abs(np.diff(zeros_s, prepend=before_s)) > _SET_S):
            self._from_s.append(float(times_s[k]))
            self._zeros_s.append(float(zeros_s[k]))

    def at(self, time_s: float) -> float:
        """Return the stamp [s] of an instant on the identifier's clock [s]."""
        if not self._zeros_s:
            return time_s
        return time_s + self._zeros_s[max(bisect_right(self._from_s, time_s) - 1, 0)]
