"""Mass and centre of mass of what hangs on the flange, from torques at rest.

After Gaz and De Luca, "Payload estimation based on identified coefficients of robot
dynamics - with an application to collision detection", IROS 2017 (reference [18] of
Ferro et al.): the torque that the bare arm's model does not explain is linear in the
payload's parameters. At rest these are four,

    tau - g_bare(q) = Y(q) (m, m c_x, m c_y, m c_z),

with Y the joint-torque regressor's columns of the body behind the flange.
"""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from foundation.arrays import Array
from urdf.errors import InputError, finite_array, read_only
from urdf.payload import Payload
from urdf.robot import Robot

_UNITS = np.array([1.0, 0.1, 0.1, 0.1])
"""Mass [kg] and first moments [kg m] of a usual payload: in these units the parameters
are of comparable size."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PayloadEstimate:
    """An identified payload with its uncertainty. Arrays are read-only.

    The four parameters are mass and first moments in the flange frame, kg and kg m. A
    mass that is negative by many standard deviations means a wrong sign, frame, scale
    or robot model.

    Attributes:
        payload: A point mass in the flange frame; none where the mass came out
            negative.
        parameters: The least-squares estimate, shape (4,).
        covariance: Covariance of the parameters, shape (4, 4); infinite variance for
            what the data do not determine.
        rank: Number of parameter combinations that the data determine.
        residual_rms_Nm: Unexplained torque per joint, root mean square, shape (nv,).
    """

    payload: Payload
    parameters: Array
    covariance: Array
    rank: int
    residual_rms_Nm: Array

    @property
    def is_identified(self) -> bool:
        """Whether the data determine mass and centre of mass."""
        return self.rank == len(self.parameters)

    @property
    def mass_std_kg(self) -> float:
        """Standard deviation of the mass, kg."""
        return float(np.sqrt(self.covariance[0, 0]))

    @property
    def com_std_m(self) -> Array:
        """Standard deviation of the centre of mass to first order, shape (3,), m."""
        if self.payload.mass_kg == 0.0 or not np.isfinite(self.covariance).all():
            return np.full(3, np.inf)
        slope = np.column_stack([-self.payload.com_m, np.eye(3)]) / self.payload.mass_kg
        return np.sqrt(np.diag(slope @ self.covariance @ slope.T))


def identify_payload_static(
    robot: Robot,
    q_rad: ArrayLike,
    tau_Nm: ArrayLike,
    *,
    torque_noise_std_Nm: ArrayLike | None = None,
) -> PayloadEstimate:
    """Identify mass and centre of mass of the payload from poses at rest.

    The whole payload is identified: one that ``robot`` carries already is left out of
    its model. Install the answer with ``robot.with_payload(estimate.payload)``. Poses
    must turn the flange about horizontal axes, or the centre of mass along the vertical
    stays unknown.

    Args:
        robot: The arm; its flange frame is the frame of the answer.
        q_rad: Joint positions, shape (n, nv), rad.
        tau_Nm: Measured joint torques, friction and offsets taken off, shape (n, nv),
            Nm.
        torque_noise_std_Nm: Torque noise per joint as weights, shape (nv,), Nm;
            default: from the residual.

    Raises:
        InputError: Wrong shapes, differing lengths, NaN, or noise that is not positive.
    """
    no_mass_kg = 1e-6
    q = finite_array(q_rad, (-1, robot.nv), "q_rad")
    tau = finite_array(tau_Nm, q.shape, "tau_Nm")
    regressor, unexplained = _payload_equation(robot, q, tau)
    std = _joint_noise(regressor, unexplained, torque_noise_std_Nm)
    matrix, inverse, determined = _invert(regressor, std)
    solution = inverse @ (unexplained / std).ravel()
    rank = round(np.trace(determined))
    remaining = unexplained - regressor @ solution
    freedom = tau.size - rank
    square = float(np.sum((matrix @ solution - (unexplained / std).ravel()) ** 2))
    variance = max(square / freedom, 1e-300) if freedom > 0 else np.inf
    covariance = inverse @ inverse.T * variance
    # A parameter with a part outside of what the data determine is unknown.
    unknown = 1.0 - determined.diagonal() > 1e-12
    covariance[unknown, :] = covariance[:, unknown] = 0.0
    covariance[unknown, unknown] = np.inf
    parameters = solution * _UNITS
    mass_kg = 0.0
    com_m = np.zeros(3)
    if parameters[0] >= no_mass_kg:
        mass_kg = parameters[0]
        com_m = parameters[1:] / parameters[0]
    return PayloadEstimate(
        payload=Payload(mass_kg=mass_kg, com_m=com_m, inertia_kg_m2=np.zeros((3, 3))),
        parameters=read_only(parameters),
        covariance=read_only(covariance * np.outer(_UNITS, _UNITS)),
        rank=rank,
        residual_rms_Nm=read_only(np.sqrt(np.mean(remaining**2, axis=0))),
    )


def _payload_equation(robot: Robot, q: Array, tau: Array) -> tuple[Array, Array]:
    """Return the regressor of the payload and the torque it has to explain.

        tau - g_bare(q) = Y(q) (m, m c_x, m c_y, m c_z)

    Returns:
        Y in flange axes and in units of `_UNITS`, shape (n, nv, 4), and the left side,
        shape (n, nv), Nm.
    """
    model = robot.bare_model
    still = np.zeros(robot.nv)
    data = model.createData()
    flange = model.frames[robot.frame_id(robot.flange_frame)]
    first = 10 * (flange.parentJoint - 1)
    regressor = np.empty((*q.shape, 4))
    unexplained = np.empty(q.shape)
    for k, pose in enumerate(q):
        whole = pin.computeJointTorqueRegressor(model, data, pose, still, still)
        regressor[k] = whole[:, first : first + 4]
        unexplained[k] = tau[k] - pin.computeGeneralizedGravity(model, data, pose)
    flange_to_joint = np.eye(4)
    flange_to_joint[1:, 0] = flange.placement.translation
    flange_to_joint[1:, 1:] = flange.placement.rotation
    return regressor @ flange_to_joint * _UNITS, unexplained


def _joint_noise(regressor: Array, target: Array, given: ArrayLike | None) -> Array:
    """Return the torque noise of each joint, shape (nv,), Nm.

    It is the given one, or else as large as the residual of a fit at that joint.
    """
    reweightings = 3
    std = np.ones(target.shape[1])
    if given is not None:
        std = finite_array(given, std.shape, "torque_noise_std_Nm")
        if np.any(std <= 0.0):
            raise InputError(
                f"torque_noise_std_Nm must be positive at every joint: {std.tolist()}"
            )
        return std
    for _ in range(reweightings):
        _, inverse, _ = _invert(regressor, std)
        fit = regressor @ (inverse @ (target / std).ravel())
        rms = np.sqrt(np.mean((target - fit) ** 2, axis=0))
        # A joint that fits to rounding must not outweigh the others without bound.
        std = np.maximum(rms, max(1e-3 * rms.max(), 1e-12))
    return std


def _invert(regressor: Array, std: Array) -> tuple[Array, Array, Array]:
    """Return the weighted regressor W, shape (n nv, 4), and its pseudo-inverse.

    Args:
        regressor: Shape (n, nv, 4).
        std: Noise of each joint, shape (nv,).

    Returns:
        W, its pseudo-inverse, shape (4, n nv), and their product, shape (4, 4): the
        projector on what the data determine.
    """
    matrix = (regressor / std[:, None]).reshape(-1, regressor.shape[2])
    inverse = np.asarray(np.linalg.pinv(matrix, rcond=1e-8), dtype=np.float64)
    return matrix, inverse, inverse @ matrix
