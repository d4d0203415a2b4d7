"""Depth and speed of the tip: a Kalman filter that learns the noise of its samples.

The state is depth and speed, driven by white acceleration. Every sample measures the
depth, and the speed where the robot reports it. The noise of either is learnt from the
distance of a sample to the line between its neighbours: a needle does not leave that
line within milliseconds. Noise of filtered positions, or of a coarse encoder, is
smooth, and so is that of a speed made from them: it is learnt from the scatter of means
over 16 ms.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

from foundation.jit import compiled, compiled_inside
from identification.config import CheckConfig
from identification.sample_check import (
    CheckState,
    RawSample,
    check_sample,
    is_used,
    shortest_gap,
)

ACCELERATION_M2_PER_S3 = 2e-7
"""Spectral density of the acceleration: the speed changes by half a millimetre per
second in 0.1 s, one standard deviation. Starts and stops are quicker, see
`acceleration_density`."""
NOISE_MEMORY_S = 2.0
"""Memory of the learnt noise."""
CLIPPED_AFTER = 50.0
"""After so many values a square is clipped."""
MAX_SQUARE = 9.0
"""A square is clipped to so many times the learnt variance: more is motion or a slip,
no noise."""
MIN_DEPTH_VARIANCE_M2 = 1e-16
"""Of 0.01 um: what rounding leaves of exact depths."""
MIN_SPEED_VARIANCE_M2_PER_S2 = 1e-14
"""Of 0.1 um/s: what rounding leaves of exact speeds."""
BLOCK_S = 0.016
"""Length of the blocks from whose means smooth noise is learnt."""
MIN_BLOCKS = 12.0
"""Blocks before smooth noise counts."""
MIN_VARIANCE_MEMORY_S = 8.0
"""Memory of the least scatter of means. Motion of the needle adds to the scatter, so
the least counts (minimum statistics, Martin 2001)."""
MAX_FORGETTING = 50.0
"""Largest exponent of that memory over one block, against overflow."""
INNOVATION_MEMORY_S = 0.05
"""Averaging time of the standardised innovations."""
SIGNIFICANT_INNOVATION = 4.0
"""Squared mean innovation, over its variance, that chance does not explain."""
MAX_INNOVATION = 5.0
"""Deviations to which an innovation is clipped: one odd depth is no turn."""
INITIAL_DEPTH_VARIANCE_M2 = 1e-8
"""Of the depth at the first sample, 0.1 mm squared."""
INITIAL_SPEED_VARIANCE_M2_PER_S2 = 1e-2
"""Of the speed at the first sample, a tenth of a metre per second squared."""

DEPTH = 0
"""Place in `TravelState.noises` of the noise of single depths."""
SPEED = 1
"""Place of the noise of single measured speeds."""
DEPTH_MEANS = 2
"""Place of the noise of depth means over a block."""
SPEED_MEANS = 3
"""Place of the noise of speed means over a block."""


@dataclass(slots=True)
class LearnedNoise:
    """Noise of a signal, as learnt from its values.

    Attributes:
        variance: Of single values.
        count: Number of values it rests on, at most those within the memory.
        value: The last value.
        value_before: The one before.
        dt_s: Time between the two, 0 while there are none.
        min_variance: Least variance of late; learnt of means only.
        has_value: Whether there is a last value: before the first one there is none.
    """

    variance: float = 0.0
    count: float = 0.0
    value: float = 0.0
    value_before: float = 0.0
    dt_s: float = 0.0
    min_variance: float = 0.0
    has_value: bool = False

    def find_damage(self) -> str:
        """Return what is wrong with a restored noise, if anything."""
        return "" if self.count >= 0.0 else f"{self.count} values, expected 0 or more"


@dataclass(slots=True)
class TravelState:
    """Depth and speed with their covariance, and what is learnt of the noise.

    Attributes:
        depth_m: Estimated depth.
        speed_m_s: Estimated speed.
        depth_variance: Variance of the depth, 0 before the first sample.
        covariance: Of depth and speed.
        speed_variance: Variance of the speed.
        depth_noise: Part of ``depth_variance`` that is due to noise of the samples.
        noise_covariance: The same part of ``covariance``.
        speed_noise: The same part of ``speed_variance``.
        depth_innovation: Mean of the latest standardised innovations of the depth.
        speed_innovation: The same of a measured speed.
        block_s: Length of the block of means that is being filled.
        block_samples: Samples in it.
        block_depth_sum_m: Sum of their depths.
        block_speed_sum_m_s: Sum of their speeds.
        noises: Noise of depth, speed, depth means and speed means.
    """

    depth_m: float = 0.0
    speed_m_s: float = 0.0
    depth_variance: float = 0.0
    covariance: float = 0.0
    speed_variance: float = 0.0
    depth_noise: float = 0.0
    noise_covariance: float = 0.0
    speed_noise: float = 0.0
    depth_innovation: float = 0.0
    speed_innovation: float = 0.0
    block_s: float = 0.0
    block_samples: float = 0.0
    block_depth_sum_m: float = 0.0
    block_speed_sum_m_s: float = 0.0
    noises: tuple[LearnedNoise, LearnedNoise, LearnedNoise, LearnedNoise] = (
        LearnedNoise(),
        LearnedNoise(),
        LearnedNoise(),
        LearnedNoise(),
    )


class Travel(NamedTuple):
    """Filtered motion of the tip.

    Attributes:
        depth_m: Depth.
        speed_m_s: Speed.
        depth_std_m: Standard deviation that noise of the samples leaves in the depth.
        speed_std_m_s: The same of the speed.
    """

    depth_m: float
    speed_m_s: float
    depth_std_m: float
    speed_std_m_s: float


@compiled_inside
def learn_noise(noise: LearnedNoise, value: float, dt_s: float, floor: float) -> None:
    """Learn the noise of a signal from one value, `dt_s` after the last one.

    With weights a, 1 - a of its neighbours the middle of three values is off their line
    by 1 + a^2 + (1 - a)^2 times the variance of one. Three equal values are those of a
    needle at rest, or rounded: they say nothing. The variance stays above `floor`.
    """
    middle = noise.value
    first = noise.value_before
    is_constant = value == middle and middle == first
    if noise.dt_s > 0.0 and not is_constant:
        weight = noise.dt_s / (noise.dt_s + dt_s)
        distance = middle - (weight * value + (1.0 - weight) * first)
        square = (
            distance
            * distance
            / (1.0 + weight * weight + (1.0 - weight) * (1.0 - weight))
        )
        if noise.count >= CLIPPED_AFTER:
            square = min(square, MAX_SQUARE * noise.variance)
        noise.count = min(noise.count + 1.0, max(NOISE_MEMORY_S / dt_s, CLIPPED_AFTER))
        variance = noise.variance + (square - noise.variance) / noise.count
        noise.variance = max(variance, floor)
    noise.value = value
    noise.value_before = middle
    noise.dt_s = dt_s if noise.has_value else 0.0
    noise.has_value = True


@compiled_inside
def learn_smooth_noise(
    noise: LearnedNoise, mean: float, dt_s: float, floor: float
) -> None:
    """Learn from a block's mean the noise of means, and its least variance of late."""
    learn_noise(noise, mean, dt_s, floor)
    if noise.count < MIN_BLOCKS:
        return
    forgetting = min(dt_s / MIN_VARIANCE_MEMORY_S, MAX_FORGETTING)
    risen = noise.min_variance * math.exp(forgetting)
    # The least of a few variances is too small.
    has_enough = noise.count >= CLIPPED_AFTER
    noise.min_variance = min(noise.variance, risen) if has_enough else noise.variance


