"""Fits the torques of a recorded free motion by least squares, with priors.

A torque that is right differs from the model's by offsets, errors of links and
friction, each of which has a prior. What may be wrong with it (a factor, a payload,
another gravity, ...) is fitted beside these. The evidence is the probability of the
measured torque with all of them integrated out, with the sizes of the priors that make
it largest: explanations of one motion are compared by it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from foundation.arrays import Array
from foundation.steps import Steps
from residual.bias.fit import Octaves, search_octaves
from residual.bias.model import LINK_PARAMETERS, BiasModel, TareBlocks
from urdf import Robot

START_OCTAVES = (0.0, 0.0, 2.0, 1.0)
"""Exponents of two of the sizes of offsets, links, friction and of what no cause
explains, from which the search starts and where none is made."""

MAX_SEGMENTS = 24
"""Parts of the motion that count as independent: what the model lacks lasts longer than
a block."""

BLOCKS_PER_STEP = 16
"""Blocks whose torque is computed in one step."""

MIN_BLOCKS_OF_NOISE = 5
"""Fewest blocks for a noise, or for a rate, from their differences."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Correction:
    """What makes a recorded motion right.

    Attributes:
        order: Joint j is given as number ``order[j]``, shape (n,).
        is_order_of_all: Whether positions and velocities are in that order, too.
        factors: Factor of each torque, in the robot's order, shape (n,).
        adds_gravity: Whether gravity is added to the torque.
        payload: Mass and first moments about the last joint that the model lacks [kg,
            kg m], shape (4,).
        gravity_m_s2: Gravity in base axes, shape (3,); None for the model's.
    """

    order: tuple[int, ...]
    is_order_of_all: bool = False
    factors: Array
    adds_gravity: bool
    payload: Array
    gravity_m_s2: Array | None = None


class Evidence(NamedTuple):
    """How probable a motion is, and what was fitted.

    Attributes:
        log: Logarithm of the probability, but for a constant.
        extra: Estimates of the extra unknowns, shape (e,).
        extra_std: Their standard deviations, shape (e,).
    """

    log: float
    extra: Array
    extra_std: Array


