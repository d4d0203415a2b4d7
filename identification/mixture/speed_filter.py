"""The speed that the force model takes: of the depth, over half a second.

Noise of a regressor passes for knowledge (errors in variables): where the speed hardly
changes, jitter of 0.02 mm/s and a thousand forces with noise of a few mN seem to show
that friction is the same at all speeds. So a slower Kalman filter (depth, speed,
acceleration; white jerk) follows the depth. It is quicker where its innovations keep
their sign: at a start, a stop, a reversal.
"""

import math
from typing import NamedTuple

import numpy as np

from foundation.arrays import WrittenMatrix, WrittenVector
from foundation.jit import compiled, compiled_inside
from foundation.linear_algebra import multiply, multiply_transposed, multiply_vector

JERK_MM2_PER_S5 = 1e-4
"""Spectral density of the jerk."""

MEMORY_S = 0.2
"""Time over which innovations are averaged."""

MAX_INNOVATION = 5.0
"""Standard deviations that one innovation counts at most."""

SIGNIFICANT_INNOVATION = 16.0
"""Square of a mean innovation, in units of its variance, from which on the filter is
quicker."""

MAX_BESIDE_SIGMAS = 4.0
"""Standard deviations of the filtered speed's noise by which this speed may lie beside
it, less where the filter must be quick."""

LOST_SIGMAS = 12.0
"""Standard deviations from which on, as after a hard stop, the filter begins anew."""

INITIAL_INNOVATION = 2.0
"""Mean innovation with which it begins, so that it is quick at first."""

WHITE_DENSITY_FACTOR = 0.545
"""Of white noise of density r a steady filter of bandwidth w leaves the variances
1.06 r w in the depth and 0.354 r w³ in the speed: r is this times the cube of the
first deviation over the second."""

MIN_DENSITY_MM2_S = 1e-12
"""Density of the depth's noise, at least."""

MIN_SPEED_STD_MM_S = 1e-9
"""Deviation of the speed's noise, at least."""

MIN_SPEED_VARIANCE = 1e-8
"""Variance of the speed when the filter begins, at least [mm²/s²]."""

INITIAL_ACCELERATION_VARIANCE = 100.0
"""Variance of the acceleration when the filter begins [mm²/s⁴]."""

STATES = 3
"""Depth, speed, acceleration."""


class SpeedFilter(NamedTuple):
    """State of the filter; before the first block its covariance is zero.

    Attributes:
        mean: Depth [mm], speed [mm/s] and acceleration [mm/s²], shape (3,).
        covariance: Theirs, shape (3, 3).
        innovation: Mean of the latest standardised innovations.
    """

    mean: WrittenVector
    covariance: WrittenMatrix
    innovation: float


FIRST_SPEED_FILTER = SpeedFilter(np.zeros(STATES), np.zeros((STATES, STATES)), 0.0)
"""The filter before the first block."""


@compiled_inside
def begin_speed_filter(
    state: SpeedFilter,
    depth: float,
    speed: float,
    density: float,
    speed_std: float,
    duration_s: float,
) -> SpeedFilter:
    """Return the filter begun anew at a block; the arguments as in `filter_speed`.

    `density` is that of the depth's white noise [mm² s].
    """
    mean = np.zeros(STATES)
    mean[0] = depth
    mean[1] = speed
    covariance = np.zeros((STATES, STATES))
    covariance[0, 0] = density / duration_s
    covariance[1, 1] = 4.0 * speed_std**2 + MIN_SPEED_VARIANCE
    covariance[2, 2] = INITIAL_ACCELERATION_VARIANCE
    innovation = math.copysign(INITIAL_INNOVATION, speed - state.mean[1])
    return SpeedFilter(mean, covariance, innovation)


@compiled
def filter_speed(
    state: SpeedFilter,
    depth: float,
    speed: float,
    depth_std: float,
    speed_std: float,
    duration_s: float,
) -> tuple[float, SpeedFilter]:
    """Return the speed for the force model at the next block, and the filter then.

    Args:
        state: The filter at the block before.
        depth: Mean depth of the block [mm].
        speed: Filtered speed [mm/s].
        depth_std: Standard deviation that noise leaves in the filtered depth [mm].
        speed_std: The same of the filtered speed [mm/s]. Both say how noisy the depth
            is, see `WHITE_DENSITY_FACTOR`.
        duration_s: Length of the block.
    """
    density = WHITE_DENSITY_FACTOR * depth_std**3 / max(speed_std, MIN_SPEED_STD_MM_S)
    density += MIN_DENSITY_MM2_S
    is_lost = abs(state.mean[1] - speed) > LOST_SIGMAS * speed_std
    if state.covariance[0, 0] == 0.0 or is_lost:
        return speed, begin_speed_filter(
            state, depth, speed, density, speed_std, duration_s
        )
    gain = -math.expm1(-duration_s / MEMORY_S)
    usual_square = SIGNIFICANT_INNOVATION * gain / (2.0 - gain)
    haste = max(state.innovation**2 / usual_square, 1.0)
    t = duration_s
    transition = np.eye(STATES)
    transition[0, 1] = t
    transition[0, 2] = 0.5 * t * t
    transition[1, 2] = t
    jerk = haste**2 * JERK_MM2_PER_S5
    mean = multiply_vector(transition, state.mean)
    covariance = multiply_transposed(multiply(transition, state.covariance), transition)
    for i in range(STATES):
        for j in range(STATES):
            part = transition[i, 2] * transition[j, 2] / (5.0 - i - j)
            covariance[i, j] += jerk * t * part
    total = covariance[0, 0] + density / duration_s
    error = depth - mean[0]
    gain_by_state = covariance[0].copy()
    for i in range(STATES):
        gain_by_state[i] /= total
    cross_covariance = covariance[0].copy()
    for i in range(STATES):
        mean[i] += gain_by_state[i] * error
        for j in range(STATES):
            covariance[i, j] -= cross_covariance[i] * gain_by_state[j]
    standardised = error / math.sqrt(total)
    standardised = min(max(standardised, -MAX_INNOVATION), MAX_INNOVATION)
    innovation = state.innovation + gain * (standardised - state.innovation)
    beside = MAX_BESIDE_SIGMAS * speed_std / max(innovation**2 / usual_square, 1.0)
    own_speed = min(max(mean[1], speed - beside), speed + beside)
    return own_speed, SpeedFilter(mean, covariance, innovation)
