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
    behind = momentum - smooth
    distance = behind / noise
    square = distance * distance
    # rate = bandwidth dt (1 + (distance / knee)^4), behind rate / (1 + rate) the implicit step,
    # which never overshoots; both divided by bandwidth dt / knee^4 to spare operations.
    unit = KNEE_SIGMAS**4
    rate = square * square + unit
    return smooth + behind * (rate / (rate + unit / (BANDWIDTH_PER_S * dt_s)))
