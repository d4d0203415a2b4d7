r"""What hangs on the flange, from recorded torques.

After Gaz and De Luca, "Payload estimation based on identified coefficients of robot dynamics - with
an application to collision detection", IROS 2017 (reference [18] of the paper): the torque the bare
arm's model does not explain is linear in the payload's ten parameters,

    tau - tau_bare(q, dq, ddq) = Y(q, dq, ddq) phi,

with Y the joint-torque regressor's columns of the body behind the flange.
"""

from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from urdf.consistent_fit import is_consistent, nearest_body
from urdf.errors import InputError
from urdf.finite_array import finite_array
from urdf.linear_fit import LinearFit, fit_linear
from urdf.payload import Payload
from urdf.payload_estimate import PayloadEstimate
from urdf.pseudo_inertia import moved_parameters
from urdf.robot import Robot

# A length of the size of payloads, m: in units of it the ten parameters are of comparable size.
_LENGTH_M = 0.1
_UNITS = np.array([1.0, *[_LENGTH_M] * 3, *[_LENGTH_M**2] * 6])
# Below this a payload is none, kg: its centre of mass would be noise divided by noise.
_NO_MASS_KG = 1e-6


def identify_payload(
    robot: Robot,
    q_rad: ArrayLike,
    dq_rad_s: ArrayLike,
    ddq_rad_s2: ArrayLike,
    tau_Nm: ArrayLike,
    *,
    torque_noise_std_Nm: ArrayLike | None = None,
    fit_offsets: bool = False,
) -> PayloadEstimate:
    """Identify all ten parameters of the payload from motion.

    The whole payload is identified: one that ``robot`` carries already is left out of its model.
    Install the answer with ``robot.with_payload(estimate.payload)``.

    Args:
        robot: The arm; its flange frame is the frame of the answer.
        q_rad: Joint positions, shape (n, nv), rad.
        dq_rad_s: Joint velocities, shape (n, nv), rad/s.
        ddq_rad_s2: Joint accelerations, shape (n, nv), rad/s^2; differentiate recordings with a
            filter without delay and give the torque the same filter.
        tau_Nm: Measured joint torques, friction taken off, shape (n, nv), Nm.
        torque_noise_std_Nm: Torque noise per joint as weights, shape (nv,), Nm; default: from the
            residual.
        fit_offsets: Whether torque sensors may have an unknown constant offset each.

    Raises:
        InputError: Wrong shapes, differing lengths, NaN, or noise that is not positive.
    """
    q = finite_array(q_rad, (-1, robot.nv), "q_rad")
    shape = (len(q), robot.nv)
    dq = finite_array(dq_rad_s, shape, "dq_rad_s")
    ddq = finite_array(ddq_rad_s2, shape, "ddq_rad_s2")
    tau = finite_array(tau_Nm, shape, "tau_Nm")
    equation = _payload_equation(robot, q, dq, ddq, tau)
    fit = _fit(equation, 10, torque_noise_std_Nm, fit_offsets=fit_offsets)
    scaled = fit.solution
    constrained = not is_consistent(scaled)
    if constrained:
        scaled = nearest_body(scaled, fit.information_root)
    return _estimate(scaled * _UNITS, constrained, fit, equation, fit_offsets=fit_offsets)


def identify_payload_static(
    robot: Robot,
    q_rad: ArrayLike,
    tau_Nm: ArrayLike,
    *,
    torque_noise_std_Nm: ArrayLike | None = None,
    fit_offsets: bool = False,
) -> PayloadEstimate:
    """Identify mass and first moments of the payload from poses at rest.

    At rest nothing tells the inertia: the payload comes back as a point mass, the variances of its
    inertia infinite. Poses must turn the flange about horizontal axes, or the centre of mass along
    the vertical stays unknown.

    Args:
        robot: The arm; its flange frame is the frame of the answer. A payload it carries is left
            out.
        q_rad: Joint positions, shape (n, nv), rad.
        tau_Nm: Measured joint torques, friction taken off, shape (n, nv), Nm.
        torque_noise_std_Nm: Torque noise per joint as weights, shape (nv,), Nm; default: from the
            residual.
        fit_offsets: Whether torque sensors may have an unknown constant offset each.

    Raises:
        InputError: Wrong shapes, differing lengths, NaN, or noise that is not positive.
    """
    q = finite_array(q_rad, (-1, robot.nv), "q_rad")
    tau = finite_array(tau_Nm, (len(q), robot.nv), "tau_Nm")
    rest = np.zeros_like(q)
    equation = _payload_equation(robot, q, rest, rest, tau)
    fit = _fit(equation, 4, torque_noise_std_Nm, fit_offsets=fit_offsets)
    mass, first = fit.solution[0], fit.solution[1:4] * _LENGTH_M
    # With a positive mass any first moment is consistent, so the sign of the mass decides.
    if mass < _NO_MASS_KG:
        return _estimate(np.zeros(10), True, fit, equation, fit_offsets=fit_offsets)
    point = Payload(mass_kg=mass, com_m=first / mass, inertia_kg_m2=np.zeros((3, 3)))
    return _estimate(point.parameters, False, fit, equation, fit_offsets=fit_offsets)