class TorqueFit:
    """Fits one recorded motion; `in_steps` makes it.

    Attributes:
        robot: The arm with its payload.
        as_given: No correction.
        measured_Nm: Measured torque over k parts of the motion, shape (k, n).
        model_Nm: Torque of the model over them, shape (k, n).
        payload_columns: Of it per mass and first moment of the last link, shape (k, n,
            4).
        gravity_columns: Of it per unit of gravity along x, y, z, shape (k, n, 3).
        effort_Nm: Effort limit per joint, shape (n,).
    """

    def __init__(
        self,
        robot: Robot,
        basis: BiasModel,
        blocks: TareBlocks,
        regressor: Array,
        gravity_columns: Array,
        *,
        adds_gravity: bool,
    ) -> None:
        self.robot = robot
        self.effort_Nm = basis.effort_Nm
        self._basis = basis
        self._blocks = blocks
        self._regressor = regressor
        self._gravity_columns = gravity_columns
        self._gravity_Nm = gravity_columns @ np.array(robot.gravity_m_s2)
        self._model_Nm = blocks.residual_Nm + blocks.torque_Nm
        if adds_gravity:
            self._model_Nm = self._model_Nm + self._gravity_Nm
        joints = basis.joints
        self.as_given = Correction(
            order=tuple(range(joints)),
            factors=np.ones(joints),
            adds_gravity=adds_gravity,
            payload=np.zeros(LINK_PARAMETERS),
        )
        measured = blocks.torque_Nm
        count = len(measured)
        parts = np.array_split(np.arange(count), min(MAX_SEGMENTS, count))
        self._parts = parts
        self.measured_Nm = _mean_of(measured, parts)
        self.model_Nm = _mean_of(self._model_Nm, parts)
        self.gravity_Nm = _mean_of(self._gravity_Nm, parts)
        self.gravity_columns = _mean_of(gravity_columns, parts)
        friction_states = basis.states - basis.loops
        columns = np.zeros((len(parts), joints, joints * (5 + friction_states)))
        columns[:, :, :joints] = np.eye(joints)
        columns[:, :, joints : 5 * joints] = _mean_of(regressor, parts)
        friction = _mean_of(blocks.states[:, basis.loops :], parts)
        each = np.arange(joints)
        for state in range(friction_states):
            columns[:, each, (5 + state) * joints + each] = friction[:, state]
        self._columns = columns
        self.payload_columns = columns[:, :, 5 * joints - LINK_PARAMETERS : 5 * joints]
        # A sensor resolves 3e-4 of its largest value, and finer than 1e-6 Nm none does.
        resolution = 3e-4 * np.abs(measured).max(axis=0) + 1e-6
        noise = _noise_of_blocks(measured, blocks.scatter_Nm2)
        # Filters outlast a block: a mean has four times the variance of white noise.
        self._noise = 4.0 * noise / (count / len(parts)) + np.square(resolution)
        load = float(np.abs(measured / basis.effort_Nm).max()) + 1e-6
        # What no cause explains is at least 1e-3 of the largest load.
        self._remaining = 1e-3 * load * basis.effort_Nm
        prior = basis.prior
        coulomb = np.tile(
            prior.friction_fraction * basis.effort_Nm, friction_states - 1
        )
        viscous = prior.viscous_fraction_s * basis.effort_Nm
        offset = prior.offset_fraction * basis.effort_Nm
        self._std = np.concatenate((offset, basis.link_std, coulomb, viscous))
        self._groups = np.repeat(
            [0, 1, 2], [joints, LINK_PARAMETERS * joints, joints * friction_states]
        )

    @classmethod
    def in_steps(
        cls, robot: Robot, basis: BiasModel, blocks: TareBlocks, *, adds_gravity: bool
    ) -> Steps[Self]:
        """Return the fit of a motion.

        Args:
            robot: The arm with its payload.
            basis: Model of its bias.
            blocks: The motion.
            adds_gravity: Whether gravity is added to the measured torque.
        """
        speed_rad_s = blocks.states[:, -1]
        rate_rad_s2 = _rate_of(speed_rad_s, blocks.age_s)
        q_rad = blocks.lagged_q_rad
        model = pin.Model(robot.model)
        data = model.createData()
        regressor = np.empty((*q_rad.shape, LINK_PARAMETERS * basis.joints))
        gravity_columns = np.empty((*q_rad.shape, 3))
        for k, q in enumerate(q_rad):
            regressor[k] = basis.moving_regressor(q, speed_rad_s[k], rate_rad_s2[k])
            if k % BLOCKS_PER_STEP == 0:
                yield
        for axis in range(3):
            model.gravity = pin.Motion(np.eye(3)[axis].copy(), np.zeros(3))
            for k, q in enumerate(q_rad):
                gravity_columns[k, :, axis] = pin.computeGeneralizedGravity(
                    model, data, q
                )
                if k % (2 * BLOCKS_PER_STEP) == 0:
                    yield
        yield
        return cls(
            robot,
            basis,
            blocks,
            regressor,
            gravity_columns,
            adds_gravity=adds_gravity,
        )

    def corrected_motion(self, correction: Correction) -> TareBlocks:
        """Return the motion as it would have been recorded with a correction."""
        blocks = self._blocks
        order = list(correction.order)
        if correction.is_order_of_all:
            return compute_motion(
                self.robot, blocks, order, adds_gravity=correction.adds_gravity
            )
        torque_Nm = blocks.torque_Nm[:, order] * correction.factors
        if correction.adds_gravity:
            torque_Nm = torque_Nm + self._gravity_Nm
        columns = self._regressor[:, :, -LINK_PARAMETERS:]
        model_Nm = self._model_Nm + columns @ correction.payload
        if correction.gravity_m_s2 is not None:
            turned_Nm = self._gravity_columns @ correction.gravity_m_s2
            model_Nm = model_Nm - self._gravity_Nm + turned_Nm
        states = blocks.states.copy()
        loops = self._basis.loops
        # Hysteresis follows the torque, and its sign.
        states[:, :loops] = states[:, :loops, order] * np.sign(correction.factors)
        return replace(
            blocks,
            states=states,
            residual_Nm=model_Nm - torque_Nm,
            torque_Nm=torque_Nm,
            scatter_Nm2=blocks.scatter_Nm2[order] * np.square(correction.factors),
        )

    def torque_without(self, correction: Correction) -> Array:
        """Return the model's torque without gravity that is added, shape (k, n)."""
        return self.model_Nm - (self.gravity_Nm if correction.adds_gravity else 0.0)

    def evaluate(
        self,
        correction: Correction,
        extra: Array | None = None,
        extra_std: Array | None = None,
        *,
        sizes: Octaves | None = None,
    ) -> Steps[Evidence]:
        """Return the evidence of a correction of the torques.

        Args:
            correction: The correction.
            extra: Torque per unit of further unknowns, shape (k, n, e).
            extra_std: Their prior deviations, shape (e,).
            sizes: Exponents of the four sizes; None to choose the most probable.
        """
        columns = self._columns
        std = self._std
        groups = self._groups
        count = 0
        if extra is not None and extra_std is not None:
            count = extra.shape[2]
            columns = np.concatenate((columns, extra), axis=2)
            std = np.concatenate((std, extra_std))
            groups = np.concatenate((groups, np.full(count, 3)))
        factor = correction.factors
        motion = self.corrected_motion(correction)
        difference_Nm = _mean_of(motion.residual_Nm, self._parts)
        squares = columns.transpose(1, 2, 0) @ columns.transpose(1, 0, 2)
        products = np.einsum("kjp,kj->jp", columns, difference_Nm)
        sum_of_squares = np.square(difference_Nm).sum(axis=0)
        noise_Nm2 = self._noise[list(correction.order)] * np.square(factor)
        least_Nm = self._remaining * np.abs(factor)

        def solve(octaves: Octaves) -> tuple[float, Array, Array, Array]:
            """Return log evidence, and what the unknowns follow from in prior units.

            These are the Cholesky root of the normal matrix, the prior deviations with
            their sizes, and the right-hand side behind the root.
            """
            variance = noise_Nm2 + np.square(2.0 ** octaves[-1] * least_Nm)
            scaled = std * np.append(2.0 ** np.array(octaves[:-1]), 1.0)[groups]
            information = np.tensordot(1.0 / variance, squares, axes=1)
            evidence = products.T @ (1.0 / variance)
            root = np.linalg.cholesky(
                np.eye(len(scaled)) + information * np.outer(scaled, scaled)
            )
            whitened = solve_triangular(
                root, scaled * evidence, lower=True, check_finite=False
            )
            log = 0.5 * whitened @ whitened - np.log(root.diagonal()).sum()
            log -= 0.5 * (sum_of_squares / variance).sum()
            # In the unit of the measurement, so that explanations can be compared.
            unit_Nm2 = np.square(factor)
            log -= 0.5 * len(difference_Nm) * np.log(variance / unit_Nm2).sum()
            # Sizes far from the prior's are less probable: deviations of exponents.
            log -= 0.5 * np.square(np.array(octaves) / (2.0, 1.0, 3.0, 3.0)).sum()
            return float(log), np.asarray(root, float), scaled, whitened

        yield
        if sizes is None:
            # Beyond eight times the prior's, errors of links are of another kind;
            # friction behind a harmonic drive reaches a tenth of the range.
            ends = ((-1.0, 4.1), (-2.0, 3.1), (-2.0, 8.1), (0.0, 6.1))
            grids = [np.arange(*end) for end in ends]
            sizes = yield from search_octaves(
                lambda octaves: solve(octaves)[0], START_OCTAVES, grids, sweeps=2
            )
        log, root, scaled_std, whitened = solve(sizes)
        yield
        scaled = scaled_std[len(std) - count :]
        # The last columns of the inverse root: the extra unknowns come last.
        units = np.eye(len(std))[:, len(std) - count :]
        inverse_root = solve_triangular(root, units, lower=True, check_finite=False)
        mean = scaled * (inverse_root.T @ whitened)
        posterior_std = scaled * np.sqrt(np.square(inverse_root).sum(axis=0))
        return Evidence(log, mean, np.asarray(posterior_std, float))


