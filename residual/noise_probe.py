"""Learns the white noise of a sampled signal from its first samples."""

import math

import numpy as np
from numpy.typing import NDArray


class NoiseProbe:
    """Noise of a smooth vector signal, from its third differences.

    A smooth motion has almost no third difference over three ticks, white noise of standard
    deviation s has one of ``s sqrt(20)``; the median keeps lost samples out. A signal that was
    filtered before it came reads too low, never too high.

    Args:
        size: Length of the vector.
        samples: How many samples are taken.
    """

    def __init__(self, size: int, samples: int = 512) -> None:
        self._rows = np.empty((samples, size))
        self._count = 0

    def add(self, value: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """Take a sample, shape (size,).

        Returns:
            Standard deviation of the noise, shape (size,), with the last sample; None before.
        """
        self._rows[self._count] = value
        self._count += 1
        if self._count < len(self._rows):
            return None
        differences = np.abs(np.diff(self._rows, n=3, axis=0))
        # 0.6745 is the median of |x| for a standard normal x.
        return np.median(differences, axis=0) / (0.6745 * math.sqrt(20.0))
