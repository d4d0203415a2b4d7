"""Quietens the momentum of an arm that hardly accelerates, and steps aside when it does.

During an insertion the arm's own inertial force is a few hundredths of a newton, but the noise of
the velocity, differentiated, is the largest noise of the residual. The momentum therefore passes a
lag whose bandwidth grows with the distance it has fallen behind, measured in the noise of the
momentum itself: within the noise it smooths, beyond it it lets through (compare the "one euro"
filter, Casiez et al., CHI 2012). Where no noise is known the momentum passes untouched.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

BANDWIDTH_PER_S = 10.0
"""Bandwidth at rest [1/s]: well below that of the torque, which alone carries a rupture."""
KNEE_SIGMAS = 3.0
"""Distance, in standard deviations of the momentum, at which the bandwidth has doubled."""

# Arrays without dimensions here and below: numpy is twice as fast with them as with floats.
_PER_KNEE = np.array(KNEE_SIGMAS**-4)


class SmoothingTick(NamedTuple):
    """What a step takes from the length of its tick, as arrays of shape ().

    Attributes:
        at_rest: 1 / (bandwidth at rest times tick).
        slack: 1 more than that.
    """

    at_rest: NDArray[np.float64]
    slack: NDArray[np.float64]


def smoothing_tick(dt_s: float) -> SmoothingTick:
    """For ticks of a length [s]."""
    slack = 1.0 + 1.0 / (BANDWIDTH_PER_S * dt_s)
    return SmoothingTick(np.array(slack - 1.0), np.array(slack))


def smoothing_step(
    smooth: NDArray[np.float64],
    momentum: NDArray[np.float64],
    noise: NDArray[np.float64],
    tick: SmoothingTick,
) -> NDArray[np.float64]:
    """One step of the adaptive lag.

    Args:
        smooth: Smoothed momentum before the tick, shape (n,).
        momentum: Momentum at its end, shape (n,).
        noise: Standard deviation of the momentum, shape (n,), positive.
        tick: Of its length.

    Returns:
        By how much the smoothed momentum is behind at the end of the tick, shape (n,).
    """
    # The bandwidth grows with the fourth power of distance / knee. The step is the implicit one,
    # which never overshoots: of what it is behind, 1 / (1 + rate) remains.
    behind = momentum - smooth
    rate = behind / noise
    rate *= rate
    rate *= rate
    rate *= _PER_KNEE
    rate += tick.slack
    behind /= rate
    behind *= tick.at_rest
    return behind
