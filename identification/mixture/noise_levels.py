"""Noise levels of the force, part by part: white, coloured, heartbeat, breathing.

They are learnt from second differences of the force at lags of 10 ms to 1.3 s: a
straight line does not show in them, and each part shows most at lags near its own time
scale. A part gets what the faster ones leave; motion of the tissue only what they
seldom leave by chance, or noise would pass for motion.

Over travel the differences show texture, an error of the force model: some of it may be
friction.
"""

import math
from typing import NamedTuple

import numpy as np

from foundation.arrays import (
    Array,
    Matrix,
    Vector,
    WrittenMatrix,
    WrittenVector,
)
from foundation.jit import compiled, compiled_inside
from foundation.linear_algebra import order_statistic
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

PAST = 2 * 2 ** (LAGS - 1) + 1
"""Forces that the longest lag needs."""

MAX_DIFFERENCES = 400
"""Differences over which a level is learnt: four seconds."""

MAX_LAG_MM = 3.0
"""Lags with more travel are left out of heartbeat and breathing: in them the tissue
varies, it does not move."""

MIN_DIFFERENCES = 30
"""Differences before a level is learnt."""

MIN_FIRST_DIFFERENCES = 10.0
"""Differences at the shortest lag before any level is learnt."""

STEPS_BETWEEN_LEVELS = 10.0
"""Steps between two estimates of the levels."""

TEXTURE_MM = 0.1
"""Travel of a step of texture."""

MAX_TEXTURE_DIFFERENCES = 200
"""Differences over which texture is learnt."""

STEPS_BETWEEN_TEXTURES = 5.0
"""Steps between two estimates of the texture."""

FINE_LAG = 2
"""Exponent of texture's fine lag: four steps."""

COARSE_LAG = 4
"""Exponent of its coarse lag: sixteen steps."""

ROUNDING = 1e-6
"""Relative error that sums of time steps may have."""

MIN_HIDING_DIFFERENCES = 2.0
"""Coarse differences before it is known how much texture the noise can hide."""

TEXTURE_PERIOD_MM = 2.0 * TEXTURE_MM * 2**COARSE_LAG
"""Travel of a coarse difference: those further apart are independent."""

UNKNOWN_HIDDEN_N2 = 1e6
"""Variance that noise can hide before it is known: so large that the fraction of the
force decides."""

MAX_HIDDEN_FRACTION = 0.2
"""Part of the force that texture hidden by noise is at most."""

MAX_CARRIED_FRACTION = 0.9
"""Part of a step of texture that is carried over to the next one, at most."""

MEDIAN_OF_SQUARE = 0.455
"""Median of a squared standard normal; few of the differences contain a rupture."""

WHITE_CHANCE = 4.6
"""About 1.6 standard errors of a median of n squares of differences of white noise,
relative to its size and times the root of n: motion of the tissue must show beyond
it."""

COLOURED_CHANCE = 8.0
"""The same of coloured noise."""

INITIAL_WHITE_N2 = 1e-4
"""Variance of white noise before it is learnt."""

MOTION_NOISE_FRACTION = 0.1
"""Part of the variance by heartbeat and breathing that no hypothesis explains within a
block."""

MIN_NOISE_VARIANCE_N2 = 1e-8
"""Variance of a block's force, at least."""

WHITE = 0
"""Index of white noise among the parts."""

COLOURED = 1
"""Index of coloured noise."""

HEART = 2
"""Index of the heartbeat."""

BREATH = 3
"""Index of breathing."""

PARTS = 4
"""Number of parts."""


class NoiseVariances(NamedTuple):
    """Variances of the parts of the noise [N²].

    Attributes:
        white: Of a mean over `STEP_S`.
        coloured: Of the force sensor's coloured noise.
        heartbeat: Of the force by the heartbeat.
        breathing: Of the force by breathing.
    """

    white: float
    coloured: float
    heartbeat: float
    breathing: float

    @property
    def noise_fraction(self) -> float:
        """Part of the sensor's white noise in what changes the force within a breath.

        The rest is motion of the tissue, which is alike from one block to the next.
        """
        motion_N2 = self.heartbeat + self.breathing
        return self.white / (self.white + motion_N2) if motion_N2 > 0.0 else 1.0