class _Equation(NamedTuple):
    """The equation that the payload's parameters obey, for n samples of nv joints.

    Attributes:
        regressor: Y in flange axes, shape (n, nv, 10).
        unexplained: Torque that the bare arm leaves open, shape (n, nv), Nm.
    """

    regressor: NDArray[np.float64]
    unexplained: NDArray[np.float64]


def _payload_equation(
    robot: Robot,
    q: NDArray[np.float64],
    dq: NDArray[np.float64],
    ddq: NDArray[np.float64],
    tau: NDArray[np.float64],
) -> _Equation:
    model = robot.bare_model
    data = model.createData()
    flange = model.frames[robot.frame_id(robot.flange_frame)]
    columns = slice(10 * (flange.parentJoint - 1), 10 * flange.parentJoint)
    regressor = np.empty((*q.shape, 10))
    unexplained = np.empty(q.shape)
    for k in range(len(q)):
        full = pin.computeJointTorqueRegressor(model, data, q[k], dq[k], ddq[k])
        regressor[k] = full[:, columns]
        unexplained[k] = tau[k] - pin.rnea(model, data, q[k], dq[k], ddq[k])
    placement = flange.placement
    flange_to_joint = np.column_stack(
        [moved_parameters(unit, placement.rotation, placement.translation) for unit in np.eye(10)]
    )
    return _Equation(regressor @ flange_to_joint, unexplained)


def _fit(
    equation: _Equation, count: int, noise_std_Nm: ArrayLike | None, *, fit_offsets: bool
) -> LinearFit:
    """Fit the first parameters, in units in which they are of comparable size."""
    return fit_linear(
        equation.regressor[:, :, :count] * _UNITS[:count],
        equation.unexplained,
        noise_std=_checked_noise(noise_std_Nm, equation.unexplained.shape[1]),
        fit_offsets=fit_offsets,
    )


def _checked_noise(noise_std_Nm: ArrayLike | None, nv: int) -> NDArray[np.float64] | None:
    if noise_std_Nm is None:
        return None
    noise = finite_array(noise_std_Nm, (nv,), "torque_noise_std_Nm")
    if np.any(noise <= 0.0):
        raise InputError(f"torque_noise_std_Nm must be positive at every joint: {noise.tolist()}")
    return noise


def _estimate(
    parameters: NDArray[np.float64],
    is_constrained: bool,
    fit: LinearFit,
    equation: _Equation,
    *,
    fit_offsets: bool,
) -> PayloadEstimate:
    """Wrap up: undo the units, fill in what was not asked for, and look at what is left."""
    if parameters[0] < _NO_MASS_KG:
        parameters = np.zeros(10)
    asked = len(fit.solution)
    unconstrained = np.zeros(10)
    unconstrained[:asked] = fit.solution * _UNITS[:asked]
    covariance = np.diag(np.full(10, np.inf))
    covariance[:asked, :asked] = fit.covariance * np.outer(_UNITS, _UNITS)[:asked, :asked]
    left = equation.unexplained - equation.regressor @ parameters
    offsets = left.mean(axis=0) if fit_offsets else np.zeros(left.shape[1])
    return PayloadEstimate(
        payload=Payload.from_parameters(parameters),
        covariance=covariance,
        rank=fit.rank,
        parameter_count=asked,
        unconstrained_parameters=unconstrained,
        is_constrained=is_constrained,
        offsets_Nm=offsets,
        offsets_std_Nm=fit.offsets_std,
        residual_rms_Nm=np.sqrt(np.mean((left - offsets) ** 2, axis=0)),
    )
