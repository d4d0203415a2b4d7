"""Noise levels of the force, part by part: white, coloured, heartbeat, breathing.

They are learnt from second differences of the force at lags of 10 ms to 1.3 s: a
straight line does not show in them, and each part shows most at lags near its own time
scale. A part gets what the faster ones leave; motion of the tissue only what they
seldom leave by chance, or noise would pass for motion.

Over travel the differences show texture, an error of the force model: some of it may be
friction.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from foundation.arrays import (
    Array,
    Matrix,
    Vector,
    WrittenMatrix,
    WrittenVector,
)
from foundation.jit import compiled
from identification.mixture.disturbances import (
    BREATHING_DAMPING,
    BREATHING_HZ,
    COLOURED_NOISE_S,
    HEARTBEAT_DAMPING,
    HEARTBEAT_HZ,
    oscillation,
    smooth_walk,
)
from identification.mixture.force_model import MODEL_ERROR_FRACTION, MODEL_ERROR_MM
from identification.mixture.tissue_motion import TissueMotion

STEP_S = 0.01
"""Time between two forces in the differences."""

LAGS = 8
"""Lags of the differences: 1, 2, 4, to 128 steps."""

MAX_DIFFERENCES = 400
"""Differences over which a level is learnt: four seconds."""

MIN_DIFFERENCES = 30
"""Differences before a level is learnt."""

TEXTURE_MM = 0.1
"""Travel of a step of texture."""

MAX_TEXTURE_DIFFERENCES = 200
"""Differences over which texture is learnt."""

FINE_LAG = 2
"""Exponent of texture's fine lag: four steps."""

COARSE_LAG = 4
"""Exponent of its coarse lag: sixteen steps."""

WHITE, COLOURED, HEART, BREATH = range(4)
"""Indices of the parts of the noise: white, coloured, heartbeat, breathing."""


class NoiseVariances(NamedTuple):
    """Variances of the parts of the noise [N²].

    Attributes:
        white: Of a mean over `STEP_S`.
        coloured: Of the force sensor's coloured noise.
        heartbeat: Of the force by the heartbeat.
        breathing: Of the force by breathing.
    """

    white: float = 1e-4  # before it is learnt
    coloured: float = 0.0
    heartbeat: float = 0.0
    breathing: float = 0.0

    @property
    def noise_fraction(self) -> float:
        """Part of the sensor's white noise in what changes the force within a breath.

        The rest is motion of the tissue, which is alike from one block to the next.
        """
        motion_N2 = self.heartbeat + self.breathing
        return self.white / (self.white + motion_N2) if motion_N2 > 0.0 else 1.0


def _shown(autocorrelation: Callable[[float], float], lag: float) -> float:
    """Return what a second difference at a lag shows of a part of variance 1."""
    return 6.0 - 8.0 * autocorrelation(lag) + 2.0 * autocorrelation(2.0 * lag)


def _shown_by_lags(autocorrelation: Callable[[float], float]) -> list[float]:
    """Return the same at each lag in time."""
    return [_shown(autocorrelation, STEP_S * 2**k) for k in range(LAGS)]


def _shown_of_model_error(lag: int) -> float:
    """Return the same of the force model's error at a lag in travel."""
    return _shown(lambda mm: smooth_walk(mm, MODEL_ERROR_MM)[0, 0], TEXTURE_MM * 2**lag)


DESIGN = np.array(
    [
        _shown_by_lags(lambda _: 0.0),
        _shown_by_lags(lambda lag_s: math.exp(-lag_s / COLOURED_NOISE_S)),
        _shown_by_lags(
            lambda lag_s: oscillation(lag_s, HEARTBEAT_HZ, HEARTBEAT_DAMPING)[0, 0]
        ),
        _shown_by_lags(
            lambda lag_s: oscillation(lag_s, BREATHING_HZ, BREATHING_DAMPING)[0, 0]
        ),
    ]
)
"""Variance of a second difference of a part of variance 1, shape (4, 8)."""

COARSE_TEXTURE = _shown_of_model_error(COARSE_LAG)
"""The same of the force model's error at the coarse lag of texture."""

LAG_TEXTURE = COARSE_TEXTURE - _shown_of_model_error(FINE_LAG)
"""By how much that exceeds the same at its fine lag."""


