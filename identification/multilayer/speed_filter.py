"""The speed that the law takes: of the depth, over half a second where it changes
slowly.

Noise of a regressor passes for knowledge (errors in variables): where the speed hardly
changes, a thousand forces of a few mN find in jitter of 0.02 mm/s that friction is the
same at all speeds. So a slower Kalman filter (depth, speed, acceleration; white jerk)
follows the depth, quicker where its innovations keep their sign: at a start, a stop, a
reversal.
"""

import math

import numpy as np

from foundation.arrays import Array, Vector
from foundation.jit import compiled

_JERK = 1e-4  # spectral density of the jerk [mm²/s⁵]
_MEMORY_S = 0.2
_MOST_SURPRISE = 5.0
_SIGNIFICANT = 16.0
"""Time over which innovations are averaged; standard deviations that one of them counts
at most; square of such a mean, in units of its variance, from which on the filter is
quicker."""
_WIDEST = 4.0
_LOST = 12.0
_HASTY = 2.0
"""Standard deviations of the filtered speed's noise by which the trend may lie beside
it, less where it must be quick; from which on, as after a hard stop, it begins anew;
and the mean innovation with which it does, so that it is quick at first."""
# Places in a trend: depth, speed, acceleration; their covariance, row by row; smoothed
# innovation.
_SPEED = 1
_SPREAD = slice(3, 12)
_SURPRISE = 12
_SIZE = 13

NO_TREND = np.zeros(_SIZE)
NO_TREND.setflags(write=False)


@compiled
def follow_speed(
    trend: Vector, depth: float, speed: float, noise: tuple[float, float], dt_s: float
) -> tuple[float, Array]:
    """Speed for the law at the next block's mean depth [mm] and filtered speed [mm/s].

    `noise` holds the standard deviations that `travel_filter` leaves in both. It says
    how noisy the depth is: of white noise of density r a steady filter of bandwidth w
    leaves the variances 1.06 r w in the depth and 0.354 r w³ in the speed.

    Returns the speed, and the trend, of shape (13,); before the first block it is zero.
    """
    depth_std, speed_std = noise
    white = 0.545 * depth_std**3 / max(speed_std, 1e-9) + 1e-12
    now = np.zeros(_SIZE)
    if trend[3] == 0.0 or abs(trend[_SPEED] - speed) > _LOST * speed_std:
        now[:3] = depth, speed, 0.0
        now[3] = white / dt_s
        now[7] = 4.0 * speed_std**2 + 1e-8
        now[11] = 100.0
        now[_SURPRISE] = math.copysign(_HASTY, speed - trend[_SPEED])
        return speed, now
    gain = -math.expm1(-dt_s / _MEMORY_S)
    least = _SIGNIFICANT * gain / (2.0 - gain)
    quicker = max(trend[_SURPRISE] ** 2 / least, 1.0)
    t = dt_s
    jerk = quicker**2 * _JERK
    step = np.array([[1.0, t, 0.5 * t * t], [0.0, 1.0, t], [0.0, 0.0, 1.0]])
    row = np.array([t * t / 2.0, t, 1.0])
    state = np.dot(step, trend[:3])
    spread = trend[_SPREAD].copy().reshape(3, 3)
    spread = np.dot(step, np.dot(step, spread).T)
    for i in range(3):
        for j in range(3):
            spread[i, j] += jerk * t * row[i] * row[j] / (5.0 - i - j)
    total = spread[0, 0] + white / dt_s
    error = depth - state[0]
    cross = spread[0].copy()
    now[:3] = state + cross * (error / total)
    now[_SPREAD] = (spread - np.outer(cross, cross / total)).ravel()
    surprise = min(max(error / math.sqrt(total), -_MOST_SURPRISE), _MOST_SURPRISE)
    now[_SURPRISE] = trend[_SURPRISE] + gain * (surprise - trend[_SURPRISE])
    width = _WIDEST * speed_std / max(now[_SURPRISE] ** 2 / least, 1.0)
    return min(max(now[_SPEED], speed - width), speed + width), now