def _second_difference(autocorrelation: float, at_twice: float) -> float:
    """Return the variance of a second difference, for an autocorrelation at its lag."""
    return 6.0 - 8.0 * autocorrelation + 2.0 * at_twice


def _coloured(lag_s: float) -> float:
    return math.exp(-lag_s / COLOURED_NOISE_S)


def _heartbeat(lag_s: float) -> float:
    return oscillation(lag_s, HEARTBEAT_HZ, HEARTBEAT_DAMPING)[0]


def _breathing(lag_s: float) -> float:
    return oscillation(lag_s, BREATHING_HZ, BREATHING_DAMPING)[0]


def _texture(lag_mm: float) -> float:
    return smooth_walk(lag_mm, MODEL_ERROR_MM)[0]


def _shown_by_differences() -> Array:
    """Return the variance of a second difference of each part, shape (4, 8)."""
    autocorrelations = (lambda _: 0.0, _coloured, _heartbeat, _breathing)
    lags_s = [STEP_S * 2**k for k in range(LAGS)]
    return np.array(
        [
            [_second_difference(like(lag_s), like(2.0 * lag_s)) for lag_s in lags_s]
            for like in autocorrelations
        ]
    )


def _texture_shown(lag: int) -> float:
    lag_mm = TEXTURE_MM * 2**lag
    return _second_difference(_texture(lag_mm), _texture(2.0 * lag_mm))


DESIGN = _shown_by_differences()
"""Variance of a second difference of a part of variance 1, shape (4, 8)."""

FINE_TEXTURE = _texture_shown(FINE_LAG)
"""The same of the force model's error at the fine lag of texture."""

COARSE_TEXTURE = _texture_shown(COARSE_LAG)
"""The same at its coarse lag."""


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

    past_N: Array
    steps: float
    squares_N2: Array
    counts: Array
    force_sum: float
    filled: float
    step: float

    def restarted(self) -> "SecondDifferences":
        """Return the same after a gap or a rest: no difference reaches across."""
        return self._replace(steps=0.0, force_sum=0.0, filled=0.0)

    def with_force(self, force_N: float, length: float) -> "SecondDifferences":
        """Return the same with a force added to the step being filled."""
        return self._replace(
            force_sum=self.force_sum + force_N * length, filled=self.filled + length
        )

    def with_step(self, force_sum: float, filled: float) -> "SecondDifferences":
        """Return the same after a step, whose remaining force and length are given."""
        squares_N2 = self.squares_N2.copy()
        counts = self.counts.copy()
        steps = self.steps + 1.0
        mean_N = self.force_sum / self.filled
        past_N = add_force(self.past_N, mean_N, steps, squares_N2, counts)
        return SecondDifferences(
            past_N, steps, squares_N2, counts, force_sum, filled, self.filled
        )


def no_differences(size: int, step: float) -> SecondDifferences:
    """Return differences before the first force, so many of which are kept."""
    return SecondDifferences(
        past_N=np.zeros(PAST),
        steps=0.0,
        squares_N2=np.zeros((LAGS, size)),
        counts=np.zeros(LAGS),
        force_sum=0.0,
        filled=0.0,
        step=step,
    )


NO_DIFFERENCES = no_differences(MAX_DIFFERENCES, STEP_S)
"""Before the first force."""


