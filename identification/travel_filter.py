"""Depth and speed of the tip: a Kalman filter that learns the noise of its samples.

The state is depth and speed, driven by white acceleration. Every sample measures the
depth, and the speed where the robot reports it. The noise of either is learnt from the
distance of a sample to the line between its neighbours: a needle does not leave that
line within milliseconds. Noise of filtered positions, or of a coarse encoder, is
smooth, and so is that of a speed made from them: it is learnt from the scatter of means
over 16 ms.
"""

import math
from dataclasses import dataclass, field

from foundation.jit import compiled, compiled_inside
from identification.config import CheckConfig
from identification.sample_check import (
    OK,
    TIME_GAP,
    CheckState,
    check_sample,
    shortest_gap,
)

CLIPPED_AFTER = 50.0
"""After so many values a square is clipped."""
MIN_DEPTH_VARIANCE_M2 = 1e-16
"""Of 0.01 um: what rounding leaves of exact depths."""
MIN_SPEED_VARIANCE_M2_PER_S2 = 1e-14
"""Of 0.1 um/s: what rounding leaves of exact speeds."""
BLOCK_S = 0.016
"""Length of the blocks from whose means smooth noise is learnt."""


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


@dataclass(slots=True)
class Quantity:
    """Depth or speed as it is filtered, and the noise of its samples.

    Attributes:
        value: Estimate [m] or [m/s].
        variance: Variance of the estimate; of the depth 0 before the first sample.
        noise: Part of ``variance`` that is due to noise of the samples.
        innovation: Mean of the latest standardised innovations.
        single: Noise of single samples.
        means: Noise of means over a block.
        block_sum: Sum of the samples in the block being filled.
    """

    value: float = 0.0
    variance: float = 0.0
    noise: float = 0.0
    innovation: float = 0.0
    single: LearnedNoise = field(default_factory=LearnedNoise)
    means: LearnedNoise = field(default_factory=LearnedNoise)
    block_sum: float = 0.0


@dataclass(slots=True)
class TravelState:
    """Depth and speed with their covariance, and what is learnt of the noise.

    Attributes:
        depth: Of the tip.
        speed: Its rate.
        covariance: Of depth and speed.
        noise_covariance: Part of it that is due to noise of the samples.
        block_s: Length of the block of means that is being filled.
        block_samples: Samples in it.
    """

    depth: Quantity = field(default_factory=Quantity)
    speed: Quantity = field(default_factory=Quantity)
    covariance: float = 0.0
    noise_covariance: float = 0.0
    block_s: float = 0.0
    block_samples: float = 0.0


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
            # More is motion or a slip, no noise.
            square = min(square, 9.0 * noise.variance)
        noise.count = min(noise.count + 1.0, max(2.0 / dt_s, CLIPPED_AFTER))
        variance = noise.variance + (square - noise.variance) / noise.count
        noise.variance = max(variance, floor)
    noise.value = value
    noise.value_before = middle
    noise.dt_s = dt_s if noise.has_value else 0.0
    noise.has_value = True


@compiled_inside
def learn_smooth_noise(quantity: Quantity, state: TravelState, floor: float) -> None:
    """Learn from a full block the noise of means, and its least variance of late.

    Motion of the needle adds to the scatter of means, so the least counts (minimum
    statistics, Martin 2001).
    """
    means = quantity.means
    learn_noise(means, quantity.block_sum / state.block_samples, state.block_s, floor)
    if means.count < 12.0:  # too few blocks
        return
    forgetting = min(state.block_s / 8.0, 50.0)  # its exponential is finite
    risen = means.min_variance * math.exp(forgetting)
    # The least of a few variances is too small.
    has_enough = means.count >= CLIPPED_AFTER
    means.min_variance = min(means.variance, risen) if has_enough else means.variance


@compiled
def white_variance(quantity: Quantity, dt_s: float) -> float:
    """Return the variance of white noise as strong as that of single values and means.

    Of smooth noise a block is one sample.
    """
    smooth = quantity.means.min_variance * BLOCK_S / dt_s
    return max(quantity.single.variance, smooth)


@compiled_inside
def learn_from_block(
    state: TravelState,
    depth_m: float,
    speed_m_s: float,
    dt_s: float,
    is_speed_measured: bool,
) -> None:
    """Add a sample to the block of means, and learn smooth noise from a full one."""
    depth = state.depth
    speed = state.speed
    state.block_s += dt_s
    state.block_samples += 1.0
    depth.block_sum += depth_m
    speed.block_sum += speed_m_s
    if state.block_s < BLOCK_S:
        return
    learn_smooth_noise(depth, state, MIN_DEPTH_VARIANCE_M2)
    if is_speed_measured:
        learn_smooth_noise(speed, state, MIN_SPEED_VARIANCE_M2_PER_S2)
    state.block_s = 0.0
    state.block_samples = 0.0
    depth.block_sum = 0.0
    speed.block_sum = 0.0


@compiled_inside
def acceleration_density(state: TravelState, gain: float) -> float:
    """Return the spectral density of the acceleration [m²/s³].

    The speed changes by half a millimetre per second in 0.1 s, one standard deviation;
    more where innovations that keep their sign show a start or a stop. `gain` is the
    weight of a new innovation in their mean.
    """
    innovation = max(abs(state.depth.innovation), abs(state.speed.innovation))
    # Chance does not explain more than four times the variance of the mean.
    significance = innovation * innovation * (2.0 - gain) / gain / 4.0
    return max(significance, 1.0) ** 2 * 2e-7


