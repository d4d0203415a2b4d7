"""Velocity from position by a matched filter, one step (pure function).

Position and torque pass the same two lags F(s) = (w / (s + w))^2. The filtered position has an
exact derivative, w (x1 - x2), so M, C and g are evaluated on one consistent, delayed motion, and
the torque is delayed by exactly as much: motion does not read as force. The common delay is 2/w.
"""

import math

import numpy as np
from numpy.typing import NDArray

from speedup import Matrix, Vector, WrittenMatrix, compiled

ROWS = 4
"""Rows of a step: output of the first lag, of the second, input at the start and at the end."""


def lag_pair_coefficients(bandwidth_per_s: float, dt_s: float) -> NDArray[np.float64]:
    """Factors of the exact step of two equal first-order lags in a row.

    The input runs straight over the tick; a held one is the case of equal ends.

    Args:
        bandwidth_per_s: w of each lag [1/s].
        dt_s: Length of the tick [s].

    Returns:
        Shape (3, ROWS): times the rows, both outputs at the end of the tick, and the rate of the
        second one.
    """
    tick = bandwidth_per_s * dt_s
    decay, share, per_tick = math.exp(-tick), -math.expm1(-tick), 1.0 / tick
    first = np.array([decay, 0.0, share * per_tick - decay, 1.0 - share * per_tick])
    second = np.array(
        [
            decay * tick,
            decay,
            2.0 * (share * per_tick - decay) - tick * decay,
            1.0 + decay - 2.0 * share * per_tick,
        ]
    )
    return np.stack((first, second, bandwidth_per_s * (first - second)))


@compiled
def lag_pair_step(
    rows: WrittenMatrix, q: Vector, tau: Vector, coefficients: Matrix, held: bool
) -> Matrix:
    """One step of both lags for position and torque.

    Args:
        rows: Output of both lags and the sample before, position then torque; brought up to date;
            shape (ROWS, 2 n), the last row to write in.
        q: Position at the end of the tick [rad], shape (n,).
        tau: Torque there [Nm], shape (n,).
        coefficients: See `lag_pair_coefficients`.
        held: Whether the torque of the sample before acts through the tick.

    Returns:
        Both outputs and the rate of the second one, shape (3, 2 n).
    """
    n = q.size
    earlier, now = rows[2], rows[3]
    now[:n] = q
    if held:
        now[n:] = earlier[n:]
    else:
        now[n:] = tau
    out = np.dot(coefficients, rows)
    rows[:2] = out[:2]
    earlier[:n] = q
    earlier[n:] = tau
    return out
