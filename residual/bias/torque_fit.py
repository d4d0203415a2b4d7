"""Fits the torques of a recorded free motion by least squares, with priors.

A torque that is right differs from the model's by offsets, errors of links and
friction, each of which has a prior. What may be wrong with it (a factor, a payload,
another gravity, ...) is fitted beside these. The evidence is the probability of the
measured torque with all of them integrated out, with the sizes of the priors that make
it largest: explanations of one motion are compared by it.
"""

from collections.abc import Sequence
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from foundation.arrays import Array
from foundation.steps import Steps
from residual.bias.fit import Octaves, search_octaves
from residual.bias.model import LINK_PARAMETERS, BiasModel, TareBlocks

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


class Evidence(NamedTuple):
    """What was fitted.

    Attributes:
        extra: Estimates of the extra unknowns, shape (e,).
        extra_std: Their standard deviations, shape (e,).
    """

    extra: Array
    extra_std: Array


class TorqueFit:
    """Fits one recorded motion; `in_steps` makes it.

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
        parts = np.array_split(np.arange(count), min(MAX_SEGMENTS, count))
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
        noise = _noise_of_blocks(measured, blocks.scatter_Nm2)
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

    @classmethod
    def in_steps(
        cls, basis: BiasModel, blocks: TareBlocks, *, adds_gravity: bool
    ) -> Steps[Self]:
        """Return the fit of a motion.

        Args:
            basis: Model of its bias.
            blocks: The motion.
            adds_gravity: Whether gravity is added to the measured torque.
        """
        speed_rad_s = blocks.states[:, -1]
        rate_rad_s2 = _rate_of(speed_rad_s, blocks.age_s)
        q_rad = blocks.lagged_q_rad
        regressor = np.empty((*q_rad.shape, LINK_PARAMETERS * basis.joints))
        gravity_Nm = np.zeros_like(q_rad)
        for k, q in enumerate(q_rad):
            regressor[k] = basis.moving_regressor(q, speed_rad_s[k], rate_rad_s2[k])
            if adds_gravity:
                gravity_Nm[k] = basis.gravity_Nm(q)
            if k % BLOCKS_PER_STEP == 0:
                yield
        yield
        return cls(basis, blocks, regressor, gravity_Nm)

    def evaluate(
        self, extra: Array, extra_std: Array, sizes: Octaves | None = None
    ) -> Steps[Evidence]:
        """Return what the torques show of further unknowns.

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

        def solve(octaves: Octaves) -> tuple[float, Array, Array, Array]:
            """Return log evidence, and what the unknowns follow from in prior units.

            These are the Cholesky root of the normal matrix, the prior deviations with
            their sizes, and the right-hand side behind the root.
            """
            variance = self._noise + np.square(2.0 ** octaves[-1] * self._remaining)
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
            log -= 0.5 * len(difference_Nm) * np.log(variance).sum()
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
        _, root, scaled_std, whitened = solve(sizes)
        yield
        scaled = scaled_std[len(std) - count :]
        # The last columns of the inverse root: the extra unknowns come last.
        units = np.eye(len(std))[:, len(std) - count :]
        inverse_root = solve_triangular(root, units, lower=True, check_finite=False)
        mean = scaled * (inverse_root.T @ whitened)
        posterior_std = scaled * np.sqrt(np.square(inverse_root).sum(axis=0))
        return Evidence(mean, np.asarray(posterior_std, float))


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
