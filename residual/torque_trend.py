"""Which way each torque went last: the state that a torque sensor's hysteresis depends on."""

import numpy as np
from numpy.typing import NDArray

SMOOTHING_S = 0.15
"""Lag of the torque whose trend is followed [s]: its noise is then well below the loop's width."""


def trend_step(
    trend: NDArray[np.float64], change: NDArray[np.float64], half_width: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Play operator: +1 once a signal has risen by the loop's width, -1 once it has fallen by it.

    It remembers at rest, as strain gauges do: friction of a joint would depend on its velocity,
    the hysteresis of its torque sensor depends on the torque.

    Args:
        trend: Before the change, -1 to 1, shape (loops, n).
        change: Of the signal, shape (n,).
        half_width: Half of each loop's width, in the signal's unit, shape (loops, n).

    Returns:
        Trend after the change, -1 to 1, shape (loops, n).
    """
    return np.minimum(np.maximum(trend + change / half_width, -1.0), 1.0)
