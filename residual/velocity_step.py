"""Velocity from position by a matched filter, one step (pure function).

Position and torque pass the same two lags F(s) = (w / (s + w))^2. The filtered position has an
exact derivative, w (x1 - x2), so M, C and g are evaluated on one consistent, delayed motion, and
the torque is delayed by exactly as much: motion does not read as force. The common delay is 2/w.
"""

import math

import numpy as np
from numpy.typing import NDArray

from speedup import COMPILER, Matrix, Vector, WrittenMatrix, compiled

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


def lag_pair_step(
    rows: NDArray[np.float64],
    q: NDArray[np.float64],
    tau: NDArray[np.float64],
    coefficients: NDArray[np.float64],
    held: bool,
) -> NDArray[np.float64]:
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
    if COMPILER:
        out = np.empty((3, rows.shape[1]))
        lag_pair_loops(rows, q, tau, coefficients, held, out)
        return out
    n, earlier, now = len(q), rows[2], rows[3]
    now[:n], now[n:] = q, earlier[n:] if held else tau
    out = coefficients.dot(rows)
    rows[:2] = out[:2]
    earlier[:n], earlier[n:] = q, tau
    return out


@compiled
def lag_pair_loops(
    rows: WrittenMatrix,
    q: Vector,
    tau: Vector,
    coefficients: Matrix,
    held: bool,
    out: WrittenMatrix,
) -> None:
    """`lag_pair_step` in loops, as a compiler likes it and Python does not."""
    n = q.size
    for i in range(2 * n):
        given = q[i] if i < n else tau[i - n]
        before = rows[2, i]
        now = before if held and i >= n else given
        first, second = rows[0, i], rows[1, i]
        for k in range(3):
            out[k, i] = (
                coefficients[k, 0] * first
                + coefficients[k, 1] * second
                + coefficients[k, 2] * before
                + coefficients[k, 3] * now
            )
        rows[0, i], rows[1, i], rows[2, i] = out[0, i], out[1, i], given