class SecondDifferences(NamedTuple):
    """Second differences of the force, at lags that double; immutable.

    Attributes:
        past_N: Forces, a step apart, newest last, shape (257,).
        steps: Number of consecutive steps since the last gap.
        squares_N2: Of the last differences at each lag, shape (8, n).
        counts: Number of differences so far, at each lag, shape (8,).
        force_sum: Integral of the force over the step being filled.
        filled: Length of that step so far.
        step: Length of the last step: longer where samples are rare.
    """

    past_N: Array = np.zeros(2 * 2 ** (LAGS - 1) + 1)
    steps: float = 0.0
    squares_N2: Array = np.zeros((LAGS, MAX_DIFFERENCES))
    counts: Array = np.zeros(LAGS)
    force_sum: float = 0.0
    filled: float = 0.0
    step: float = STEP_S

    def restarted(self) -> "SecondDifferences":
        """Return the same after a gap or a rest: no difference reaches across."""
        return self._replace(steps=0.0, force_sum=0.0, filled=0.0)

    def with_force(
        self, force_N: float, length: float, step: float, max_carried: float = 0.0
    ) -> "SecondDifferences":
        """Return the same after a force, with one more step if it fills one.

        Args:
            force_N: Mean over a length.
            length: That length.
            step: Length of a step.
            max_carried: Length carried over to the next step, at most.
        """
        force_sum = self.force_sum + force_N * length
        filled = self.filled + length
        if filled < step * (1.0 - 1e-6):  # sums of lengths are rounded
            return self._replace(force_sum=force_sum, filled=filled)
        squares_N2 = self.squares_N2.copy()
        counts = self.counts.copy()
        steps = self.steps + 1.0
        past_N = add_force(self.past_N, force_sum / filled, steps, squares_N2, counts)
        carried = min(filled - step, max_carried) if max_carried > 0.0 else 0.0
        return SecondDifferences(
            past_N, steps, squares_N2, counts, carried * force_N, carried, filled
        )


class NoiseLevels(NamedTuple):
    """What is known of the noise; immutable.

    Attributes:
        differences: Of the force over time.
        variances: Of its parts.
    """

    differences: SecondDifferences = SecondDifferences()
    variances: NoiseVariances = NoiseVariances()

    @property
    def noise_std_N(self) -> float:
        """Standard deviation of a block's force that no hypothesis can explain."""
        variances = self.variances
        # A tenth of the motion is not explained within a block.
        motion = 0.1 * (variances.heartbeat + variances.breathing)
        return math.sqrt(max(variances.white + variances.coloured + motion, 1e-8))

    def beside(self, tissue: TissueMotion, time_s: float) -> "NoiseLevels":
        """Return the levels that remain once the tissue's motion is known."""
        if not tissue.is_known:
            return self
        doubt = tissue.doubt(time_s)
        heart_N2 = tissue.unexplained_N2(is_breathing=False)
        breath_N2 = tissue.unexplained_N2(is_breathing=True)
        # Where tissue overtakes the needle the force is as quick as coloured noise.
        motion_N2 = heart_N2 + breath_N2
        white, coloured, heartbeat, breathing = self.variances
        return self._replace(
            variances=NoiseVariances(
                white,
                min(coloured, max(motion_N2, doubt * coloured)),
                min(heartbeat, max(heart_N2, doubt * heartbeat)),
                min(breathing, max(breath_N2, doubt * breathing)),
            )
        )

    def restarted(self) -> "NoiseLevels":
        """Return the same after a gap or a rest."""
        return self._replace(differences=self.differences.restarted())

    def with_force(
        self, force_N: float, duration_s: float, speed_mm_s: float
    ) -> "NoiseLevels":
        """Return the levels after a block's force, less what the speed did to it."""
        differences = self.differences.with_force(force_N, duration_s, STEP_S)
        is_due = differences.steps % 10.0 == 0.0
        has_stepped = differences.steps != self.differences.steps
        if not (has_stepped and is_due and differences.counts[0] > 10.0):
            return self._replace(differences=differences)
        levels = estimate_levels(
            differences.squares_N2,
            differences.counts,
            DESIGN,
            round(math.log2(differences.step / STEP_S)),
            speed_mm_s,
        )
        return NoiseLevels(differences, NoiseVariances(*levels.tolist()))


class Texture(NamedTuple):
    """What the tissue's texture shows of the force model's error; immutable.

    Attributes:
        differences: Of the force over travel.
        variance_N2: Coarse less fine differences.
        hidden_N2: Variance of the force model's error that noise can hide; before it is
            known so large that the fraction of the force decides.
    """

    differences: SecondDifferences = SecondDifferences(
        squares_N2=np.zeros((LAGS, MAX_TEXTURE_DIFFERENCES))
    )
    variance_N2: float = 0.0
    hidden_N2: float = 1e6

    def restarted(self) -> "Texture":
        """Return the same after a gap or a rest."""
        return self._replace(differences=self.differences.restarted())

    def with_force(self, force_N: float, travel_mm: float) -> "Texture":
        """Return the texture after a block's mean force over fresh travel.

        Noise can hide one standard error of the variance of the coarse differences,
        were they all noise. Of n independent squares of normal values the mean has the
        relative standard error √(2/n).
        """
        differences = self.differences.with_force(
            force_N, travel_mm, TEXTURE_MM, 0.9 * TEXTURE_MM
        )
        counts = differences.counts
        is_due = differences.steps % 5.0 == 0.0
        has_stepped = differences.steps != self.differences.steps
        if not (has_stepped and is_due and counts[COARSE_LAG] >= 2.0):
            return self._replace(differences=differences)
        # Nearly all of the variance of the fine differences is noise.
        fine_N2 = difference_variance(differences.squares_N2, counts, FINE_LAG)
        kept = min(float(counts[COARSE_LAG]), float(MAX_TEXTURE_DIFFERENCES))
        difference_mm = (
            2.0 * TEXTURE_MM * 2**COARSE_LAG
        )  # those farther apart are independent
        independent = max(kept * TEXTURE_MM / difference_mm, 1.0)
        hidden_N2 = float(fine_N2) * math.sqrt(2.0 / independent) / LAG_TEXTURE
        variance_N2 = self.variance_N2
        if counts[COARSE_LAG] >= MIN_DIFFERENCES:
            coarse_N2 = difference_variance(differences.squares_N2, counts, COARSE_LAG)
            variance_N2 = float(coarse_N2 - fine_N2)
        return Texture(differences, variance_N2, hidden_N2)

    def model_error(self, force_N: float, noise_N: float) -> float:
        """Return the deviation [N] of the model's error beyond its own.

        It is what texture shows beyond the noise, and no less than what texture could
        be without showing: noise hides falls of the force that would tell friction
        from tip force, and must not make the estimate look more certain.

        Args:
            force_N: Axial force, less its offset.
            noise_N: Standard deviation of the force's slow error.
        """
        variance = self.variance_N2 / LAG_TEXTURE
        variance = variance - 6.0 * noise_N**2 / COARSE_TEXTURE
        expected = (MODEL_ERROR_FRACTION * force_N) ** 2
        # Friction lies between none and all of the force, so no deviation exceeds half
        # of that.
        shown_N = min(math.sqrt(max(variance - expected, 0.0)), 0.5 * abs(force_N))
        hidden_N = math.sqrt(max(self.hidden_N2, 0.0))
        return max(shown_N, min(hidden_N, 0.2 * abs(force_N)))