@compiled
def white_variance(single: LearnedNoise, means: LearnedNoise, dt_s: float) -> float:
    """Return the variance of white noise as strong as that of single values and means.

    Of smooth noise a block is one sample.
    """
    return max(single.variance, means.min_variance * BLOCK_S / dt_s)


@compiled_inside
def learn_from_block(
    state: TravelState,
    depth_m: float,
    speed_m_s: float,
    dt_s: float,
    is_speed_measured: bool,
) -> None:
    """Add a sample to the block of means, and learn smooth noise from a full one."""
    state.block_s += dt_s
    state.block_samples += 1.0
    state.block_depth_sum_m += depth_m
    state.block_speed_sum_m_s += speed_m_s
    if state.block_s < BLOCK_S:
        return
    mean_m = state.block_depth_sum_m / state.block_samples
    learn_smooth_noise(
        state.noises[DEPTH_MEANS], mean_m, state.block_s, MIN_DEPTH_VARIANCE_M2
    )
    if is_speed_measured:
        mean_m_s = state.block_speed_sum_m_s / state.block_samples
        learn_smooth_noise(
            state.noises[SPEED_MEANS],
            mean_m_s,
            state.block_s,
            MIN_SPEED_VARIANCE_M2_PER_S2,
        )
    state.block_s = 0.0
    state.block_samples = 0.0
    state.block_depth_sum_m = 0.0
    state.block_speed_sum_m_s = 0.0


