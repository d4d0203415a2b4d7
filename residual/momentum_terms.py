"""What the residual needs of the robot's dynamics, straight from Pinocchio."""

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from residual.errors import ConfigurationError
from residual.joint_friction import FrictionModel
from urdf import Robot


def _check_length(friction: FrictionModel, joints: int) -> None:
    try:
        shape = np.shape(friction.torque(np.zeros(joints)))
    except ValueError as error:
        raise ConfigurationError(
            f"friction does not fit a robot of {joints} joints: {error}"
        ) from error
    if shape != (joints,):
        raise ConfigurationError(f"friction gives torques of shape {shape}, expected ({joints},)")


class MomentumTerms:
    """Momentum, C' dq and g + tau_f of one robot, written into the caller's rows.

    Rotor inertia, where an arm needs it (motor-current torque), is part of the robot's model
    (`Robot.with_armature`); on the LWR, whose torque is measured behind the gear, it is zero.

    Attributes:
        data: Workspace; joint placements and Jacobians of the latest `write` stand in it.

    Raises:
        ConfigurationError: If the friction model is of another number of joints.
    """

    def __init__(self, robot: Robot, friction: FrictionModel | None = None) -> None:
        if friction is not None:
            _check_length(friction, robot.nv)
        self._model = robot.model
        self.data = robot.create_data()
        self._friction = friction

    def write(
        self,
        q: NDArray[np.float64],
        dq: NDArray[np.float64],
        momentum: NDArray[np.float64],
        coriolis: NDArray[np.float64],
        gravity: NDArray[np.float64],
    ) -> None:
        """Write p = M dq, C' dq and g + tau_f at (q, dq) into the last three arrays, each (n,)."""
        model, data = self._model, self.data
        pin.crba(model, data, q).dot(dq, momentum)
        dq.dot(pin.computeCoriolisMatrix(model, data, q, dq), coriolis)
        gravity[:] = pin.computeGeneralizedGravity(model, data, q)
        if self._friction is not None:
            gravity += self._friction.torque(dq)

    def momentum_variance(
        self, velocity_noise_rad_s: NDArray[np.float64], q: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Variance of M(q) dq for a velocity noise per joint [rad/s], shape (n,)."""
        inertia = pin.crba(self._model, self.data, q)
        return np.square(inertia).dot(np.square(velocity_noise_rad_s))
