"""What the residual may be off by because the arm moves fast: its inertias are not known exactly.

A tare is of slow motion. It corrects masses and first moments as far as gravity shows them; what
turns and accelerates the links is still as uncertain as the prior says.
"""

import math

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from urdf import Robot

Array = NDArray[np.float64]
SMOOTHING_S = 0.05
"""Lag of the velocity whose distance from the present one is the acceleration: noise of an encoder
then stays below a tenth of the torque sensor's, and a motion of 2 Hz loses a sixth."""


class MotionError:
    """Follows velocity; says how large the error of the torque of motion may be.

    Args:
        robot: The arm with its payload.
        fraction: Of the torque of motion that may be wrong, one standard deviation.

    Attributes:
        smooth_velocity: Velocity of a moment ago [rad/s], shape (n,).
    """

    def __init__(self, robot: Robot, fraction: float) -> None:
        self._model, self._data = robot.model, robot.create_data()
        self._fraction = fraction
        self.smooth_velocity: Array = np.zeros(robot.nv)

    def variance_Nm2(self, q: Array, dq: Array, dt_s: float) -> Array:
        """Variance of the residual's error per joint [Nm^2], shape (n,).

        Args:
            q: Position [rad], shape (n,).
            dq: Velocity [rad/s], shape (n,).
            dt_s: Time since the last call [s]; 0 at the first, which starts from this velocity.
        """
        if dt_s <= 0.0:
            self.smooth_velocity = dq
        acceleration = (dq - self.smooth_velocity) / SMOOTHING_S
        fraction = -math.expm1(-dt_s / SMOOTHING_S)
        self.smooth_velocity = self.smooth_velocity + fraction * (dq - self.smooth_velocity)
        gravity = pin.computeGeneralizedGravity(self._model, self._data, q)
        motion = pin.rnea(self._model, self._data, q, dq, acceleration) - gravity
        return np.square(self._fraction * motion)
