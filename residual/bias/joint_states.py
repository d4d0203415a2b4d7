"""States of hysteresis and friction of a joint's torque sensor and bearing.

Both are play operators. That of a torque sensor follows the torque, that of a bearing
the position: on both ways of a free stroke the two are alike, at contact they part, and
that is how the tare distinguishes them afterwards. A bearing between torque sensor and
link runs beside the sensor: its friction reads as an external torque against the
motion, and it stays at rest.
"""

import math

from foundation.arrays import Matrix, Vector, WrittenMatrix, WrittenVector
from foundation.jit import compiled, compiled_inside

TORQUE_LAG_S = 0.05
"""Lag of the torque that hysteresis follows. The residual is 14 ms late: states that
are much later turn round too late in each stroke, and hysteresis and friction are
confused."""

POSITION_LAG_S = 0.01
"""Lag of the position that friction follows: that of the residual or less, for the same
reason."""


@compiled_inside
def play_operator(state: float, change: float, half_width: float) -> float:
    """Return +1 once a signal has risen by the loop's width, -1 once it has fallen.

    It remembers at rest, as strain gauges and bearings do. The state is within -1 to
    1; half width and change are in the signal's unit.
    """
    return min(max(state + change / half_width, -1.0), 1.0)


@compiled
def joint_states_step(
    plays: WrittenMatrix,
    lagged_torque: WrittenVector,
    lagged_q: WrittenVector,
    states: WrittenMatrix,
    q: Vector,
    torque: Vector,
    half_widths: Matrix,
    loops: int,
    stribeck_rad_s: float,
    dt_s: float,
) -> None:
    """Bring the states of hysteresis and friction to the end of a time step.

    Args:
        plays: States of the torques' loops, then of the bearings' elements, shape
            (loops + elements, n); brought to the end, like the next two.
        lagged_torque: Torque behind its lag [Nm], shape (n,).
        lagged_q: Position behind its lag [rad], shape (n,).
        states: Output, shape (loops + elements + 2, n): what
            `residual.bias.model.BiasModel` has columns for, loops, elements, what
            friction has more at low speed (see its prior), and speed [rad/s].
        q: Position [rad], shape (n,).
        torque: Torque [Nm], shape (n,).
        half_widths: Half widths of loops [Nm] and elements [rad], shape (loops +
            elements, n).
        loops: Number of loops.
        stribeck_rad_s: See `residual.bias.model.BiasPrior`.
        dt_s: Time since the step before, > 0.
    """
    count = len(plays)
    torque_gain = dt_s / (TORQUE_LAG_S + dt_s)
    q_gain = dt_s / (POSITION_LAG_S + dt_s)
    for j in range(len(q)):
        torque_change = (torque[j] - lagged_torque[j]) * torque_gain
        q_change = (q[j] - lagged_q[j]) * q_gain
        lagged_torque[j] += torque_change
        lagged_q[j] += q_change
        sliding = 0.0
        for k in range(count):
            change = torque_change if k < loops else q_change
            plays[k, j] = play_operator(plays[k, j], change, half_widths[k, j])
            states[k, j] = plays[k, j]
            if k >= loops:
                sliding += plays[k, j]
        sliding /= count - loops
        speed = q_change / dt_s
        states[count, j] = sliding * math.exp(-abs(speed) / stribeck_rad_s)
        states[count + 1, j] = speed
