"""What a free motion shows of the torques: their scale, and a mass that is missing.

A torque that is right differs from the model's by offsets, errors of links and
friction, each of which has a prior. A factor of all torques, one of each joint's, and a
payload that the model lacks are fitted beside these, by least squares, with the sizes
of the priors that make the measured torque most probable.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from foundation.arrays import Array
from foundation.steps import Steps
from residual.bias.fit import Octaves, search_octaves
from residual.bias.model import LINK_PARAMETERS, BiasModel, TareBlocks
from residual.errors import named_joints

SIGMAS = 3.0
"""What is so many of its own deviations from what was expected, deviates."""

START_OCTAVES = (0.0, 0.0, 2.0, 1.0)
"""Exponents of two of the sizes of offsets, links, friction and of what no cause
explains, from which the search starts and where none is made."""

MIN_BLOCKS = 5
"""Fewest blocks for a noise, or for a rate, from their differences."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TorqueDiagnosis:
    """What a free motion shows of the torques.

    Attributes:
        scale: Measured torque over that of the model, all joints together.
        scale_std: Its standard deviation; links, offsets and friction are unknown.
        joint_scale: The same of each joint, shape (n,).
        joint_scale_std: Its standard deviation, shape (n,).
        axial_lever_m: Largest torque per newton along the needle of each joint in the
            motion, shape (n,).
        payload_kg: Mass that the model lacks behind the last joint.
        payload_std_kg: Its standard deviation.
    """

    scale: float
    scale_std: float
    joint_scale: Array
    joint_scale_std: Array
    axial_lever_m: Array
    payload_kg: float
    payload_std_kg: float

    @property
    def scale_deviates(self) -> bool:
        """Whether the scale is not 1 by more than three deviations."""
        return abs(self.scale - 1.0) > SIGMAS * self.scale_std

    @property
    def deviating_joints(self) -> list[int]:
        """Indices of joints whose scale is not 1 by more than three deviations."""
        error = np.abs(self.joint_scale - 1.0)
        return np.flatnonzero(error > SIGMAS * self.joint_scale_std).tolist()

    @property
    def wrong_joints(self) -> list[int]:
        """Indices of joints whose torque is surely of another kind than the model's."""
        max_error = 0.4  # no sensor is so far off
        return [
            k
            for k in self.deviating_joints
            if abs(self.joint_scale[k] - 1.0) > max_error
        ]

    @property
    def scale_doubt(self) -> float:
        """Standard deviation of the scale of a force, relative to the force."""
        # Where the motion shows nothing of it: a torque sensor's scale is within 10 %.
        doubt = 1.0 / math.hypot(1.0 / self.scale_std, 1.0 / 0.1)
        if self.scale_deviates:
            doubt = math.hypot(doubt, self.scale - 1.0)
        # A joint with less hardly feels a force along the needle; one of a wrong scale
        # may be the one that feels it.
        min_lever_m = 5e-3
        for k in self.deviating_joints:
            if self.axial_lever_m[k] > min_lever_m:
                doubt = max(doubt, abs(float(self.joint_scale[k]) - 1.0))
        return doubt

    def describe_unchecked(self) -> str:
        """Return which joints show neither sign nor scale; empty if all do."""
        unchecked = np.flatnonzero(self.joint_scale_std > 0.5)
        if not unchecked.size:
            return ""
        joints = named_joints(unchecked)
        return f"{joints} not checked (too little gravity in this motion)"

    def describe(self) -> str:
        """Return in one line what the torques are beside those of the model."""
        texts: list[str] = []
        if self.scale_std < 0.25:  # else the motion does not show it
            texts.append(
                f"all together tau is {self.scale:.3g} +/- {self.scale_std:.2g} times "
                "what the model expects"
            )
        texts += [
            f"tau of {named_joints([joint])} is {self.joint_scale[joint]:.3g} +/- "
            f"{self.joint_scale_std[joint]:.2g} times it"
            for joint in self.deviating_joints
        ]
        return "; ".join(texts)