@compiled_inside
def acceleration_density(state: TravelState, gain: float) -> float:
    """Return the spectral density of the acceleration [m²/s³].

    It is larger where innovations that keep their sign show a start or a stop. `gain`
    is the weight of a new innovation in their mean.
    """
    innovation = max(abs(state.depth_innovation), abs(state.speed_innovation))
    significance = (
        innovation * innovation * (2.0 - gain) / gain / SIGNIFICANT_INNOVATION
    )
    return max(significance, 1.0) ** 2 * ACCELERATION_M2_PER_S3


@compiled_inside
def start_travel(
    state: TravelState, depth_m: float, speed_m_s: float, noise_variance: float
) -> None:
    """Begin the filter anew at a sample."""
    state.depth_m = depth_m
    state.speed_m_s = speed_m_s
    state.depth_variance = INITIAL_DEPTH_VARIANCE_M2
    state.covariance = 0.0
    state.speed_variance = INITIAL_SPEED_VARIANCE_M2_PER_S2
    state.depth_noise = noise_variance
    state.noise_covariance = 0.0
    state.speed_noise = 0.0
    state.depth_innovation = 0.0
    state.speed_innovation = 0.0


@compiled_inside
def predict_travel(state: TravelState, dt_s: float, density: float) -> None:
    """Predict depth and speed over a time step; exact for white acceleration."""
    state.depth_m += state.speed_m_s * dt_s
    state.depth_variance += dt_s * (
        2.0 * state.covariance + dt_s * state.speed_variance
    )
    state.depth_variance += density * dt_s**3 / 3.0
    state.covariance += dt_s * state.speed_variance + density * dt_s * dt_s / 2.0
    state.speed_variance += density * dt_s
    state.depth_noise += dt_s * (
        2.0 * state.noise_covariance + dt_s * state.speed_noise
    )
    state.noise_covariance += dt_s * state.speed_noise


@compiled_inside
def standardise(innovation: float, variance: float) -> float:
    """Return an innovation in standard deviations, clipped."""
    ratio = innovation / math.sqrt(variance)
    return min(max(ratio, -MAX_INNOVATION), MAX_INNOVATION)


@compiled_inside
def correct_by_depth(state: TravelState, depth_m: float, variance: float) -> float:
    """Use a measured depth; return its standardised innovation."""
    total = state.depth_variance + variance
    innovation_m = depth_m - state.depth_m
    gain = state.depth_variance / total
    speed_gain = state.covariance / total
    complement = 1.0 - gain
    state.depth_m += gain * innovation_m
    state.speed_m_s += speed_gain * innovation_m
    state.speed_variance -= speed_gain * state.covariance
    state.depth_variance *= complement
    state.covariance *= complement

    noise = state.depth_noise
    noise_covariance = state.noise_covariance
    state.depth_noise = complement * complement * noise + gain * gain * variance
    state.noise_covariance = (
        complement * (noise_covariance - speed_gain * noise)
        + gain * speed_gain * variance
    )
    state.speed_noise += speed_gain * (
        speed_gain * (noise + variance) - 2.0 * noise_covariance
    )
    return standardise(innovation_m, total)


@compiled_inside
def correct_by_speed(state: TravelState, speed_m_s: float, variance: float) -> float:
    """Use a measured speed; return its standardised innovation."""
    total = state.speed_variance + variance
    innovation_m_s = speed_m_s - state.speed_m_s
    gain = state.speed_variance / total
    depth_gain = state.covariance / total
    complement = 1.0 - gain
    state.speed_m_s += gain * innovation_m_s
    state.depth_m += depth_gain * innovation_m_s
    state.depth_variance -= depth_gain * state.covariance
    state.speed_variance *= complement
    state.covariance *= complement

    noise = state.speed_noise
    noise_covariance = state.noise_covariance
    state.speed_noise = complement * complement * noise + gain * gain * variance
    state.noise_covariance = (
        complement * (noise_covariance - depth_gain * noise)
        + gain * depth_gain * variance
    )
    state.depth_noise += depth_gain * (
        depth_gain * (noise + variance) - 2.0 * noise_covariance
    )
    return standardise(innovation_m_s, total)


