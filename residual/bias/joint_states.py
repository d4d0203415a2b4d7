"""What a joint's torque sensor and bearing remember: states of hysteresis and of
friction.

Both are play operators. That of a torque sensor follows the torque, that of a bearing
the position: on both ways of a free stroke the two are alike, at contact they part, and
that is how the tare distinguishes them afterwards. A bearing between torque sensor and
link runs beside the sensor: its friction reads as an external torque against the
motion, and it stays at rest.
"""

import numpy as np

from foundation.arrays import Matrix, Vector, WrittenMatrix
from foundation.jit import compiled
from residual.errors import Array

TORQUE_LAG_S = 0.05
POSITION_LAG_S = 0.01
"""Lags of the torque and the position that are followed [s]. The residual is 14 ms
late: states that are much later than it turn round too late in each stroke, and
hysteresis and friction are confused."""


@compiled
def play_operator(state: Matrix, change: Vector, half_width: Matrix) -> Array:
    """+1 once a signal has risen by the loop's width, -1 once it has fallen by it.

    It remembers at rest, as strain gauges and bearings do. States, -1 to 1, and half
    widths have the shape (loops, n), the change (n,); half widths and change are in the
    signal's unit.
    """
    return np.minimum(np.maximum(state + change / half_width, -1.0), 1.0)


@compiled
def follow_joints(
    memory: WrittenMatrix,
    states: WrittenMatrix,
    q: Vector,
    torque: Vector,
    half_widths: Matrix,
    loops: int,
    stribeck_rad_s: float,
    dt_s: float,
) -> None:
    """Follow position [rad] and torque [Nm], both (n,), a time > 0 [s] after the last
    ones.

    The memory is brought up to date: states of the torques' loops and of the bearings'
    elements, then torque [Nm] and position [rad] with their lags; shape (loops +
    elements + 2, n). The states are written, of the same shape: what
    `residual.bias.model.BiasModel` has columns for, loops, elements, what friction has
    more at low speed (see its prior), and speed [rad/s]. Half widths are those of loops
    [Nm] and elements [rad], shape (loops + elements, n).
    """
    plays = len(half_widths)
    twist = (torque - memory[plays]) * (dt_s / (TORQUE_LAG_S + dt_s))
    way = (q - memory[plays + 1]) * (dt_s / (POSITION_LAG_S + dt_s))
    memory[:loops] = play_operator(memory[:loops], twist, half_widths[:loops])
    memory[loops:plays] = play_operator(memory[loops:plays], way, half_widths[loops:])
    memory[plays] += twist
    memory[plays + 1] += way
    speed = way / dt_s
    sliding = memory[loops:plays].sum(axis=0) / (plays - loops)
    states[:plays] = memory[:plays]
    states[plays] = sliding * np.exp(-np.abs(speed) / stribeck_rad_s)
    states[plays + 1] = speed
