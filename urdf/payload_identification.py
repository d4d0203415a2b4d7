r"""What hangs on the flange, from recorded torques.

After Gaz and De Luca, "Payload estimation based on identified coefficients of robot dynamics - with
an application to collision detection", IROS 2017 (reference [18] of the paper): the torque the bare
arm's model does not explain is linear in the payload's ten parameters,

    tau - tau_bare(q, dq, ddq) = Y(q, dq, ddq) phi,

with Y the joint-torque regressor's columns of the body behind the flange.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from urdf.errors import InputError, finite_array
from urdf.inertia import is_consistent, moved_parameters, nearest_body
from urdf.payload import Payload, PayloadEstimate
from urdf.robot import Robot

# Weighted linear least squares over the joints of an arm that says what it could not determine.


# Singular values below this share of the largest are not determined by the data (unknowns in
# natural units).
_RANK_TOLERANCE = 1e-8
# Rounds of re-weighting when the noise of the joints is not given.
_REWEIGHTINGS = 3
# Enough blocks for a covariance of ten unknowns from their scatter.
_BLOCKS = 40


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LinearFit:
    """Least-squares answer ``target = regressor x + offset per joint + noise``.

    Attributes:
        solution: x, the shortest one if several fit equally, shape (p,).
        covariance: Of x, infinite variance for what is not determined, shape (p, p).
        information_root: R with ``|R (x - solution)|^2`` the weighted cost above its minimum, shape
            (p, p).
        rank: Number of determined combinations of x.
        offsets_std: Standard deviations of the constants per joint, zero if not asked for,
            shape (nv,).
    """

    solution: NDArray[np.float64]
    covariance: NDArray[np.float64]
    information_root: NDArray[np.float64]
    rank: int
    offsets_std: NDArray[np.float64]


def fit_linear(
    regressor: NDArray[np.float64],
    target: NDArray[np.float64],
    *,
    noise_std: NDArray[np.float64] | None,
    fit_offsets: bool,
) -> LinearFit:
    """Fit x, and a constant per joint if asked.

    With one weight per joint the constants drop out by taking each joint's mean off both sides.

    Args:
        regressor: Shape (n, nv, p), columns in natural units (of comparable size).
        target: Shape (n, nv).
        noise_std: Noise per joint, shape (nv,), used as weights; None to take it from the residual.
        fit_offsets: Whether each joint has an unknown constant.
    """
    mean_regressor = regressor.mean(axis=0)
    if fit_offsets:
        regressor, target = regressor - mean_regressor, target - target.mean(axis=0)
    std = np.ones(target.shape[1]) if noise_std is None else noise_std
    for _ in range(_REWEIGHTINGS if noise_std is None else 0):
        solution = _solve(regressor, target, std)[0]
        rms = np.sqrt(np.mean((target - regressor @ solution) ** 2, axis=0))
        # A joint that fits to rounding must not outweigh the others without bound.
        std = np.maximum(rms, max(1e-3 * rms.max(), 1e-12))
    solution, values, axes, rank = _solve(regressor, target, std)
    residual = (target - regressor @ solution) / std
    constants = len(std) if fit_offsets else 0
    covariance = _covariance(regressor / std[:, None], residual, values, axes[:rank], constants)
    offsets_std = np.zeros(len(std))
    if fit_offsets:
        through_x = np.einsum("jp,pr,jr->j", mean_regressor, covariance, mean_regressor)
        offsets_std = np.sqrt(np.var(residual * std, axis=0) / len(target) + through_x)
    return LinearFit(
        solution=solution,
        covariance=_with_unknowns(covariance, axes[rank:]),
        information_root=np.where(np.arange(len(values)) < rank, values, 0.0)[:, None] * axes,
        rank=rank,
        offsets_std=offsets_std,
    )


def _solve(
    regressor: NDArray[np.float64], target: NDArray[np.float64], std: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], int]:
    """Return the shortest solution, singular values, right singular vectors and rank."""
    matrix = (regressor / std[:, None]).reshape(-1, regressor.shape[2])
    # Squaring the matrix would halve the digits of the small singular values; QR keeps them.
    factor = np.asarray(np.linalg.qr(np.column_stack([matrix, (target / std).ravel()]), mode="r"))
    size = matrix.shape[1]
    triangle, right = np.zeros((size, size)), np.zeros(size)
    rows = min(size, len(factor))
    triangle[:rows], right[:rows] = factor[:rows, :size], factor[:rows, size]
    left, values, axes = np.linalg.svd(triangle)
    rank = int(np.sum(values > _RANK_TOLERANCE * max(values[0], 1e-300)))
    solution = axes[:rank].T @ ((left.T @ right)[:rank] / values[:rank])
    return solution, values, axes, rank


def _covariance(
    regressor: NDArray[np.float64],
    residual: NDArray[np.float64],
    values: NDArray[np.float64],
    axes: NDArray[np.float64],
    constants: int,
) -> NDArray[np.float64]:
    """Return the covariance on the determined subspace, from whitened data.

    Real residuals are coloured: model errors last for whole stretches of motion, so samples are far
    from independent. With enough samples the scatter of the gradient over consecutive blocks is
    used (a cluster-robust covariance); with few, the classical formula with the residual's
    variance.
    """
    rank = len(axes)
    inverse = axes.T @ np.diag(values[:rank] ** -2.0) @ axes
    count, joints = residual.shape
    if count >= 2 * _BLOCKS:
        gradient = np.einsum("njp,nj->np", regressor, residual)
        bounds = np.linspace(0, count, _BLOCKS + 1).astype(int)[:-1]
        blocks = np.add.reduceat(gradient, bounds, axis=0)
        return inverse @ (blocks.T @ blocks) @ inverse * _BLOCKS / (_BLOCKS - rank)
    freedom = count * joints - rank - constants
    variance = float(np.sum(residual**2)) / freedom if freedom > 0 else np.inf
    return inverse * max(variance, 1e-300)


def _with_unknowns(
    covariance: NDArray[np.float64], unknown_axes: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the covariance with infinite variance where a parameter is not determined."""
    covariance = covariance.copy()
    undetermined = np.linalg.norm(unknown_axes, axis=0) > 1e-6
    covariance[undetermined, :] = covariance[:, undetermined] = 0.0
    covariance[undetermined, undetermined] = np.inf
    return covariance


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
