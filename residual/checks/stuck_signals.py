"""Detects stuck sources by signals that repeat bit for bit.

Many valid signals repeat bit for bit: a resolution coarser than the noise, a source
slower than the clock, samples that come twice. A repeat means something only where the
noise of every joint exceeds the resolution, and only when all joints repeat together
for far longer than they did while nothing was wrong. Of any other signal nothing is
claimed: what a stuck torque does to the force is then left to
`residual.checks.monitor` to notice.
"""

import math
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foundation.arrays import Array
from residual.checks.input import ROUNDING_S

ORDER = 3
"""Order of the differences that show noise: a smooth motion has almost none over three
ticks."""

SCALE = 0.6745 * math.sqrt(20.0)
"""Median of the absolute third difference of white noise of deviation 1: its variance
is 1 + 9 + 9 + 1, and the median of a normal variable 0.6745 deviations."""

MIN_REPEAT_S = 0.02
"""Shortest repeat that counts as a stuck source, whatever the signal."""

MIN_REPEATS = 8
"""Fewest repeats that count as a stuck source, whatever the clock."""

STUCK_RATIO = 20.0
"""A source counts as stuck when it repeats so many times longer than it ever did in the
first half second."""

MAX_USUAL_S = 0.1
"""Longest repeat that is learnt as usual: no source of positions or torques is slower
than ten samples a second."""

MAX_REFUSAL_S = 5.0
"""After this time nothing is rejected any more, only reported: should a valid signal
fall still after all, on an arm at rest, then not for ever."""

MIN_ALONE_S = 0.5
"""Shortest repeat of a single joint that is reported."""

MIN_WHITENESS = 0.5
"""Smallest ratio of third to second differences that noise makes: it is 1.8 for white
noise, next to nothing for a smooth motion that has none."""

ROUNDING = 1e-9
"""Smallest difference that is not rounding [rad, rad/s, Nm]."""

MIN_ROWS = 16
"""Fewest different samples that show whether noise exceeds the resolution."""

LEARNING_S = 0.5
"""Time for which the noise of signals is learnt."""

MIN_SAMPLES = 32
"""Fewest samples of which noise is learnt, however slow the clock."""

MAX_SAMPLES = 2048
"""Most samples of which noise is learnt, however fast the clock."""


def drop_repeats(rows: Array) -> Array:
    """Return the rows that differ from the row before, of shape (m, size).

    They are the samples of a source slower than the clock, by its own clock.
    """
    return rows[np.concatenate(([True], (np.diff(rows, axis=0) != 0.0).any(axis=1)))]


def white_noise(rows: Array) -> Array:
    """Return the standard deviation of noise in samples, (m, size) -> (size,).

    A smooth motion has almost no third difference over three ticks, white noise of
    standard deviation s has one of ``s sqrt(20)``; the median keeps lost samples out. A
    signal that was filtered before it came reads too low, never too high. It is 0 where
    there are fewer than 4 samples.
    """
    if len(rows) <= ORDER:
        return np.zeros(rows.shape[1])
    differences = np.abs(np.diff(rows, n=ORDER, axis=0))
    return np.asarray(np.median(differences, axis=0) / SCALE)


def is_noise_resolved(rows: Array) -> NDArray[np.bool_]:
    """Return which signals have noise above their resolution, (m, size) -> (size,)."""
    rows = drop_repeats(rows)
    if len(rows) < MIN_ROWS:
        return np.zeros(rows.shape[1], dtype=bool)
    # Steps are multiples of the resolution, however fast the arm moves.
    gaps = np.diff(np.sort(np.diff(rows, axis=0), axis=0), axis=0)
    resolution = np.where(gaps > ROUNDING, gaps, np.inf).min(axis=0)
    second = np.median(np.abs(np.diff(rows, n=2, axis=0)), axis=0)
    # Resolution alone makes less than two thirds of a step of such noise.
    noise = white_noise(rows)
    return (noise > MIN_WHITENESS * second / SCALE) & (noise >= resolution)


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
        is_enough = self.left_s <= ROUNDING_S and self.count >= MIN_SAMPLES
        if is_enough or self.count >= MAX_SAMPLES:
            return self.rows[: self.count]
        return None


@dataclass(slots=True)
class StuckSignalDetector:
    """Detects when signals that come from one source get stuck together.

    Attributes:
        usual_s: Longest repeat while learning.
        repeat_s: For how long all signals have repeated now.
        repeats: For how many accepted samples.
        is_informative: Whether a repeat means anything in these signals.
    """

    usual_s: float = 0.0
    repeat_s: float = 0.0
    repeats: int = 0
    is_informative: bool = False

    @property
    def _limit_s(self) -> float:
        return max(MIN_REPEAT_S, STUCK_RATIO * self.usual_s)

    def is_stuck(self, dt_s: float) -> bool:
        """Return whether a sample that repeats in all signals is to be rejected."""
        if not self.is_informative or self.repeats < MIN_REPEATS:
            return False
        return self._limit_s <= self.repeat_s + dt_s < self._limit_s + MAX_REFUSAL_S

    @property
    def seems_stuck(self) -> bool:
        """Whether samples are accepted although the source seems to be stuck."""
        return (
            self.is_informative and self.repeats > 0 and self.repeat_s > self._limit_s
        )

    def accept(self, is_repeat: bool, dt_s: float, *, learning: bool) -> None:
        """Count an accepted sample that came a time [s] after the one before."""
        self.repeat_s = self.repeat_s + dt_s if is_repeat else 0.0
        self.repeats = self.repeats + 1 if is_repeat else 0
        if learning:
            self.usual_s = min(max(self.usual_s, self.repeat_s), MAX_USUAL_S)


@dataclass(slots=True, eq=False)
class SingleSignalDetector:
    """Detects, now and then, that one signal repeats while the others go on.

    Attributes:
        values: Signals at the last check, shape (n,).
        still_s: For how long each has been the same at every check, shape (n,).
        limit_s: For how long at least it is reported, infinite for a signal whose
            repeats mean nothing, shape (n,).
        longest_s: The longest of the times in `still_s`.
    """

    MAY_BE_INFINITE: ClassVar[tuple[str, ...]] = ("limit_s",)
    """See `foundation.state`."""

    values: Array
    still_s: Array
    limit_s: Array
    longest_s: float = 0.0

    @classmethod
    def of_size(cls, size: int) -> Self:
        """Return a detector of so many signals, before their noise is known."""
        return cls(np.zeros(size), np.zeros(size), np.full(size, np.inf))

    def learn(self, is_informative: NDArray[np.bool_], usual_s: float) -> None:
        """Set from when on repeats are reported, at the end of learning.

        Args:
            is_informative: Of which signals a repeat means anything, shape (n,).
            usual_s: Longest repeat of all of them while learning.
        """
        self.limit_s = np.where(
            is_informative, max(MIN_ALONE_S, STUCK_RATIO * usual_s), np.inf
        )

    def check(self, values: Array, dt_s: float) -> list[int]:
        """Return the indices of signals, shape (n,), that seem stuck.

        The last check was a time [s] ago.
        """
        self.still_s = (values == self.values) * (self.still_s + dt_s)
        self.longest_s = max(self.still_s.tolist())
        self.values = values
        if not self.longest_s:
            return []
        return np.flatnonzero(self.still_s >= self.limit_s).tolist()
