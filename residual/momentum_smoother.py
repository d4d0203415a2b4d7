"""Quietens the momentum of an arm that hardly accelerates, and steps aside when it does.

During an insertion the arm's own inertial force is a few hundredths of a newton, but the noise of
the velocity, differentiated, is the largest noise of the residual. The momentum therefore passes a
lag whose bandwidth grows with the distance it has fallen behind, measured in the noise of the
momentum itself: within the noise it smooths, beyond it it lets through (compare the "one euro"
filter, Casiez et al., CHI 2012). Where no noise is known the momentum passes untouched.
"""

import numpy as np
from numpy.typing import NDArray

BANDWIDTH_PER_S = 10.0
"""Bandwidth at rest [1/s]: well below that of the torque, which alone carries a rupture."""
KNEE_SIGMAS = 3.0
"""Distance, in standard deviations of the momentum, at which the bandwidth has doubled."""


def smoothing_step(
    smooth: NDArray[np.float64],
    momentum: NDArray[np.float64],
    noise: NDArray[np.float64],
    dt_s: float,
) -> NDArray[np.float64]:
    """One step of the adaptive lag.

    Args:
        smooth: Smoothed momentum before the tick, shape (n,).
        momentum: Momentum at its end, shape (n,).
        noise: Standard deviation of the momentum, shape (n,), positive.
        dt_s: Length of the tick [s].

    Returns:
        Smoothed momentum at the end of the tick, shape (n,).
    """
    # The bandwidth grows with the fourth power of distance / knee. The step is the implicit one,
    # which never overshoots: of what it is behind, 1 / (1 + rate) remains.
    slack = 1.0 + 1.0 / (BANDWIDTH_PER_S * dt_s)
    behind = momentum - smooth
    distance = behind / noise
    square = distance * distance
    square *= square
    square *= KNEE_SIGMAS**-4
    square += slack
    behind /= square
    behind *= slack - 1.0
    return momentum - behind
