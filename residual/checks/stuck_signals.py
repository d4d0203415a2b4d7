"""Signals that repeat because their source is stuck, and those that repeat as a rule.

Many valid signals repeat bit for bit: a resolution coarser than the noise, a source
slower than the clock, samples that come twice. A repeat means something only where the
noise of every joint stands out of the resolution, and only when all joints repeat
together for far longer than they did while nothing was wrong. Of any other signal
nothing is claimed: what a stuck torque does to the force is then left to
`residual.checks.monitor` to notice.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residual.checks.input import ROUNDING_S
from residual.errors import Array

ORDER = 3  # of the differences: a smooth motion has almost none over three ticks
# no shorter repeat counts as a stuck source, whatever the signal
LEAST_S = 0.02
LEAST_REPEATS = 8
FAR_LONGER = 20.0  # times the longest repeat of the first half second
LONGEST_USUAL_S = (
    0.1  # no source of positions or torques is slower than ten samples a second
)
LONGEST_REFUSAL_S = 5.0
"""After this nothing is rejected any more, only reported: should a valid signal fall
still after all, on an arm at rest, then not for ever."""
LEAST_ALONE_S = 0.5  # no shorter repeat of a single joint is reported
LEAST_WHITENESS = 0.5
"""Ratio of third to second differences: 1.8 for white noise, next to nothing for a
smooth motion that has none."""
ROUNDING = 1e-9  # no smaller difference counts as one [rad, rad/s, Nm]
LEAST_ROWS = 16
# of which noise is learnt, however slow or fast the clock
LEAST_SAMPLES = 32
MOST_SAMPLES = 2048


def new_rows(rows: Array) -> Array:
    """Rows that are not all of the one before: a source slower than the clock, by
    its own clock.
    """
    return rows[np.concatenate(([True], (np.diff(rows, axis=0) != 0.0).any(axis=1)))]


def white_noise(rows: Array) -> Array:
    """Standard deviation of the noise of samples, shape (m, size); 0 where they are
    fewer than 4.

    A smooth motion has almost no third difference over three ticks, white noise of
    standard deviation s has one of ``s sqrt(20)``; the median keeps lost samples out. A
    signal that was filtered before it came reads too low, never too high.
    """
    if len(rows) <= ORDER:
        return np.zeros(rows.shape[1])
    differences = np.abs(np.diff(rows, n=ORDER, axis=0))
    # 0.6745 is the median of |x| for a standard normal x.
    return np.asarray(np.median(differences, axis=0) / (0.6745 * math.sqrt(20.0)))


def stands_out(rows: Array) -> NDArray[np.bool_]:
    """Which signals have noise that stands out of their resolution; rows (m, size)
    -> (size,).
    """
    rows = new_rows(rows)
    if len(rows) < LEAST_ROWS:
        return np.zeros(rows.shape[1], dtype=bool)
    # Steps are multiples of the resolution, however fast the arm moves.
    gaps = np.diff(np.sort(np.diff(rows, axis=0), axis=0), axis=0)
    resolution = np.where(gaps > ROUNDING, gaps, np.inf).min(axis=0)
    second, third = (
        np.median(np.abs(np.diff(rows, n=order, axis=0)), axis=0) for order in (2, 3)
    )
    # As in `white_noise`. Resolution alone makes less than two thirds of a step of such
    # noise.
    return (third > LEAST_WHITENESS * second) & (
        third / (0.6745 * np.sqrt(20.0)) >= resolution
    )


@dataclass(slots=True, eq=False)
class NoiseProbe:
    """Noise of a smooth vector signal, from its first samples; see `white_noise`.

    Attributes:
        rows: Room for samples, shape (MOST_SAMPLES, size).
        count: Number of samples so far.
        left_s: Time until they are enough [s].
    """

    rows: Array
    count: int = 0
    left_s: float = 0.5

    def add(self, value: ArrayLike, dt_s: float) -> Array | None:
        """Take a sample, shape (size,), that came ``dt_s`` after the one before.

        Returns all samples, shape (m, size), with the last one; None before.
        """
        self.rows[self.count] = value
        self.count += 1
        self.left_s -= dt_s
        enough = self.left_s <= ROUNDING_S and self.count >= LEAST_SAMPLES
        return self.rows[: self.count] if enough or self.count >= MOST_SAMPLES else None


@dataclass(slots=True)
class StuckSignalDetector:
    """Watches signals that come from one source and would get stuck together; all it
    remembers.

    Attributes:
        usual_s: Longest repeat while learning [s].
        repeat_s: For how long all signals have repeated now [s].
        repeats: For how many accepted samples.
        is_telling: Whether a repeat means anything in these signals.
    """

    usual_s: float = 0.0
    repeat_s: float = 0.0
    repeats: int = 0
    is_telling: bool = False

    @property
    def _limit_s(self) -> float:
        return max(LEAST_S, FAR_LONGER * self.usual_s)

    def is_stuck(self, dt_s: float) -> bool:
        """Whether a sample that repeats in all signals is to be rejected."""
        if not self.is_telling or self.repeats < LEAST_REPEATS:
            return False
        return self._limit_s <= self.repeat_s + dt_s < self._limit_s + LONGEST_REFUSAL_S

    @property
    def seems_stuck(self) -> bool:
        """Whether samples are accepted although the source seems to be stuck."""
        return self.is_telling and self.repeats > 0 and self.repeat_s > self._limit_s

    def accept(self, is_repeat: bool, dt_s: float, *, learning: bool) -> None:
        """A sample was accepted that came a time [s] after the one before."""
        self.repeat_s = self.repeat_s + dt_s if is_repeat else 0.0
        self.repeats = self.repeats + 1 if is_repeat else 0
        if learning:
            self.usual_s = min(max(self.usual_s, self.repeat_s), LONGEST_USUAL_S)


@dataclass(slots=True, eq=False)
class SingleSignalDetector:
    """Checks now and then whether one signal repeats while the others go on; all it
    remembers.

    Attributes:
        values: At the last check, shape (n,).
        still_s: For how long each has been the same at every check [s], shape (n,).
        limit_s: For how long at least it is reported, infinite for a signal whose
            repeats mean nothing [s], shape (n,).
        longest_s: The longest of the times in `still_s` [s].
    """

    MAY_BE_INFINITE = ("limit_s",)

    values: Array
    still_s: Array
    limit_s: Array
    longest_s: float = 0.0

    def learn(self, is_telling: NDArray[np.bool_], usual_s: float) -> None:
        """Learning has ended: of which signals, shape (size,), does a repeat mean
        anything?
        """
        self.limit_s = np.where(
            is_telling, max(LEAST_ALONE_S, FAR_LONGER * usual_s), np.inf
        )

    def check(self, values: Array, dt_s: float) -> list[int]:
        """Indices of signals, shape (size,), that seem stuck a time [s] after the
        last check.
        """
        self.still_s = (values == self.values) * (self.still_s + dt_s)
        self.longest_s = max(self.still_s.tolist())
        self.values = values
        return (
            np.flatnonzero(self.still_s >= self.limit_s).tolist()
            if self.longest_s
            else []
        )
