"""The exact step of the momentum residual, as pure functions of rows.

Momentum ``p = M(q) dq`` obeys ``dp/dt = tau + C' dq - g - tau_f + tau_ext``. With
``u = tau + C' dq - (g + tau_f)`` the residual ``dr/dt = K (dp/dt - u - r)`` is the first-order
low-pass of the external torque (paper, Section IV; Haddadin et al. 2017). Its exact solution over
a tick of length dt is

    r+ = a r + (1 - a) ((p+ - p)/dt - mean(u)),      a = exp(-K dt),

stable for every K dt, free of a start-up spike, and linear in what was known before the tick and
what is known after it: one row of coefficients per joint.
"""

import math
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from speedup import Matrix, Vector, WrittenMatrix, compiled

Alignment = Literal["hold", "trapezoid"]
"""How torque fills a tick: ``hold``, the torque of the earlier sample acts until the next one
(a commanded torque); ``trapezoid``, the mean of both samples (a sampled sensor)."""

ROWS = 5
"""Rows of a sample: residual, momentum, C' dq, g + tau_f, torque."""


def step_coefficients(
    gain_per_s: float | NDArray[np.float64], dt_s: float, alignment: Alignment
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Coefficients of the exact step on the rows before and after the tick.

    Args:
        gain_per_s: K [1/s]: one for all joints, or an array of shape (n,).
        dt_s: Length of the tick [s].
        alignment: How torque fills the tick.

    Returns:
        Factors of the earlier and of the later rows, each of shape (ROWS,), or (n, ROWS) for one
        gain per joint.
    """
    # Plain floats where one gain serves all: on an uneven clock this runs every tick.
    share = (
        -math.expm1(-gain_per_s * dt_s)
        if isinstance(gain_per_s, float)
        else -np.expm1(-gain_per_s * dt_s)
    )
    decay, per_second, half, zero = 1.0 - share, share / dt_s, 0.5 * share, 0.0 * share
    held = alignment == "hold"
    before = (decay, -per_second, -half, half, -share if held else -half)
    after = (zero, per_second, -half, half, zero if held else -half)
    return np.array(before).T, np.array(after).T


def momentum_step(
    before: NDArray[np.float64],
    after: NDArray[np.float64],
    gain_per_s: float | NDArray[np.float64],
    dt_s: float,
    alignment: Alignment = "trapezoid",
) -> NDArray[np.float64]:
    """One exact step of the residual.

    Args:
        before: Rows at the start of the tick, shape (ROWS, n): residual [Nm], momentum
            [kg m^2/s], C' dq [Nm], g + tau_f [Nm], torque [Nm].
        after: Rows at its end; the residual row is not read.
        gain_per_s: K [1/s], one for all joints or shape (n,).
        dt_s: Length of the tick [s].
        alignment: How torque fills the tick.

    Returns:
        Residual at the end of the tick [Nm], shape (n,).
    """
    factors_before, factors_after = step_coefficients(gain_per_s, dt_s, alignment)
    return np.vecdot(factors_before, before.T) + np.vecdot(factors_after, after.T)


@compiled
def momentum_tick(
    rows: WrittenMatrix,
    slot: int,
    dynamics: tuple[Matrix, Matrix, Vector],
    velocity: Vector,
    torque: Vector,
    dt_s: float,
    settings: tuple[Vector, Vector, float, bool],
) -> float:
    """A whole tick of `MomentumObserver` in loops, as a compiler likes it and Python does not.

    The observer does the same with `step_coefficients` and `smoothing_step` where nothing compiles.

    Args:
        rows: Rows of the sample before and of this one, which are written; shape (2 ROWS, n).
        slot: 0 if this sample stands first, else 1.
        dynamics: M, C and g + tau_f.
        velocity: dq [rad/s], shape (n,).
        torque: Measured torque [Nm], shape (n,).
        dt_s: Length of the tick [s]; 0 to keep the residual: of a first sample.
        settings: K [1/s] and the distance at which the bandwidth of the momentum doubles, both
            shape (n,); that bandwidth at rest [1/s]; whether the torque is held.

    Returns:
        Sum of the squares of the rows written.
    """
    inertia, coriolis, gravity = dynamics
    gain, knee, bandwidth, held = settings
    before, after = ROWS * (1 - slot), ROWS * slot
    size = 0.0
    for i in range(len(velocity)):
        momentum = transported = 0.0
        for j in range(len(velocity)):
            momentum += inertia[i, j] * velocity[j]
            transported += coriolis[j, i] * velocity[j]
        residual = rows[before, i]
        if dt_s > 0.0:
            at_rest = 1.0 / (bandwidth * dt_s)
            behind = momentum - rows[before + 1, i]
            ratio = behind / knee[i]
            momentum -= behind / (1.0 + at_rest + ratio * ratio * ratio * ratio) * at_rest
            motion = transported - gravity[i] + rows[before + 2, i] - rows[before + 3, i]
            acting = 2.0 * rows[before + 4, i] if held else rows[before + 4, i] + torque[i]
            rate = (momentum - rows[before + 1, i]) / dt_s - 0.5 * (motion + acting)
            residual += math.expm1(-gain[i] * dt_s) * (residual - rate)
        rows[after, i] = residual
        rows[after + 1, i] = momentum
        rows[after + 2, i] = transported
        rows[after + 3, i] = gravity[i]
        rows[after + 4, i] = torque[i]
        for k in range(after, after + ROWS):
            size += rows[k, i] * rows[k, i]
    return size
