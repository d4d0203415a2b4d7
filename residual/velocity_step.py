"""Velocity from position by a matched filter, one step (pure function).

Position and torque pass the same two lags F(s) = (w / (s + w))^2. The filtered position has an
exact derivative, w (x1 - x2), so M, C and g are evaluated on one consistent, delayed motion, and
the torque is delayed by exactly as much: motion does not read as force. The common delay is 2/w.
"""

import math

import numpy as np
from numpy.typing import NDArray


def lag_pair_step(
    first: NDArray[np.float64],
    second: NDArray[np.float64],
    start: NDArray[np.float64],
    end: NDArray[np.float64],
    bandwidth_per_s: float,
    dt_s: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Exact step of two equal first-order lags in a row, for an input that runs straight.

    A held input is the case ``start == end``.

    Args:
        first: Output of the first lag before the tick.
        second: Output of the second lag before the tick.
        start: Input at the start of the tick.
        end: Input at its end.
        bandwidth_per_s: w of each lag [1/s].
        dt_s: Length of the tick [s].

    Returns:
        Both outputs at the end of the tick.
    """
    slope_lag = (end - start) * (1.0 / (bandwidth_per_s * dt_s))
    decay = math.exp(-bandwidth_per_s * dt_s)
    off_first = first - start + slope_lag
    off_second = second - start + 2.0 * slope_lag
    return (
        end - slope_lag + decay * off_first,
        end - 2.0 * slope_lag + decay * (off_second + bandwidth_per_s * dt_s * off_first),
    )