class TorqueFit:
    """Fits one recorded motion by least squares, with priors.

    Args:
        basis: Model of its bias.
        blocks: The motion.
        regressor: Torque per mass and first moment of the links, shape (m, n, 4 n).
        gravity_Nm: Gravity that was added to the measured torque, shape (m, n).

    Attributes:
        model_Nm: Torque of the model over k parts of the motion, shape (k, n).
        payload_columns: Of it per mass and first moment of the last link, shape (k, n,
            4).
    """

    def __init__(
        self, basis: BiasModel, blocks: TareBlocks, regressor: Array, gravity_Nm: Array
    ) -> None:
        joints = basis.joints
        measured = blocks.torque_Nm
        count = len(measured)
        # Parts that count as independent: what the model lacks lasts longer than a
        # block.
        parts = np.array_split(np.arange(count), min(24, count))
        self._residual_Nm = _mean_of(blocks.residual_Nm, parts)
        self.model_Nm = _mean_of(blocks.residual_Nm + measured + gravity_Nm, parts)
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
        sensed = measured + gravity_Nm  # also by sensors whose gravity is left out
        resolution = 3e-4 * np.abs(sensed).max(axis=0) + 1e-6
        noise = blocks.scatter_Nm2
        if count >= MIN_BLOCKS:  # by second differences: motion is no noise
            noise = np.square(np.diff(measured, n=2, axis=0)).mean(axis=0) / 6.0
        # Filters outlast a block: a mean has four times the variance of white noise.
        self._noise = 4.0 * noise / (count / len(parts)) + np.square(resolution)
        load = float(np.abs(sensed / basis.effort_Nm).max()) + 1e-6
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

    def estimate(
        self, extra: Array, extra_std: Array, sizes: Octaves | None = None
    ) -> Steps[tuple[Array, Array]]:
        """Return what the torques show of further unknowns, and the deviations.

        Args:
            extra: Torque per unit of them, shape (k, n, e).
            extra_std: Their prior deviations, shape (e,).
            sizes: Exponents of the four sizes; None to choose the most probable.
        """
        count = extra.shape[2]
        columns = np.concatenate((self._columns, extra), axis=2)
        std = np.concatenate((self._std, extra_std))
        groups = np.concatenate((self._groups, np.full(count, 3)))
        difference_Nm = self._residual_Nm
        squares = columns.transpose(1, 2, 0) @ columns.transpose(1, 0, 2)
        products = np.einsum("kjp,kj->jp", columns, difference_Nm)
        sum_of_squares = np.square(difference_Nm).sum(axis=0)

        def prior_std(octaves: Octaves) -> Array:
            """Return the prior deviations with sizes, shape (p,)."""
            return std * np.append(2.0 ** np.array(octaves[:-1]), 1.0)[groups]

        def solve(octaves: Octaves) -> tuple[float, tuple[Array, Array]]:
            """Return log evidence, and what the unknowns follow from in prior units.

            These are the Cholesky root of the normal matrix, and the right-hand side
            behind the root.
            """
            variance = self._noise + np.square(2.0 ** octaves[-1] * self._remaining)
            scaled = prior_std(octaves)
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
            log -= 0.5 * len(difference_Nm) * np.log(variance).sum()
            # Sizes far from the prior's are less probable: deviations of exponents.
            log -= 0.5 * np.square(np.array(octaves) / (2.0, 1.0, 3.0, 3.0)).sum()
            return float(log), (np.asarray(root, float), whitened)

        yield
        if sizes is None:
            # Beyond eight times the prior's, errors of links are of another kind;
            # friction behind a harmonic drive reaches a tenth of the range.
            ends = ((-1.0, 4.1), (-2.0, 3.1), (-2.0, 8.1), (0.0, 6.1))
            grids = [np.arange(*end) for end in ends]
            sizes = yield from search_octaves(
                lambda octaves: solve(octaves)[0], START_OCTAVES, grids, sweeps=2
            )
        _, (root, whitened) = solve(sizes)
        yield
        scaled = prior_std(sizes)[len(std) - count :]
        # The last columns of the inverse root: the extra unknowns come last.
        units = np.eye(len(std))[:, len(std) - count :]
        inverse_root = solve_triangular(root, units, lower=True, check_finite=False)
        mean = scaled * (inverse_root.T @ whitened)
        posterior_std = scaled * np.sqrt(np.square(inverse_root).sum(axis=0))
        return mean, np.asarray(posterior_std, float)


def diagnose_torques(
    basis: BiasModel, blocks: TareBlocks, levers_m: Array, *, adds_gravity: bool
) -> Steps[TorqueDiagnosis]:
    """Return what a motion shows of the torques.

    Args:
        basis: Model of its bias.
        blocks: The motion.
        levers_m: Torque per newton along the needle, shape (m, n).
        adds_gravity: Whether gravity is added to the measured torque.
    """
    joints = basis.joints
    speed_rad_s = blocks.states[:, -1]
    rate_rad_s2 = np.zeros_like(speed_rad_s)
    if len(speed_rad_s) >= MIN_BLOCKS:
        rate_rad_s2 = np.gradient(speed_rad_s, blocks.age_s, axis=0)
    q_rad = blocks.lagged_q_rad
    regressor = np.empty((*q_rad.shape, LINK_PARAMETERS * joints))
    gravity_Nm = np.zeros_like(q_rad)
    for k, q in enumerate(q_rad):
        regressor[k] = basis.moving_regressor(q, speed_rad_s[k], rate_rad_s2[k])
        if adds_gravity:
            gravity_Nm[k] = basis.gravity_Nm(q)
        if k % 16 == 0:
            yield
    yield
    fit = TorqueFit(basis, blocks, regressor, gravity_Nm)
    model_Nm = fit.model_Nm[:, :, None]
    error, scale_std = yield from fit.estimate(model_Nm, np.ones(1))
    each_Nm = model_Nm * np.eye(joints)
    joint_error, joint_std = yield from fit.estimate(each_Nm, np.ones(joints))
    # Prior deviations of a payload: mass [kg], first moments [kg m].
    payload_std = np.array([2.0, 0.3, 0.3, 0.3])
    load, load_std = yield from fit.estimate(
        fit.payload_columns, payload_std, START_OCTAVES
    )
    return TorqueDiagnosis(
        scale=1.0 - float(error[0]),
        scale_std=float(scale_std[0]),
        joint_scale=1.0 - joint_error,
        joint_scale_std=joint_std,
        axial_lever_m=np.abs(levers_m).max(axis=0),
        payload_kg=-float(load[0]),
        payload_std_kg=float(load_std[0]),
    )


def _mean_of(values: Array, parts: Sequence[NDArray[np.intp]]) -> Array:
    """Return the means over parts of blocks, shape (parts, ...)."""
    starts = [int(part[0]) for part in parts]
    lengths = np.array([len(part) for part in parts], dtype=float)
    sums = np.add.reduceat(values, starts, axis=0)
    return sums / lengths.reshape(-1, *[1] * (values.ndim - 1))
