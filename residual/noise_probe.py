"""Learns the white noise of a sampled signal from its first samples."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residual.sample_clock import ROUNDING_S

ORDER = 3
"""Of the differences: a smooth motion has almost none over three ticks."""


def new_rows(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rows that are not all of the one before: a source slower than the clock, by its own clock.

    Args:
        rows: Samples of one source, shape (m, size), m > 0.
    """
    changed = (np.diff(rows, axis=0) != 0.0).any(axis=1)
    return rows[np.concatenate(([True], changed))]


def white_noise(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Standard deviation of the noise of samples, shape (m, size); 0 where they are fewer than 4.

    Returns:
        Shape (size,).
    """
    if len(rows) <= ORDER:
        return np.zeros(rows.shape[1])
    differences = np.abs(np.diff(rows, n=ORDER, axis=0))
    # 0.6745 is the median of |x| for a standard normal x.
    return np.asarray(np.median(differences, axis=0) / (0.6745 * math.sqrt(20.0)))


class NoiseState(NamedTuple):
    """All that a `NoiseProbe` remembers.

    Attributes:
        rows: Samples so far, shape (m, size).
        left_s: For how long it still listens [s].
    """

    rows: NDArray[np.float64]
    left_s: float


class NoiseProbe:
    """Noise of a smooth vector signal, from its third differences.

    A smooth motion has almost no third difference over three ticks, white noise of standard
    deviation s has one of ``s sqrt(20)``; the median keeps lost samples out. A signal that was
    filtered before it came reads too low, never too high.

    Args:
        size: Length of the vector.
        seconds: For how long it listens [s].
    """

    LEAST_SAMPLES = 32
    """However slow the clock."""
    MOST_SAMPLES = 2048
    """However fast the clock."""

    def __init__(self, size: int, seconds: float = 0.5) -> None:
        self._rows = np.empty((self.MOST_SAMPLES, size))
        self._count = 0
        self._left_s = seconds

    def add(self, value: ArrayLike, dt_s: float) -> NDArray[np.float64] | None:
        """Take a sample, shape (size,), that came ``dt_s`` after the one before.

        Returns:
            Standard deviation of the noise, shape (size,), with the last sample; None before.
        """
        self._rows[self._count] = value
        self._count += 1
        self._left_s -= dt_s
        enough = self._left_s <= ROUNDING_S and self._count >= self.LEAST_SAMPLES
        if not enough and self._count < self.MOST_SAMPLES:
            return None
        return white_noise(self.rows)

    @property
    def rows(self) -> NDArray[np.float64]:
        """Samples so far, shape (m, size): not to be written."""
        return self._rows[: self._count]

    @property
    def state(self) -> NoiseState:
        """All that the probe remembers, as copies."""
        return NoiseState(self._rows[: self._count].copy(), self._left_s)

    def restore(self, state: NoiseState) -> None:
        """Go on from a `state` taken earlier."""
        self._count, self._left_s = len(state.rows), state.left_s
        self._rows[: self._count] = state.rows