@compiled_inside
def start_travel(
    state: TravelState, depth_m: float, speed_m_s: float, noise_variance: float
) -> None:
    """Begin the filter anew at a sample."""
    depth = state.depth
    speed = state.speed
    depth.value = depth_m
    depth.variance = 1e-8  # 0.1 mm squared
    depth.noise = noise_variance
    depth.innovation = 0.0
    speed.value = speed_m_s
    speed.variance = 1e-2  # a tenth of a metre per second squared
    speed.noise = 0.0
    speed.innovation = 0.0
    state.covariance = 0.0
    state.noise_covariance = 0.0


@compiled_inside
def predict_travel(state: TravelState, dt_s: float, density: float) -> None:
    """Predict depth and speed over a time step; exact for white acceleration."""
    depth = state.depth
    speed = state.speed
    depth.value += speed.value * dt_s
    depth.variance += dt_s * (2.0 * state.covariance + dt_s * speed.variance)
    depth.variance += density * dt_s**3 / 3.0
    state.covariance += dt_s * speed.variance + density * dt_s * dt_s / 2.0
    speed.variance += density * dt_s
    depth.noise += dt_s * (2.0 * state.noise_covariance + dt_s * speed.noise)
    state.noise_covariance += dt_s * speed.noise


@compiled_inside
def correct(
    state: TravelState,
    own: Quantity,
    other: Quantity,
    measured: float,
    variance: float,
    gain_of_mean: float,
) -> None:
    """Use a measurement of depth or speed.

    Args:
        state: That is corrected.
        own: Quantity of the state that is measured.
        other: Other quantity of the state.
        measured: Measurement.
        variance: Of the noise of the measurement.
        gain_of_mean: Weight of an innovation in the mean of the latest.
    """
    total = own.variance + variance
    innovation = measured - own.value
    gain = own.variance / total
    other_gain = state.covariance / total
    complement = 1.0 - gain
    own.value += gain * innovation
    other.value += other_gain * innovation
    other.variance -= other_gain * state.covariance
    own.variance *= complement
    state.covariance *= complement

    noise = own.noise
    noise_covariance = state.noise_covariance
    own.noise = complement * complement * noise + gain * gain * variance
    state.noise_covariance = (
        complement * (noise_covariance - other_gain * noise)
        + gain * other_gain * variance
    )
    other.noise += other_gain * (
        other_gain * (noise + variance) - 2.0 * noise_covariance
    )
    ratio = innovation / math.sqrt(total)
    standardised = min(max(ratio, -5.0), 5.0)  # one odd sample is no turn
    own.innovation += gain_of_mean * (standardised - own.innovation)


@compiled
def filter_travel(
    depth_m: float,
    speed_m_s: float,
    dt_s: float,
    is_speed_measured: bool,
    gap_s: float,
    state: TravelState,
) -> None:
    """Use one checked sample; time steps may differ, the filter is exact for each.

    After a step longer than `gap_s` the filter begins anew.
    """
    depth = state.depth
    speed = state.speed
    gain = -math.expm1(-dt_s / 0.05)  # of standardised innovations in their mean
    learn_noise(depth.single, depth_m, dt_s, MIN_DEPTH_VARIANCE_M2)
    variance = max(white_variance(depth, dt_s), MIN_DEPTH_VARIANCE_M2)
    # Three samples teach the first noise. A filter that began without would take its
    # first samples for exact.
    is_noise_known = depth.single.count > 0.0
    if depth.variance == 0.0 or dt_s > gap_s or not is_noise_known:
        start_travel(state, depth_m, speed_m_s if is_speed_measured else 0.0, variance)
    else:
        predict_travel(state, dt_s, acceleration_density(state, gain))
        correct(state, depth, speed, depth_m, variance, gain)
    if is_speed_measured:
        learn_noise(speed.single, speed_m_s, dt_s, MIN_SPEED_VARIANCE_M2_PER_S2)
        if speed.single.count > 0.0:
            variance = white_variance(speed, dt_s)
            correct(state, speed, depth, speed_m_s, variance, gain)
    learn_from_block(state, depth_m, speed_m_s, dt_s, is_speed_measured)


ProcessedSample = tuple[int, float, float, float, float, float, float, float]
"""Of a raw sample: its status, an index in `STATUSES`; where it is used the time since
the one used before [s]; time since the reset [s]; depth, jumps removed [m]; depth [m]
and speed [m/s] as filtered, and the standard deviations that noise of the samples
leaves in both. A plain tuple, which the one caller unpacks at once: a named one would
cost it a microsecond."""


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
    estimated_m_s = travel.speed.value
    speed_m_s = speed_m_s if is_speed_measured else estimated_m_s
    status, elapsed_s = check_sample(
        depth_m,
        speed_m_s,
        force_N,
        dt_s,
        is_speed_measured,
        check,
        estimated_m_s,
        limits[0],
    )
    depth_m = depth_m - check.removed_m
    if status in (OK, TIME_GAP):
        gap_s = shortest_gap(check, limits[0])
        filter_travel(depth_m, speed_m_s, elapsed_s, is_speed_measured, gap_s, travel)
    return (
        status,
        elapsed_s,
        check.time_s,
        depth_m,
        travel.depth.value,
        travel.speed.value,
        math.sqrt(max(travel.depth.noise, 0.0)),
        math.sqrt(max(travel.speed.noise, 0.0)),
    )
