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
        covariance: Covariance of the parameters, shape (4, 4).
        residual_rms_Nm: Unexplained torque per joint, root mean square, shape (nv,).
    """

    payload: Payload
    parameters: Array
    covariance: Array
    residual_rms_Nm: Array

    @property
    def mass_std_kg(self) -> float:
        """Standard deviation of the mass, kg."""
        return float(np.sqrt(self.covariance[0, 0]))

    @property
    def com_std_m(self) -> Array:
        """Standard deviation of the centre of mass to first order, shape (3,), m."""
        if self.payload.mass_kg == 0.0:
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
    its model. Install the answer with ``robot.with_payload(estimate.payload)``.

    Args:
        robot: The arm; its flange frame is the frame of the answer.
        q_rad: Joint positions, shape (n, nv), rad.
        tau_Nm: Measured joint torques, friction and offsets taken off, shape (n, nv),
            Nm.
        torque_noise_std_Nm: Torque noise per joint as weights, shape (nv,), Nm;
            default: from the residual.

    Raises:
        InputError: Wrong shapes, differing lengths, NaN, noise that is not positive, or
            poses that do not show all four parameters: those that leave the flange's
            direction to the vertical as it is.
    """
    no_mass_kg = 1e-6
    q = finite_array(q_rad, (-1, robot.nv), "q_rad")
    tau = finite_array(tau_Nm, q.shape, "tau_Nm")
    regressor, unexplained = _payload_equation(robot, q, tau)
    noise_Nm = np.ones(robot.nv)
    if torque_noise_std_Nm is not None:
        noise_Nm = finite_array(torque_noise_std_Nm, (robot.nv,), "torque_noise_std_Nm")
    if not np.all(noise_Nm > 0.0):
        raise InputError(f"torque_noise_std_Nm is not positive: {noise_Nm.tolist()}")
    rank = int(np.linalg.matrix_rank(regressor.reshape(-1, 4), rtol=1e-8))
    if rank < 4 or tau.size == 4:
        raise InputError(
            f"q_rad: {len(q)} poses determine {rank} of the four numbers mass and "
            "centre of mass, expected poses that turn the flange about horizontal axes"
        )
    if torque_noise_std_Nm is None:
        noise_Nm = _estimate_noise(regressor, unexplained)
    solution, cofactors = _solve_weighted(regressor, unexplained, noise_Nm)
    remaining = unexplained - regressor @ solution
    freedom = tau.size - 4
    variance = max(np.sum((remaining / noise_Nm) ** 2) / freedom, 1e-300)
    parameters = solution * _UNITS
    mass_kg = 0.0
    com_m = np.zeros(3)
    if parameters[0] >= no_mass_kg:
        mass_kg = parameters[0]
        com_m = parameters[1:] / parameters[0]
    return PayloadEstimate(
        payload=Payload(mass_kg=mass_kg, com_m=com_m, inertia_kg_m2=np.zeros((3, 3))),
        parameters=read_only(parameters),
        covariance=read_only(variance * cofactors * np.outer(_UNITS, _UNITS)),
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


def _estimate_noise(regressor: Array, target: Array) -> Array:
    """Return the noise of each joint, as large as the residual of a fit [Nm], (nv,)."""
    reweightings = 3
    noise_Nm = np.ones(target.shape[1])
    for _ in range(reweightings):
        solution, _ = _solve_weighted(regressor, target, noise_Nm)
        rms_Nm = np.sqrt(np.mean((target - regressor @ solution) ** 2, axis=0))
        # A joint that fits to rounding must not outweigh the others without bound.
        noise_Nm = np.maximum(rms_Nm, max(1e-3 * rms_Nm.max(), 1e-12))
    return noise_Nm


def _solve_weighted(
    regressor: Array, target: Array, noise_Nm: Array
) -> tuple[Array, Array]:
    """Return the weighted least-squares solution, (4,), and its cofactors, (4, 4).

    Args:
        regressor: Shape (n, nv, 4).
        target: Shape (n, nv).
        noise_Nm: Noise of each joint, shape (nv,).
    """
    matrix = (regressor / noise_Nm[:, None]).reshape(-1, 4)
    inverse = np.linalg.pinv(matrix)
    return inverse @ (target / noise_Nm).ravel(), inverse @ inverse.T
