"""Noise levels of the force, part by part: white, coloured, heartbeat, breathing.

Learnt from second differences of the force at lags of 10 ms to 1.3 s: a straight line
does not show in them, and each part shows most at lags near its own time scale. A part
gets what the faster ones leave; motion of the tissue only what they seldom leave by
chance, or noise would pass for motion.

Over travel the differences show texture, an error of the law: some of it may be
friction.
"""

import math
from typing import NamedTuple

import numpy as np

from foundation.arrays import Array, Matrix, Vector, WrittenMatrix, WrittenVector
from foundation.jit import compiled
from identification.multilayer.force_model import LAW_ERROR, LAW_MM
from identification.multilayer.tissue_motion import TissueMotion

STEP_S = 0.01  # time between two forces in the differences
BEATS = (
    (1.2, 0.3),
    (0.3, 0.5),
)  # Frequency [Hz] and damping of heartbeat and breathing
COLOUR_S = 0.025  # correlation time of a force sensor's noise behind its filter
_MEMORY = 400  # differences over which a level is learned: four seconds
_MOVED_MM = 3.0  # lags with more travel are left out: in them the tissue varies, it does not move
# travel of a step; steps over which texture is learned
_TEXTURE_MM = 0.1
_TEXTURES = 200
# texture's lags, 2**2 and 2**4 steps; least differences
_FINE = 2
_COARSE = 4
_LEAST_SEEN = 30
_MEDIAN = 0.455  # Median of a squared standard normal; few of the differences contain a rupture
_CHANCE = (4.6, 8.0)
"""About 1.6 standard errors of a median of n squares of such differences of white and
of coloured noise, relative to its size and times the root of n: motion of the tissue
must show beyond it."""


@compiled
def oscillation(
    dt_s: float, hz: float, damping: float
) -> tuple[float, float, float, float]:
    """Transition of a damped oscillator's deflection and rate, row by row."""
    w = 2.0 * math.pi * hz
    d = w * math.sqrt(1.0 - damping**2)
    decay = math.exp(-damping * w * dt_s)
    cosine = math.cos(d * dt_s)
    sine = math.sin(d * dt_s)
    return (
        decay * (cosine + damping * w / d * sine),
        decay * sine / d,
        -decay * w * w / d * sine,
        decay * (cosine - damping * w / d * sine),
    )


@compiled
def smooth_walk(travel: float, length: float) -> tuple[float, float, float, float]:
    """Transition of a critically damped value and its slope (Matern 3/2), row by
    row.
    """
    reach = travel / length
    decay = math.exp(-reach)
    slope = -decay * reach / length
    return decay * (1.0 + reach), decay * travel, slope, decay * (1.0 - reach)


@compiled
def transitions(
    dt_s: float, travel: float, length: float, variances: tuple[float, float, float]
) -> Array:
    """How heartbeat, breathing and an error that lasts for a length go on, shape (3,
    7).

    Of each the transition, row by row, and the covariance of the noise that leaves its
    stationary variances as they are: of its value, of both, of its rate.
    """
    found = np.zeros((3, 7))
    for part in range(3):
        a, b, c, d = smooth_walk(travel, length)
        rate = 1.0 / length
        level = variances[part]
        if part < 2:
            hz, damping = BEATS[part]
            a, b, c, d = oscillation(dt_s, hz, damping)
            rate = 2.0 * math.pi * hz
        fast = level * rate**2
        row = found[part]
        row[0] = a
        row[1] = b
        row[2] = c
        row[3] = d
        row[4] = level - a * a * level - b * b * fast
        row[5] = -(a * c * level + b * d * fast)
        row[6] = fast - c * c * level - d * d * fast
    return found


def _difference(part: int, lag_s: float) -> float:
    """Variance of a second difference of a part (0 to 3), or of the law's error (4),
    of one.
    """

    def likeness(lag_s: float) -> float:
        if part < 2:
            return math.exp(-lag_s / COLOUR_S) if part else 0.0
        is_law = part == 4
        return (
            smooth_walk(lag_s, LAW_MM)
            if is_law
            else oscillation(lag_s, *BEATS[part - 2])
        )[0]

    return 6.0 - 8.0 * likeness(lag_s) + 2.0 * likeness(2.0 * lag_s)


_DESIGN = np.array(
    [[_difference(part, STEP_S * 2**k) for k in range(8)] for part in range(4)]
)
_SHOWN = tuple(_difference(4, _TEXTURE_MM * 2**k) for k in (_FINE, _COARSE))