@compiled
def filter_travel(
    depth_m: float,
    speed_m_s: float,
    dt_s: float,
    is_speed_measured: bool,
    gap_s: float,
    state: TravelState,
) -> Travel:
    """Use one checked sample; time steps may differ, the filter is exact for each.

    After a step longer than `gap_s` the filter begins anew.
    """
    gain = -math.expm1(-dt_s / INNOVATION_MEMORY_S)
    learn_noise(state.noises[DEPTH], depth_m, dt_s, MIN_DEPTH_VARIANCE_M2)
    variance = white_variance(state.noises[DEPTH], state.noises[DEPTH_MEANS], dt_s)
    variance = max(variance, MIN_DEPTH_VARIANCE_M2)
    # Three samples teach the first noise. A filter that began without would take its
    # first samples for exact.
    is_noise_known = state.noises[DEPTH].count > 0.0
    if state.depth_variance == 0.0 or dt_s > gap_s or not is_noise_known:
        start_travel(state, depth_m, speed_m_s if is_speed_measured else 0.0, variance)
    else:
        predict_travel(state, dt_s, acceleration_density(state, gain))
        innovation = correct_by_depth(state, depth_m, variance)
        state.depth_innovation += gain * (innovation - state.depth_innovation)

    if is_speed_measured:
        learn_noise(state.noises[SPEED], speed_m_s, dt_s, MIN_SPEED_VARIANCE_M2_PER_S2)
    if is_speed_measured and state.noises[SPEED].count > 0.0:
        variance = white_variance(state.noises[SPEED], state.noises[SPEED_MEANS], dt_s)
        innovation = correct_by_speed(state, speed_m_s, variance)
        state.speed_innovation += gain * (innovation - state.speed_innovation)
    learn_from_block(state, depth_m, speed_m_s, dt_s, is_speed_measured)

    depth_noise = max(state.depth_noise, 0.0)
    speed_noise = max(state.speed_noise, 0.0)
    return Travel(
        state.depth_m, state.speed_m_s, math.sqrt(depth_noise), math.sqrt(speed_noise)
    )


ProcessedSample = tuple[int, float, float, float, float, float, float, float]
"""Of a raw sample: its status, an index in `STATUSES`; where it is used the time since
the one used before [s]; time since the reset [s]; depth, jumps removed [m]; and the
fields of its `Travel`. A plain tuple, which the one caller unpacks at once: a named one
would cost it a microsecond."""


@compiled
def process_sample(
    depth_m: float,
    speed_m_s: float,
    force_N: float,
    dt_s: float,
    is_speed_measured: bool,
    limits: list[CheckConfig],
    checks: list[CheckState],
    travels: list[TravelState],
) -> ProcessedSample:
    """Check one raw sample and, if it can be used, filter its depth and speed.

    Depth, speed, force and time step are as `Identifier.update` takes them. A speed
    that is not measured is the last estimate, which contradicts no depth. The three
    records are lists of one each (see `foundation.records`).
    """
    check = checks[0]
    travel = travels[0]
    speed_m_s = speed_m_s if is_speed_measured else travel.speed_m_s
    sample = RawSample(depth_m, speed_m_s, force_N, dt_s, is_speed_measured)
    result = check_sample(sample, check, travel.speed_m_s, limits[0])
    depth_m = depth_m - check.removed_m
    motion = Travel(0.0, 0.0, 0.0, 0.0)
    if is_used(result.status):
        motion = filter_travel(
            depth_m,
            speed_m_s,
            result.elapsed_s,
            is_speed_measured,
            shortest_gap(check, limits[0]),
            travel,
        )
    return (
        result.status,
        result.elapsed_s,
        check.time_s,
        depth_m,
        motion.depth_m,
        motion.speed_m_s,
        motion.depth_std_m,
        motion.speed_std_m_s,
    )
