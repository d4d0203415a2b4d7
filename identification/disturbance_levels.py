"""How noisy the force is, part by part: white, colour of the sensor, heartbeat, breathing.

Second differences of the force at lags of 10 ms to 1.3 s: a straight line does not show in them,
and each part shows most at lags near its own time. A part takes what the faster ones leave.
"""

import math
from typing import NamedTuple

import numpy as np

from identification.estimate import Array
from identification.hypothesis_filter import BEATS, COLOUR_S, oscillation
from needleforce.jit import Matrix, Vector, WrittenVector, compiled

STEP_S = 0.01
"""Time between two forces in the differences."""
_LAGS = np.array([1, 2, 4, 8, 16, 32, 64, 128])
_MEMORY = 400.0
"""Differences over which a level is learned: four seconds."""
_MOVED_MM = 5.0
"""Over more travel it is the tissue that varies, not its motion."""
_TRIMMED = 0.92
"""Mean of a squared standard normal that counts four times its mean at most."""


def _design() -> Array:
    """Variance of a second difference at each lag by unit variance of each part, shape (4, 8)."""
    lag = STEP_S * _LAGS
    rows = []
    for likeness in (
        lambda h: 0.0,
        lambda h: math.exp(-h / COLOUR_S),
        *(lambda h, beat=beat: oscillation(h, *beat)[0] for beat in BEATS),
    ):
        rows.append([6.0 - 8.0 * likeness(h) + 2.0 * likeness(2.0 * h) for h in lag.tolist()])
    return np.array(rows)


_DESIGN = _design()


class DisturbanceLevels(NamedTuple):
    """What is known of the noise."""

    past: Array = np.zeros(257)  # forces, a step apart, newest last
    count: float = 0.0  # how many of them follow each other undisturbed
    squares: Array = np.zeros(8)  # mean squared differences
    seen: Array = np.zeros(8)  # how many each rests on, at most the memory
    levels: Array = np.array([1e-4, 0.0, 0.0, 0.0])  # variances: white, colour, heart, breath
    force_sum: float = 0.0  # integral of the force over the step being filled
    filled_s: float = 0.0  # length of that so far

    @property
    def noise(self) -> float:
        """Standard deviation of a block's force that no hypothesis can explain [N]."""
        white, colour, heart, breath = self.levels.tolist()
        return math.sqrt(max(white + colour + 0.1 * (heart + breath), 1e-8))

    def restarted(self) -> "DisturbanceLevels":
        """After a gap, a rest or a release: no difference reaches across."""
        return self._replace(count=0.0, force_sum=0.0, filled_s=0.0)

    def with_force(self, force: float, dt_s: float, speed: float) -> "DisturbanceLevels":
        """Use the mean force of a block [N] at a speed [mm/s]."""
        total, filled = self.force_sum + force * dt_s, self.filled_s + dt_s
        if filled < STEP_S * (1.0 - 1e-6):
            return self._replace(force_sum=total, filled_s=filled)
        past = np.append(self.past[1:], total / filled)
        squares, seen = self.squares.copy(), self.seen.copy()
        _learn(past, self.count + 1.0, squares, seen)
        levels = _levels(squares, seen, _DESIGN, self.levels, speed)
        return DisturbanceLevels(past, self.count + 1.0, squares, seen, levels)


@compiled
def _learn(past: Vector, count: float, squares: WrittenVector, seen: WrittenVector) -> None:
    """Use the newest second differences; a large one counts little, once there are some."""
    for k in range(8):
        lag = 2**k
        if count <= 2 * lag:
            break
        square = (past[256] - 2.0 * past[256 - lag] + past[256 - 2 * lag]) ** 2
        seen[k] = min(seen[k] + 1.0, _MEMORY)
        if seen[k] > 5 * lag:
            rate = (0.1 if square > 25.0 * squares[k] else 1.0) / seen[k]
            squares[k] += rate * (min(square, 4.0 * squares[k]) / _TRIMMED - squares[k])
        else:
            squares[k] += (square - squares[k]) / seen[k]


@compiled
def _levels(
    squares: Vector, seen: Vector, design: Matrix, before: Vector, speed: float
) -> WrittenVector:
    """Variance of each part; as before while little has been seen."""
    levels, left = before.copy(), squares.copy()
    if seen[0] <= 10.0:
        return levels
    for part in range(4):
        level = 0.0
        for k in (2 * part, 2 * part + 1):
            is_tissue = part >= 2 and 2**k * STEP_S * speed >= _MOVED_MM
            if seen[k] > 2 * 2**k and not is_tissue:
                level = max(level, left[k] / design[part, k])
        levels[part] = level
        left -= level * design[part]
    return levels