def compute_motion(
    robot: Robot, blocks: TareBlocks, order: Sequence[int], *, adds_gravity: bool
) -> TareBlocks:
    """Return a recorded motion with the residual that another arm's model gives it.

    Args:
        robot: The arm.
        blocks: The motion as it was recorded.
        order: Joint j of the arm is number ``order[j]`` of the recorded ones.
        adds_gravity: Whether gravity is added to the measured torque.
    """
    columns = list(order)
    # `take` keeps rows contiguous, as compiled code has them.
    states = np.take(blocks.states, columns, axis=2)
    torque_Nm = np.take(blocks.torque_Nm, columns, axis=1)
    ordered = replace(
        blocks,
        q_rad=np.take(blocks.q_rad, columns, axis=1),
        states=states,
        torque_Nm=torque_Nm,
        scatter_Nm2=blocks.scatter_Nm2[columns],
    )
    speed_rad_s = states[:, -1]
    rate_rad_s2 = _rate_of(speed_rad_s, blocks.age_s)
    data = robot.create_data()
    residual_Nm = -torque_Nm
    for k, q in enumerate(ordered.lagged_q_rad):
        motion = (q, speed_rad_s[k], rate_rad_s2[k])
        residual_Nm[k] += pin.rnea(robot.model, data, *motion)
        if adds_gravity:
            residual_Nm[k] -= pin.computeGeneralizedGravity(robot.model, data, q)
    return replace(ordered, residual_Nm=residual_Nm)


def _mean_of(values: Array, parts: Sequence[NDArray[np.intp]]) -> Array:
    """Return the means over parts of blocks, shape (parts, ...)."""
    starts = [int(part[0]) for part in parts]
    lengths = np.array([len(part) for part in parts], dtype=float)
    sums = np.add.reduceat(values, starts, axis=0)
    return sums / lengths.reshape(-1, *[1] * (values.ndim - 1))


def _noise_of_blocks(values: Array, scatter: Array) -> Array:
    """Return the variance of the blocks' noise, shape (n,); motion is no noise."""
    if len(values) < MIN_BLOCKS_OF_NOISE:
        return scatter
    return np.square(np.diff(values, n=2, axis=0)).mean(axis=0) / 6.0


def _rate_of(values: Array, time_s: Array) -> Array:
    """Return the rate of change of values at the blocks, shape (m, n)."""
    if len(values) < MIN_BLOCKS_OF_NOISE:
        return np.zeros_like(values)
    return np.gradient(values, time_s, axis=0)