class DisturbanceLevels(NamedTuple):
    """What is known of the noise.

    Attributes:
        past: forces, a step apart, newest last.
        steps: Number of consecutive steps since the last gap.
        squares: Of the last differences at each lag.
        seen: Number of differences so far, at each lag.
        levels: variances: white, colour, heart, breath.
        force_sum: Integral of the force over the step being filled.
        filled_s: Length of that step so far.
        step_s: Length of the last step: longer where samples are rare.
    """

    past: Array = np.zeros(257)
    steps: float = 0.0
    squares: Array = np.zeros((8, _MEMORY))
    seen: Array = np.zeros(8)
    levels: Array = np.array([1e-4, 0.0, 0.0, 0.0])
    force_sum: float = 0.0
    filled_s: float = 0.0
    step_s: float = STEP_S
    is_texture: bool = (
        False  # steps of travel [mm]; the level is coarse less fine differences
    )

    @classmethod
    def of_texture(cls) -> "DisturbanceLevels":
        """Differences over travel, nothing known."""
        return cls(
            squares=np.zeros((8, _TEXTURES)), levels=np.zeros(1), is_texture=True
        )

    @property
    def noise(self) -> float:
        """Standard deviation of a block's force that no hypothesis can explain [N]."""
        white, colour, heart, breath = self.levels.tolist()
        return math.sqrt(max(white + colour + 0.1 * (heart + breath), 1e-8))

    def beside(self, tissue: TissueMotion, time_s: float) -> "DisturbanceLevels":
        """The levels with what remains of heartbeat and breathing once the motion is
        known.
        """
        if not tissue.is_known:
            return self
        heart, breath, part = tissue.limits(time_s)
        # Where tissue overtakes the needle the force is as quick as coloured noise.
        most = np.array([math.inf, heart + breath, heart, breath])
        return self._replace(
            levels=np.minimum(self.levels, np.maximum(most, (1.0 - part) * self.levels))
        )

    def restarted(self) -> "DisturbanceLevels":
        """After a gap or a rest: no difference reaches across."""
        return self._replace(steps=0.0, force_sum=0.0, filled_s=0.0)

    def with_force(
        self, force: float, dt_s: float, speed: float
    ) -> "DisturbanceLevels":
        """Use a block's mean force, less what changes of speed added [N], at a speed
        [mm/s].
        """
        total = self.force_sum + force * dt_s
        filled = self.filled_s + dt_s
        step = _TEXTURE_MM if self.is_texture else STEP_S
        if filled < step * (1.0 - 1e-6):
            return self._replace(force_sum=total, filled_s=filled)
        squares = self.squares.copy()
        seen = self.seen.copy()
        count = self.steps + 1.0
        past = _learn(self.past, total / filled, count, squares, seen)
        levels = self.levels
        if self.is_texture and count % 5.0 == 0.0 and seen[_COARSE] >= _LEAST_SEEN:
            levels = np.array(
                [_square(squares, seen, _COARSE) - _square(squares, seen, _FINE)]
            )
        elif count % 10.0 == 0.0 and seen[0] > 10.0 and not self.is_texture:
            levels = _levels(squares, seen, _DESIGN, speed)
        over = min(filled - step, 0.9 * step) if self.is_texture else 0.0
        rest = over * force, over, filled, self.is_texture
        return DisturbanceLevels(past, count, squares, seen, levels, *rest)

    def law_error(self, force: float, noise: float) -> float:
        """Deviation [N] of the law's error that texture shows beyond `LAW_ERROR` and
        noise.
        """
        variance = self.levels[0] / (_SHOWN[1] - _SHOWN[0]) - 6.0 * noise**2 / _SHOWN[1]
        # Friction lies between none and all of the force, so no deviation exceeds half
        # of that.
        return min(
            math.sqrt(max(variance - (LAW_ERROR * force) ** 2, 0.0)), 0.5 * abs(force)
        )


@compiled
def _learn(
    past: Vector,
    force: float,
    count: float,
    squares: WrittenMatrix,
    seen: WrittenVector,
) -> Vector:
    """Keep the newest second differences; returns the forces with the newest one."""
    past = np.append(past[1:], force)
    for k in range(8):
        lag = 2**k
        if count <= 2 * lag:
            break
        square = (past[256] - 2.0 * past[256 - lag] + past[256 - 2 * lag]) ** 2
        squares[k, int(seen[k]) % squares.shape[1]] = square
        seen[k] += 1.0
    return past


@compiled
def _square(squares: Matrix, seen: Vector, k: int) -> float:
    """Variance of the differences at a lag, by their median."""
    known = min(int(seen[k]), squares.shape[1])
    return np.partition(squares[k, :known], known // 2)[known // 2] / _MEDIAN


@compiled
def _levels(squares: Matrix, seen: Vector, design: Matrix, speed: float) -> Vector:
    """Variance of each part, each taking what the faster ones leave."""
    levels = np.zeros(4)
    left = np.zeros(8)
    chance = np.zeros(8)
    for k in range(8):
        if seen[k] > min(2 * 2**k, _LEAST_SEEN):
            left[k] = _square(squares, seen, k)
    for part in range(4):
        for k in (2 * part, 2 * part + 1):
            is_tissue = part >= 2 and 2**k * STEP_S * speed >= _MOVED_MM
            if seen[k] > 2 * 2**k and not is_tissue:
                levels[part] = max(
                    levels[part], (left[k] - chance[k]) / design[part, k]
                )
        left -= levels[part] * design[part]
        if part == 1:
            spread = (
                _CHANCE[0] * levels[0] * design[0] + _CHANCE[1] * levels[1] * design[1]
            )
            chance = spread / np.sqrt(np.minimum(seen + 1.0, _MEMORY))
    return levels
