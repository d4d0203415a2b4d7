"""Noise of signals, learnt from their first samples: how large, and whether it shows.

Many valid signals repeat bit for bit: a resolution coarser than the noise, a source
slower than the clock, samples that come twice. A repeat means something only where the
noise exceeds the resolution.
"""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foundation.arrays import Array
from residual.checks.input import ROUNDING_S

LEARNING_S = 0.5
"""Time for which the noise of signals is learnt."""

MAX_SAMPLES = 2048
"""Most samples of which noise is learnt, however fast the clock."""

MEDIAN_OF_THIRD = 0.6745 * math.sqrt(20.0)
"""Median of the absolute third difference of white noise of deviation 1: its variance
is 1 + 9 + 9 + 1, and the median of a normal variable 0.6745 deviations."""


def find_new(rows: Array) -> NDArray[np.bool_]:
    """Return which rows differ from the row before, (m, size) -> (m,).

    They are the samples of a source slower than the clock, by its own clock.
    """
    return np.concatenate(([True], (np.diff(rows, axis=0) != 0.0).any(axis=1)))


def white_noise(rows: Array) -> Array:
    """Return the standard deviation of noise in samples, (m, size) -> (size,).

    A smooth motion has almost no third difference over three ticks, white noise of
    standard deviation s has one of ``s sqrt(20)``; the median keeps lost samples out. A
    signal that was filtered before it came reads too low, never too high. It is 0 where
    there are fewer than 4 samples.
    """
    if len(rows) <= 3:
        return np.zeros(rows.shape[1])
    differences = np.abs(np.diff(rows, n=3, axis=0))
    return np.asarray(np.median(differences, axis=0) / MEDIAN_OF_THIRD)


def is_noise_resolved(rows: Array) -> NDArray[np.bool_]:
    """Return which signals have noise above their resolution, (m, size) -> (size,)."""
    rows = rows[find_new(rows)]
    if len(rows) < 16:  # too few to show it
        return np.zeros(rows.shape[1], dtype=bool)
    # Steps are multiples of the resolution, however fast the arm moves; what is smaller
    # than 1e-9 [rad, rad/s, Nm] is rounding.
    gaps = np.diff(np.sort(np.diff(rows, axis=0), axis=0), axis=0)
    resolution = np.where(gaps > 1e-9, gaps, np.inf).min(axis=0)
    second = np.median(np.abs(np.diff(rows, n=2, axis=0)), axis=0)
    noise = white_noise(rows)
    # The ratio of third to second differences is 1.8 for white noise, next to nothing
    # for a smooth motion that has none. Resolution alone makes less than two thirds of
    # a step of such noise.
    return (noise > 0.5 * second / MEDIAN_OF_THIRD) & (noise >= resolution)


@dataclass(slots=True, eq=False)
class NoiseProbe:
    """Collects the first samples of a vector signal, of which noise is learnt.

    Attributes:
        rows: Room for samples, shape (MAX_SAMPLES, size).
        count: Number of samples so far.
        left_s: Time until they are enough.
    """

    rows: Array
    count: int = 0
    left_s: float = LEARNING_S

    @classmethod
    def of_size(cls, size: int) -> Self:
        """Return a probe of samples of so many numbers."""
        return cls(np.zeros((MAX_SAMPLES, size)))

    def add(self, value: ArrayLike, dt_s: float) -> Array | None:
        """Add a sample, shape (size,), that came ``dt_s`` after the one before.

        Returns:
            With the last sample all of them, shape (m, size); None before.
        """
        self.rows[self.count] = value
        self.count += 1
        self.left_s -= dt_s
        # 32 at least, however slow the clock.
        is_enough = self.left_s <= ROUNDING_S and self.count >= 32
        if is_enough or self.count >= MAX_SAMPLES:
            return self.rows[: self.count]
        return None