class NoiseLevels(NamedTuple):
    """What is known of the noise; immutable.

    Attributes:
        differences: Of the force over time.
        variances: Of its parts.
    """

    differences: SecondDifferences = NO_DIFFERENCES
    variances: NoiseVariances = NoiseVariances(INITIAL_WHITE_N2, 0.0, 0.0, 0.0)

    @property
    def noise_std_N(self) -> float:
        """Standard deviation of a block's force that no hypothesis can explain."""
        variances = self.variances
        motion = MOTION_NOISE_FRACTION * (variances.heartbeat + variances.breathing)
        noise = variances.white + variances.coloured + motion
        return math.sqrt(max(noise, MIN_NOISE_VARIANCE_N2))

    def beside(self, tissue: TissueMotion, time_s: float) -> "NoiseLevels":
        """Return the levels that remain once the tissue's motion is known."""
        if not tissue.is_known:
            return self
        limits = tissue.limits(time_s)
        doubt = 1.0 - limits.confidence
        white, coloured, heartbeat, breathing = self.variances
        # Where tissue overtakes the needle the force is as quick as coloured noise.
        motion = limits.heartbeat_variance + limits.breathing_variance
        return self._replace(
            variances=NoiseVariances(
                white,
                min(coloured, max(motion, doubt * coloured)),
                min(heartbeat, max(limits.heartbeat_variance, doubt * heartbeat)),
                min(breathing, max(limits.breathing_variance, doubt * breathing)),
            )
        )

    def restarted(self) -> "NoiseLevels":
        """Return the same after a gap or a rest."""
        return self._replace(differences=self.differences.restarted())

    def with_force(
        self, force_N: float, duration_s: float, speed_mm_s: float
    ) -> "NoiseLevels":
        """Return the levels after a block's force, less what the speed did to it."""
        differences = self.differences.with_force(force_N, duration_s)
        if differences.filled < STEP_S * (1.0 - ROUNDING):
            return self._replace(differences=differences)
        differences = differences.with_step(0.0, 0.0)
        variances = self.variances
        is_due = differences.steps % STEPS_BETWEEN_LEVELS == 0.0
        if is_due and differences.counts[0] > MIN_FIRST_DIFFERENCES:
            levels = estimate_levels(
                differences.squares_N2,
                differences.counts,
                DESIGN,
                round(math.log2(differences.step / STEP_S)),
                speed_mm_s,
            )
            variances = NoiseVariances(*levels.tolist())
        return NoiseLevels(differences, variances)


class Texture(NamedTuple):
    """What the tissue's texture shows of the force model's error; immutable.

    Attributes:
        differences: Of the force over travel.
        variance_N2: Coarse less fine differences.
        hidden_N2: Variance of the force model's error that noise can hide.
    """

    differences: SecondDifferences = no_differences(MAX_TEXTURE_DIFFERENCES, STEP_S)
    variance_N2: float = 0.0
    hidden_N2: float = UNKNOWN_HIDDEN_N2

    def restarted(self) -> "Texture":
        """Return the same after a gap or a rest."""
        return self._replace(differences=self.differences.restarted())

    def with_force(self, force_N: float, travel_mm: float) -> "Texture":
        """Return the texture after a block's mean force over fresh travel."""
        differences = self.differences.with_force(force_N, travel_mm)
        if differences.filled < TEXTURE_MM * (1.0 - ROUNDING):
            return self._replace(differences=differences)
        carried_mm = min(
            differences.filled - TEXTURE_MM, MAX_CARRIED_FRACTION * TEXTURE_MM
        )
        differences = differences.with_step(carried_mm * force_N, carried_mm)
        return self._replace(differences=differences)._with_levels()

    def _with_levels(self) -> "Texture":
        """Return the same with what the differences show, where that is due."""
        differences = self.differences
        squares_N2 = differences.squares_N2
        counts = differences.counts
        is_due = differences.steps % STEPS_BETWEEN_TEXTURES == 0.0
        if not is_due or counts[COARSE_LAG] < MIN_HIDING_DIFFERENCES:
            return self
        fine = difference_variance(squares_N2, counts, FINE_LAG)
        hidden_N2 = _hidden_texture(float(fine), float(counts[COARSE_LAG]))
        if counts[COARSE_LAG] < MIN_DIFFERENCES:
            return self._replace(hidden_N2=hidden_N2)
        coarse = difference_variance(squares_N2, counts, COARSE_LAG)
        return self._replace(variance_N2=float(coarse - fine), hidden_N2=hidden_N2)

    def model_error(self, force_N: float, noise_N: float) -> float:
        """Return the deviation [N] of the model's error beyond its own.

        It is what texture shows beyond the noise, and no less than what texture could
        be without showing: noise hides falls of the force that would tell friction
        from tip force, and must not make the estimate look more certain.

        Args:
            force_N: Axial force, less its offset.
            noise_N: Standard deviation of the force's slow error.
        """
        variance = self.variance_N2 / (COARSE_TEXTURE - FINE_TEXTURE)
        variance = variance - 6.0 * noise_N**2 / COARSE_TEXTURE
        expected = (MODEL_ERROR_FRACTION * force_N) ** 2
        # Friction lies between none and all of the force, so no deviation exceeds half
        # of that.
        shown_N = min(math.sqrt(max(variance - expected, 0.0)), 0.5 * abs(force_N))
        hidden_N = math.sqrt(max(self.hidden_N2, 0.0))
        hidden_N = min(hidden_N, MAX_HIDDEN_FRACTION * abs(force_N))
        return max(shown_N, hidden_N)


