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

from foundation.arrays import Matrix, Vector
from foundation.jit import compiled
from foundation.linear_algebra import multiply, multiply_transposed, multiply_vector


class SpeedFilter(NamedTuple):
    """State of the filter; before the first block its covariance is zero.

    Attributes:
        mean: Depth [mm], speed [mm/s] and acceleration [mm/s²], shape (3,).
        covariance: Theirs, shape (3, 3).
        innovation: Mean of the latest standardised innovations.
    """

    mean: Vector
    covariance: Matrix
    innovation: float


FIRST_SPEED_FILTER = SpeedFilter(np.zeros(3), np.zeros((3, 3)), 0.0)
"""The filter before the first block."""


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
            is: of white noise of density r a steady filter of bandwidth w leaves the
            variances 1.06 r w in the depth and 0.354 r w³ in the speed.
        duration_s: Length of the block.
    """
    density = 0.545 * depth_std**3 / max(speed_std, 1e-9)  # r [mm² s]
    density += 1e-12
    is_lost = abs(state.mean[1] - speed) > 12.0 * speed_std  # as after a hard stop
    if state.covariance[0, 0] == 0.0 or is_lost:
        mean = np.array([depth, speed, 0.0])
        variances = (density / duration_s, 4.0 * speed_std**2 + 1e-8, 100.0)
        covariance = np.diag(np.array(variances))
        innovation = math.copysign(2.0, speed - state.mean[1])  # quick at first
        return speed, SpeedFilter(mean, covariance, innovation)
    gain = -math.expm1(-duration_s / 0.2)  # of the mean innovation
    # The filter is quicker where the square of a mean innovation exceeds 16 variances.
    usual_square = 16.0 * gain / (2.0 - gain)
    haste = max(state.innovation**2 / usual_square, 1.0)
    t = duration_s
    transition = np.array([[1.0, t, 0.5 * t * t], [0.0, 1.0, t], [0.0, 0.0, 1.0]])
    jerk = haste**2 * 1e-4  # spectral density [mm²/s⁵]
    mean = multiply_vector(transition, state.mean)
    covariance = multiply_transposed(multiply(transition, state.covariance), transition)
    for i in range(3):
        for j in range(3):
            part = transition[i, 2] * transition[j, 2] / (5.0 - i - j)
            covariance[i, j] += jerk * t * part
    total = covariance[0, 0] + density / duration_s
    error = depth - mean[0]
    cross_covariance = covariance[0].copy()
    gain_by_state = cross_covariance / total
    mean += gain_by_state * error
    covariance -= np.outer(cross_covariance, gain_by_state)
    standardised = min(max(error / math.sqrt(total), -5.0), 5.0)
    innovation = state.innovation + gain * (standardised - state.innovation)
    # It may lie so far beside the filtered speed, less where it must be quick.
    beside = 4.0 * speed_std / max(innovation**2 / usual_square, 1.0)
    own_speed = min(max(mean[1], speed - beside), speed + beside)
    return own_speed, SpeedFilter(mean, covariance, innovation)
