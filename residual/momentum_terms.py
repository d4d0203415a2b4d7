"""What the residual needs of the robot's dynamics, straight from Pinocchio."""

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from residual.errors import ConfigurationError
from residual.joint_friction import FrictionModel
from urdf import Robot

Dynamics = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]
"""M [kg m^2] and C, both of shape (n, n), and g + tau_f [Nm], shape (n,)."""


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
    """Dynamics of one robot, as matrices or as rows of the caller.

    Rotor inertia, where an arm needs it (motor-current torque), is part of the robot's model
    (`Robot.with_armature`); on the LWR, whose torque is measured behind the gear, it is zero.

    Attributes:
        data: Workspace; joint placements and Jacobians of the latest call stand in it.

    Raises:
        ConfigurationError: If the friction model is of another number of joints.
    """

    def __init__(self, robot: Robot, friction: FrictionModel | None = None) -> None:
        if friction is not None:
            _check_length(friction, robot.nv)
        self._model = robot.model
        self.data = robot.create_data()
        self._friction = friction

    def at(self, q: NDArray[np.float64], dq: NDArray[np.float64]) -> Dynamics:
        """M, C and g + tau_f at (q, dq), both of shape (n,)."""
        model, data = self._model, self.data
        inertia = pin.crba(model, data, q)
        coriolis = pin.computeCoriolisMatrix(model, data, q, dq)
        gravity = pin.computeGeneralizedGravity(model, data, q)
        if self._friction is not None:
            gravity += self._friction.torque(dq)
        return inertia, coriolis, gravity

    def write(
        self,
        q: NDArray[np.float64],
        dq: NDArray[np.float64],
        momentum: NDArray[np.float64],
        coriolis: NDArray[np.float64],
        gravity: NDArray[np.float64],
    ) -> None:
        """Write p = M dq, C' dq and g + tau_f at (q, dq) into the last three arrays, each (n,)."""
        inertia, coriolis_matrix, gravity[:] = self.at(q, dq)
        inertia.dot(dq, momentum)
        dq.dot(coriolis_matrix, coriolis)

    def momentum_variance(
        self, velocity_noise_rad_s: NDArray[np.float64], q: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Variance of M(q) dq for a velocity noise per joint [rad/s], shape (n,)."""
        inertia = pin.crba(self._model, self.data, q)
        return np.square(inertia).dot(np.square(velocity_noise_rad_s))