def _hidden_texture(fine_N2: float, coarse_differences: float) -> float:
    """Return the variance of texture that noise can hide [N²].

    One standard error of the variance of the coarse differences, were they all noise.
    Of n independent squares of normal values the mean has the relative standard error
    √(2/n).

    Args:
        fine_N2: Variance of the fine differences, nearly all of it noise.
        coarse_differences: Their number; they overlap.
    """
    kept = min(coarse_differences, float(MAX_TEXTURE_DIFFERENCES))
    independent = max(kept * TEXTURE_MM / TEXTURE_PERIOD_MM, 1.0)
    standard_error_N2 = fine_N2 * math.sqrt(2.0 / independent)
    return standard_error_N2 / (COARSE_TEXTURE - FINE_TEXTURE)


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
    """Return the variance of the differences at a lag, by their median."""
    size = min(int(counts[k]), squares.shape[1])
    return order_statistic(squares[k, :size], size // 2) / MEDIAN_OF_SQUARE


@compiled_inside
def chance_of_motion(levels: Vector, counts: Vector, design: Matrix) -> Vector:
    """Return what white and coloured noise show at each lag by chance, shape (8,)."""
    chance = np.zeros(LAGS)
    for k in range(LAGS):
        white = WHITE_CHANCE * levels[WHITE] * design[WHITE, k]
        coloured = COLOURED_CHANCE * levels[COLOURED] * design[COLOURED, k]
        count = min(counts[k] + 1.0, MAX_DIFFERENCES)
        chance[k] = (white + coloured) / math.sqrt(count)
    return chance


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
    levels = np.zeros(PARTS)
    unexplained = np.zeros(LAGS)
    chance = np.zeros(LAGS)
    shown = np.zeros_like(design)
    for k in range(LAGS):
        # The k-th lag of long steps is as long as this one of short steps.
        shown[:, k] = design[:, min(k + doublings, LAGS - 1)]
        if counts[k] > min(2 * 2**k, MIN_DIFFERENCES):
            unexplained[k] = difference_variance(squares, counts, k)
    for part in range(PARTS):
        for lag in (2 * part, 2 * part + 1):
            # A lag is a time to every part but white noise, which has none.
            k = lag if part == WHITE else lag - doublings
            is_motion = part in (HEART, BREATH)
            is_too_far = is_motion and 2**lag * STEP_S * speed >= MAX_LAG_MM
            if k >= 0 and counts[k] > 2 * 2**k and not is_too_far:
                level = (unexplained[k] - chance[k]) / shown[part, k]
                levels[part] = max(levels[part], level)
        for k in range(LAGS):
            unexplained[k] -= levels[part] * shown[part, k]
        if part == COLOURED:
            chance = chance_of_motion(levels, counts, shown)
    return levels
