r"""What hangs on the flange, from recorded torques.

After Gaz and De Luca, "Payload estimation based on identified coefficients of robot dynamics - with
an application to collision detection", IROS 2017 (reference [18] of Ferro et al.): the torque that
the bare arm's model does not explain is linear in the payload's ten parameters,

    tau - tau_bare(q, dq, ddq) = Y(q, dq, ddq) phi,

with Y the joint-torque regressor's columns of the body behind the flange.
"""

from dataclasses import dataclass, fields

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from urdf.errors import Array, InputError, finite_array, read_only
from urdf.inertia import moved_parameters, nearest_body, parameters_about_com, pseudo_inertia
from urdf.payload import Payload
from urdf.robot import Robot

# A length of the size of payloads, m: in units of it the ten parameters are of comparable size.
_LENGTH_M = 0.1
_UNITS = np.array([1.0, *[_LENGTH_M] * 3, *[_LENGTH_M**2] * 6])
# Below this a payload is none, kg: its centre of mass would be noise divided by noise.
_NO_MASS_KG = 1e-6
# Singular values below this fraction of the largest are not determined by the data.
_RANK_TOLERANCE = 1e-8
# Rounds of re-weighting when the noise of the joints is not given.
_REWEIGHTINGS = 3
# Enough blocks for a covariance of ten unknowns from their scatter.
_BLOCKS = 40


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PayloadEstimate:
    """An identified payload with its uncertainty. Arrays are read-only copies.

    The ten parameters are those of `urdf.inertia`, in the flange frame.

    Attributes:
        payload: The physically consistent payload, in the flange frame.
        covariance: Of the ten parameters before the consistency constraint, shape (10, 10);
            infinite variance for what the data do not determine.
        rank: Number of parameter combinations the data determine.
        parameter_count: Number of parameters asked for: ten from motion, four at rest.
        unconstrained_parameters: Least-squares answer before the consistency constraint, shape
            (10,); zero for what was not asked for.
        is_constrained: True if that answer was no rigid body's and the nearest one was taken. Far
            away (by many standard deviations) it means a wrong sign, frame, scale or robot model.
        offsets_Nm: Constant torque per joint fitted along with it, zero if not asked for, shape
            (nv,), Nm.
        offsets_std_Nm: Standard deviation of the offsets, shape (nv,), Nm.
        residual_rms_Nm: Torque the estimate leaves unexplained, per joint, shape (nv,), Nm.
    """

    payload: Payload
    covariance: Array
    rank: int
    parameter_count: int
    unconstrained_parameters: Array
    is_constrained: bool
    offsets_Nm: Array
    offsets_std_Nm: Array
    residual_rms_Nm: Array

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, np.ndarray):
                object.__setattr__(self, item.name, read_only(value))

    @property
    def is_identified(self) -> bool:
        """Whether the data determine every parameter that was asked for."""
        return self.rank == self.parameter_count

    @property
    def standard_deviations(self) -> Array:
        """Standard deviations of the ten parameters, shape (10,), kg, kg m, kg m^2."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def mass_std_kg(self) -> float:
        """Standard deviation of the mass, kg."""
        return float(self.standard_deviations[0])

    @property
    def com_std_m(self) -> Array:
        """Standard deviation of the centre of mass to first order, shape (3,), m."""
        block = self.covariance[:4, :4]
        if self.payload.mass_kg == 0.0 or not np.isfinite(block).all():
            return np.full(3, np.inf)
        slope = np.column_stack([-self.payload.com_m, np.eye(3)]) / self.payload.mass_kg
        return np.sqrt(np.diag(slope @ block @ slope.T))


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
    motion = q, dq, ddq, finite_array(tau_Nm, shape, "tau_Nm")
    return _identify(robot, motion, 10, torque_noise_std_Nm, fit_offsets=fit_offsets)


def identify_payload_static(
    robot: Robot,
    q_rad: ArrayLike,
    tau_Nm: ArrayLike,
    *,
    torque_noise_std_Nm: ArrayLike | None = None,
    fit_offsets: bool = False,
) -> PayloadEstimate:
    """Identify mass and first moments of the payload from poses at rest.

    Poses at rest do not determine the inertia: the payload comes back as a point mass, the
    variances of its inertia infinite. Poses must turn the flange about horizontal axes, or the
    centre of mass along the vertical stays unknown.

    Arguments and errors are those of `identify_payload`.
    """
    q = finite_array(q_rad, (-1, robot.nv), "q_rad")
    rest = np.zeros_like(q)
    motion = q, rest, rest, finite_array(tau_Nm, q.shape, "tau_Nm")
    return _identify(robot, motion, 4, torque_noise_std_Nm, fit_offsets=fit_offsets)


def _payload_equation(
    robot: Robot, q: Array, dq: Array, ddq: Array, tau: Array
) -> tuple[Array, Array]:
    """Return Y in flange axes and `_UNITS`, shape (n, nv, 10), and the unexplained torque."""
    model = robot.bare_model
    data = model.createData()
    flange = model.frames[robot.frame_id(robot.flange_frame)]
    columns = slice(10 * (flange.parentJoint - 1), 10 * flange.parentJoint)
    regressor = np.empty((*q.shape, 10))
    unexplained = np.empty(q.shape)
    for k, row in enumerate(zip(q, dq, ddq, strict=True)):
        regressor[k] = pin.computeJointTorqueRegressor(model, data, *row)[:, columns]
        unexplained[k] = tau[k] - pin.rnea(model, data, *row)
    place = flange.placement
    flange_to_joint = np.column_stack(
        [moved_parameters(unit, place.rotation, place.translation) for unit in np.eye(10)]
    )
    return regressor @ flange_to_joint * _UNITS, unexplained


def _identify(
    robot: Robot, motion: tuple[Array, ...], asked: int, std: ArrayLike | None, *, fit_offsets: bool
) -> PayloadEstimate:
    """Fit so many parameters, make them those of a body, and sum up the torque that they leave."""
    regressor, unexplained = _payload_equation(robot, *motion)
    columns = regressor[:, :, :asked]
    solution, spread, root, rank, offsets_std = _fit_linear(
        columns, unexplained, std, fit_offsets=fit_offsets
    )
    scaled = solution
    if asked == 10:
        is_constrained = bool(np.linalg.eigvalsh(pseudo_inertia(scaled))[0] < 0.0)
        if is_constrained:
            scaled = nearest_body(scaled, root)
    else:
        # With a positive mass any first moment is consistent, so the sign of the mass decides.
        mass, first = scaled[0], scaled[1:] * _LENGTH_M
        is_constrained = mass < _NO_MASS_KG
        if not is_constrained:
            scaled = parameters_about_com(mass, first / mass, np.zeros((3, 3))) / _UNITS
    if scaled[0] < _NO_MASS_KG:
        scaled = np.zeros(10)
    remaining = unexplained - regressor @ scaled
    unconstrained = np.zeros(10)
    unconstrained[:asked] = solution * _UNITS[:asked]
    covariance = np.diag(np.full(10, np.inf))
    covariance[:asked, :asked] = spread * np.outer(_UNITS, _UNITS)[:asked, :asked]
    offsets = remaining.mean(axis=0) if fit_offsets else np.zeros(remaining.shape[1])
    return PayloadEstimate(
        payload=Payload.from_parameters(scaled * _UNITS),
        covariance=covariance,
        rank=rank,
        parameter_count=asked,
        unconstrained_parameters=unconstrained,
        is_constrained=is_constrained,
        offsets_Nm=offsets,
        offsets_std_Nm=offsets_std,
        residual_rms_Nm=np.sqrt(np.mean((remaining - offsets) ** 2, axis=0)),
    )


def _fit_linear(
    regressor: Array, target: Array, noise_std: ArrayLike | None, *, fit_offsets: bool
) -> tuple[Array, Array, Array, int, Array]:
    """Fit ``target = regressor x + offset per joint + noise``, weighted by the noise per joint.

    The regressor has shape (n, nv, p). Returns the shortest x, its covariance (infinite variance
    for what is not determined), R of the cost |R (y - x)|^2 above its minimum, the number of
    determined combinations, and the standard deviations of the offsets (zero if not fitted).
    """
    mean_regressor = regressor.mean(axis=0)
    if fit_offsets:
        # With one weight per joint the constants drop out with each joint's mean.
        regressor, target = regressor - mean_regressor, target - target.mean(axis=0)
    std = np.ones(target.shape[1])
    if noise_std is not None:
        std = finite_array(noise_std, std.shape, "torque_noise_std_Nm")
        if np.any(std <= 0.0):
            raise InputError(f"torque_noise_std_Nm must be positive at every joint: {std.tolist()}")
    for _ in range(_REWEIGHTINGS if noise_std is None else 0):
        solution = _solve(regressor, target, std)[0]
        rms = np.sqrt(np.mean((target - regressor @ solution) ** 2, axis=0))
        # A joint that fits to rounding must not outweigh the others without bound.
        std = np.maximum(rms, max(1e-3 * rms.max(), 1e-12))
    solution, values, axes, rank = _solve(regressor, target, std)
    residual = (target - regressor @ solution) / std
    unknowns = rank + len(std) * fit_offsets
    inverse = axes[:rank].T @ np.diag(values[:rank] ** -2.0) @ axes[:rank]
    covariance = _covariance(regressor / std[:, None], residual, inverse, rank, unknowns)
    offsets_std = np.zeros(len(std))
    if fit_offsets:
        through_x = np.einsum("jp,pr,jr->j", mean_regressor, covariance, mean_regressor)
        offsets_std = np.sqrt(np.var(residual * std, axis=0) / len(target) + through_x)
    unknown = np.linalg.norm(axes[rank:], axis=0) > 1e-6
    covariance[unknown, :] = covariance[:, unknown] = 0.0
    covariance[unknown, unknown] = np.inf
    root = values[:rank, None] * axes[:rank]
    return solution, covariance, root, rank, offsets_std


def _solve(regressor: Array, target: Array, std: Array) -> tuple[Array, Array, Array, int]:
    """Return the shortest solution, singular values, right singular vectors and rank."""
    matrix = (regressor / std[:, None]).reshape(target.size, -1)
    # The axes are complete also where there are fewer equations than unknowns.
    left, values, axes = np.linalg.svd(matrix, full_matrices=target.size < matrix.shape[1])
    rank = int(np.sum(values > _RANK_TOLERANCE * max(values[0], 1e-300)))
    solution = axes[:rank].T @ (((target / std).ravel() @ left)[:rank] / values[:rank])
    return solution, values, axes, rank


def _covariance(
    regressor: Array, residual: Array, inverse: Array, rank: int, unknowns: int
) -> Array:
    """Return the covariance from whitened data and the inverse on the determined subspace."""
    count = len(residual)
    if count >= 2 * _BLOCKS:
        # Model errors last for whole stretches of motion, so samples are far from independent: the
        # scatter of the gradient over consecutive blocks counts (a cluster-robust covariance).
        gradient = np.einsum("njp,nj->np", regressor, residual)
        bounds = np.linspace(0, count, _BLOCKS + 1).astype(int)[:-1]
        blocks = np.add.reduceat(gradient, bounds, axis=0)
        return inverse @ (blocks.T @ blocks) @ inverse * _BLOCKS / (_BLOCKS - rank)
    freedom = residual.size - unknowns
    variance = float(np.sum(residual**2)) / freedom if freedom > 0 else np.inf
    return inverse * max(variance, 1e-300)