@compiled
def add_force(
    past: Vector,
    force: float,
    steps: float,
    squares: WrittenMatrix,
    counts: WrittenVector,
) -> Vector:
    """Keep the newest second differences; return the forces with the newest one.

    Args:
        past: Forces of the last steps, newest last, shape (257,).
        force: Of the newest step.
        steps: Consecutive steps, with the newest.
        squares: Of the differences, which are changed, shape (8, n).
        counts: Of the differences, which are changed, shape (8,).
    """
    newest = len(past) - 1
    forces = np.zeros(len(past))
    for i in range(newest):
        forces[i] = past[i + 1]
    forces[newest] = force
    for k in range(LAGS):
        lag = 2**k
        if steps <= 2 * lag:
            break
        difference = force - 2.0 * forces[newest - lag] + forces[newest - 2 * lag]
        squares[k, int(counts[k]) % squares.shape[1]] = difference**2
        counts[k] += 1.0
    return forces


@compiled
def difference_variance(squares: Matrix, counts: Vector, k: int) -> float:
    """Return the variance of the differences at a lag, by their median.

    Few of the differences contain a rupture.
    """
    size = min(int(counts[k]), squares.shape[1])
    # The median of a squared standard normal is 0.455.
    middle = size // 2
    return np.partition(squares[k, :size], middle)[middle] / 0.455


@compiled
def estimate_levels(
    squares: Matrix, counts: Vector, design: Matrix, doublings: int, speed: float
) -> Vector:
    """Return the variance of each part, each taking what the faster ones leave.

    Args:
        squares: Of the differences, shape (8, n).
        counts: Of the differences, shape (8,).
        design: What a part of variance 1 shows at each lag, shape (4, 8).
        doublings: Of `STEP_S` to the step of these differences: what steps are too long
            for shows as white noise.
        speed: Of the needle [mm/s].
    """
    # About 1.6 standard errors of a median of n squares of differences, relative to its
    # size and times the root of n: motion of the tissue must show beyond it.
    white_chance = 4.6
    coloured_chance = 8.0
    levels = np.zeros(len(design))
    unexplained = np.zeros(LAGS)
    chance = np.zeros(LAGS)
    shown = np.zeros_like(design)
    for k in range(LAGS):
        # The k-th lag of long steps is as long as this one of short steps.
        shown[:, k] = design[:, min(k + doublings, LAGS - 1)]
        if counts[k] > min(2 * 2**k, MIN_DIFFERENCES):
            unexplained[k] = difference_variance(squares, counts, k)
    for part in range(len(design)):
        for lag in (2 * part, 2 * part + 1):
            # A lag is a time to every part but white noise, which has none.
            k = lag if part == WHITE else lag - doublings
            is_motion = part in (HEART, BREATH)
            # In lags with so much travel the tissue varies, it does not move.
            is_too_far = is_motion and 2**lag * STEP_S * speed >= 3.0
            if k >= 0 and counts[k] > 2 * 2**k and not is_too_far:
                level = (unexplained[k] - chance[k]) / shown[part, k]
                levels[part] = max(levels[part], level)
        for k in range(LAGS):
            unexplained[k] -= levels[part] * shown[part, k]
            if part == COLOURED:
                white = white_chance * levels[WHITE] * shown[WHITE, k]
                coloured = coloured_chance * levels[COLOURED] * shown[COLOURED, k]
                count = min(counts[k] + 1.0, MAX_DIFFERENCES)
                chance[k] = (white + coloured) / math.sqrt(count)
    return levels
