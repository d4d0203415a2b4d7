"""What a joint's torque sensor and bearing remember: states of hysteresis and of friction.

Both are play operators. That of a torque sensor follows the torque, that of a bearing the position:
on the way in and out of a free stroke the two are alike, at contact they part, and that is how the
tare distinguishes them afterwards. A bearing between torque sensor and link runs beside the
sensor: its friction reads as an external torque against the motion, and it stays at rest.
"""

import numpy as np
from numpy.typing import NDArray

from residual.bias_model import BiasModel

Array = NDArray[np.float64]
LAGS_S = np.array(((0.05,), (0.01,)))
"""Lags of the torque and the position that are followed [s]. The residual is 14 ms late: states
that are much later than it turn round too late in each stroke, and hysteresis and friction are
confused."""


def play_operator(state: Array, change: Array, half_width: Array) -> Array:
    """+1 once a signal has risen by the loop's width, -1 once it has fallen by it.

    It remembers at rest, as strain gauges and bearings do. States, -1 to 1, half widths and the
    change, both in the signal's unit, have the shape (loops, n).
    """
    return np.minimum(np.maximum(state + change / half_width, -1.0), 1.0)


class JointStates:
    """Follows hysteresis and friction of all joints.

    Attributes:
        memory: Rows: states of the torques' loops and of the bearings' elements, then torque [Nm]
            and position [rad] with their lags; shape (loops + elements + 2, n).
        rows: What `BiasModel` has columns for: loops, elements, what friction has more at low
            speed, and speed [rad/s]; shape (loops + elements + 2, n).
    """

    def __init__(self, basis: BiasModel) -> None:
        prior, one = basis.prior, np.ones(basis.joints)
        self._kinds = np.array((basis.loops, basis.elements))
        loops = np.outer(prior.hysteresis_widths, basis.effort_Nm)
        self._half_widths = np.vstack((loops, np.outer(prior.presliding_rad, one)))
        self._stribeck_rad_s = prior.stribeck_rad_s
        self.memory: Array | None = None
        self.rows = np.zeros((basis.states, basis.joints))

    def follow(self, q: Array, torque: Array, dt_s: float) -> None:
        """Follow position [rad] and torque [Nm], a time [s] after the last ones."""
        followed = np.stack((torque, q))
        if self.memory is None:
            self.memory = np.vstack((np.zeros_like(self._half_widths), followed))
        if dt_s <= 0.0:
            return
        last = self.memory[-2:]
        change = (followed - last) * (dt_s / (LAGS_S + dt_s))
        plays = play_operator(
            self.memory[:-2], np.repeat(change, self._kinds, axis=0), self._half_widths
        )
        self.memory = np.concatenate((plays, last + change))
        speed = change[1] / dt_s
        sliding = plays[self._kinds[0] :].mean(axis=0)
        excess = sliding * np.exp(-np.abs(speed) / self._stribeck_rad_s)
        self.rows = np.concatenate((plays, excess[None], speed[None]))
