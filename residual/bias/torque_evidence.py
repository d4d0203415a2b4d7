"""How probable a recorded free motion is under an assumption about its torques.

A torque that is right differs from the model's by offsets, errors of links and
friction, each of which has a prior. The evidence of an assumption is the probability of
the measured torque once the assumption has corrected it, all of these integrated out,
with the sizes of the priors that make it largest.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from foundation.arrays import Array
from foundation.steps import Steps
from residual.bias.model import LINK_PARAMETERS, BiasModel, TareBlocks

MAX_SEGMENTS = 24
"""Parts of the motion that count as independent: what the model lacks lasts longer than
a block."""

OFFSET_OCTAVES = np.arange(-1.0, 4.1)
"""Exponents of two that are tried for the size of offsets, relative to the prior's."""

LINK_OCTAVES = np.arange(-2.0, 3.1)
"""The same for errors of links: beyond eight times the prior's they are no errors of
masses but of another kind."""

FRICTION_OCTAVES = np.arange(-2.0, 8.1)
"""The same for friction: behind a harmonic drive it reaches a tenth of the range."""

REMAINING_OCTAVES = np.arange(0.0, 6.1)
"""The same for what no cause explains, relative to `REMAINING_RATIO`."""

REMAINING_RATIO = 1e-3
"""Least size of what no cause explains, relative to the largest load that was measured,
as a fraction of each joint's effort limit. In the unit of the measurement it is the
same for all assumptions."""

OCTAVES_STD = (2.0, 1.0, 3.0, 3.0)
"""Prior deviation of the four exponents above, in their order."""

OCTAVES = (OFFSET_OCTAVES, LINK_OCTAVES, FRICTION_OCTAVES, REMAINING_OCTAVES)
"""The four, in their order."""

START_OCTAVES = (0.0, 0.0, 2.0, 1.0)
"""Exponents from which the search starts, and where none is made."""

EXTRA = 3
"""Number of the group whose size is that of the prior: an assumption's own unknowns."""

SWEEPS = 2
"""Passes over the sizes, one at a time."""

BLOCKS_PER_STEP = 16
"""Blocks whose torque is computed in one step."""

SIZES_PER_STEP = 2
"""Sizes whose evidence is computed in one step."""

COLOURED_NOISE_RATIO = 4.0
"""Variance of a mean relative to that of white noise: filters outlast a block."""

MIN_NOISE_RATIO = 3e-4
"""Least noise of a measured torque, relative to its largest value: a resolution."""

MIN_NOISE_Nm = 1e-6
"""Least noise of a torque that is always zero: finer than sensors resolve, and coarse
enough that the sums of a motion can still be inverted."""

MIN_LOAD_RATIO = 1e-6
"""Least load that counts, as a fraction of a joint's effort limit: what no cause
explains keeps a size where every torque is zero."""

MIN_BLOCKS_OF_NOISE = 5
"""Fewest blocks for a noise from their second differences."""


class MotionSegments(NamedTuple):
    """Means over k parts of a free motion.

    Attributes:
        blocks: The blocks of the motion.
        parts: Numbers of the blocks of every part.
        columns: Torque per unit of every cause, shape (k, n, p).
        noise: Variance of a mean of the measured torque, shape (n,).
    """

    blocks: TareBlocks
    parts: tuple[NDArray[np.intp], ...]
    columns: Array
    noise: Array

    def mean_of(self, values: Array) -> Array:
        """Return the means over every part of values of the blocks, shape (k, ...)."""
        return _mean_of(values, self.parts)


class Evidence(NamedTuple):
    """How probable a motion is, and what makes it so.

    Attributes:
        log: Logarithm of the probability, but for a constant.
        extra: Estimates of the extra unknowns, shape (e,).
        extra_std: Their standard deviations, shape (e,).
    """

    log: float
    extra: Array
    extra_std: Array


class TorqueEvidence:
    """Evaluates assumptions about the torques of one recorded motion.

    Args:
        basis: Model of the causes.
        blocks: The motion.
        regressor: Torque per mass and first moment of every link, shape (m, n, 4 n);
            `in_steps` computes it.

    Attributes:
        basis: As given.
        segments: Its parts.
        sizes: Exponents of the sizes of the latest evaluation.
        regressor_of_blocks: As given.
    """

    START_OCTAVES: ClassVar[tuple[float, ...]] = START_OCTAVES
    """Exponents of the sizes where none are searched."""

    def __init__(self, basis: BiasModel, blocks: TareBlocks, regressor: Array) -> None:
        self.basis = basis
        joints = basis.joints
        parts = np.array_split(
            np.arange(len(blocks.age_s)), min(MAX_SEGMENTS, len(blocks.age_s))
        )
        measured = blocks.torque_Nm
        self.regressor_of_blocks = regressor
        friction_states = basis.states - basis.loops
        columns = np.zeros((len(parts), joints, joints * (5 + friction_states)))
        columns[:, :, :joints] = np.eye(joints)
        columns[:, :, joints : 5 * joints] = _mean_of(regressor, parts)
        friction = _mean_of(blocks.states[:, basis.loops :], parts)
        each = np.arange(joints)
        for state in range(friction_states):
            columns[:, each, (5 + state) * joints + each] = friction[:, state]
        noise = _noise_of_blocks(measured, blocks.scatter_Nm2)
        per_part = len(measured) / len(parts)
        resolution = MIN_NOISE_RATIO * np.abs(measured).max(axis=0) + MIN_NOISE_Nm
        self.segments = MotionSegments(
            parts=tuple(parts),
            blocks=blocks,
            columns=columns,
            noise=COLOURED_NOISE_RATIO * noise / per_part + np.square(resolution),
        )
        load = float(np.abs(measured / basis.effort_Nm).max()) + MIN_LOAD_RATIO
        self._remaining = REMAINING_RATIO * load * basis.effort_Nm
        prior = basis.prior
        coulomb = np.tile(
            prior.friction_fraction * basis.effort_Nm, friction_states - 1
        )
        viscous = prior.viscous_fraction_s * basis.effort_Nm
        self._std = np.concatenate(
            (
                prior.offset_fraction * basis.effort_Nm,
                basis.link_std,
                coulomb,
                viscous,
            )
        )
        self.sizes = START_OCTAVES
        self._groups = np.repeat(
            [0, 1, 2], [joints, LINK_PARAMETERS * joints, joints * friction_states]
        )

    @classmethod
    def in_steps(cls, basis: BiasModel, blocks: TareBlocks) -> Steps[Self]:
        """Return the evidence of a motion."""
        speed_rad_s = blocks.states[:, -1]
        motion = zip(
            blocks.lagged_q_rad,
            speed_rad_s,
            _rate_of(speed_rad_s, blocks.age_s),
            strict=True,
        )
        links = LINK_PARAMETERS * basis.joints
        regressor = np.empty((*blocks.q_rad.shape, links))
        for number, one in enumerate(motion):
            regressor[number] = basis.moving_regressor(*one)
            if number % BLOCKS_PER_STEP == 0:
                yield
        yield
        return cls(basis, blocks, regressor)

    def evaluate(
        self,
        difference_Nm: Array,
        factor: Array,
        extra: Array | None = None,
        extra_std: Array | None = None,
        *,
        order: tuple[int, ...] | None = None,
        sizes: tuple[float, ...] | None = None,
    ) -> Steps[Evidence]:
        """Return the evidence of an assumption.

        Args:
            difference_Nm: Torque of the model minus that measured, corrected as the
                assumption says, shape (k, n).
            factor: What a unit of measured torque is in corrected torque, shape (n,).
            extra: Torque per unit of the assumption's own unknowns, shape (k, n, e).
            extra_std: Their prior deviations, shape (e,).
            order: Measured torque that each corrected one is made of; None for its
                own.
            sizes: Exponents of the four sizes; None to choose the most probable.
        """
        columns = self.segments.columns
        std = self._std
        groups = self._groups
        count = 0
        if extra is not None and extra_std is not None:
            count = extra.shape[2]
            columns = np.concatenate((columns, extra), axis=2)
            std = np.concatenate((std, extra_std))
            groups = np.concatenate((groups, np.full(count, EXTRA)))
        noise = self.segments.noise if order is None else self.segments.noise[[*order]]
        equations = _Equations(
            squares=columns.transpose(1, 2, 0) @ columns.transpose(1, 0, 2),
            products=np.einsum("kjp,kj->jp", columns, difference_Nm),
            sum_of_squares=np.square(difference_Nm).sum(axis=0),
            parts=len(difference_Nm),
            noise_Nm2=noise * np.square(factor),
            factor=factor,
            std=std,
            groups=groups,
            remaining_Nm=self._remaining * np.abs(factor),
        )
        yield
        if sizes is None:
            sizes = yield from _likeliest_sizes(equations)
        self.sizes = sizes
        solution = equations.solve(sizes)
        yield
        scaled = solution.scaled_std[len(std) - count :]
        # The last columns of the inverse root: the extra unknowns come last.
        units = np.eye(len(std))[:, len(std) - count :]
        inverse_root = solve_triangular(
            solution.root, units, lower=True, check_finite=False
        )
        mean = scaled * (inverse_root.T @ solution.whitened)
        posterior_std = scaled * np.sqrt(np.square(inverse_root).sum(axis=0))
        return Evidence(solution.log, mean, np.asarray(posterior_std, float))


class _Solution(NamedTuple):
    """Log evidence at given sizes, and what the posterior follows from.

    Attributes:
        log: Logarithm of the evidence.
        root: Cholesky root of the normal matrix in units of the prior, shape (p, p).
        scaled_std: Prior deviations with their sizes, shape (p,).
        whitened: Columns times weighted difference, in units of the prior and behind
            the root, shape (p,).
    """

    log: float
    root: Array
    scaled_std: Array
    whitened: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Equations:
    """Sums over a motion, from which the evidence at any sizes follows.

    Attributes:
        squares: Products of columns, by joint, shape (n, p, p).
        products: Columns times difference, shape (n, p).
        sum_of_squares: Of the differences, shape (n,).
        parts: Number of parts of the motion.
        noise_Nm2: Variance of a corrected torque, shape (n,).
        factor: What a unit of measured torque is in corrected torque, shape (n,).
        std: Prior deviations, shape (p,).
        groups: Which size belongs to each of them, shape (p,).
        remaining_Nm: Least size of what no cause explains, shape (n,).
    """

    squares: Array
    products: Array
    sum_of_squares: Array
    parts: int
    noise_Nm2: Array
    factor: Array
    std: Array
    groups: NDArray[np.intp]
    remaining_Nm: Array

    def solve(self, octaves: tuple[float, ...]) -> _Solution:
        """Return the evidence at sizes that are given by their exponents."""
        remaining_Nm = 2.0 ** octaves[-1] * self.remaining_Nm
        variance = self.noise_Nm2 + np.square(remaining_Nm)
        sizes = np.append(2.0 ** np.array(octaves[:-1]), 1.0)
        scaled = self.std * sizes[self.groups]
        information = np.tensordot(1.0 / variance, self.squares, axes=1)
        evidence = self.products.T @ (1.0 / variance)
        root = np.linalg.cholesky(
            np.eye(len(scaled)) + information * np.outer(scaled, scaled)
        )
        whitened = solve_triangular(
            root, scaled * evidence, lower=True, check_finite=False
        )
        log = 0.5 * whitened @ whitened - np.log(root.diagonal()).sum()
        log -= 0.5 * (self.sum_of_squares / variance).sum()
        # In the unit of the measurement, so that assumptions can be compared.
        log -= 0.5 * self.parts * np.log(variance / np.square(self.factor)).sum()
        log -= 0.5 * np.square(np.array(octaves) / OCTAVES_STD).sum()
        return _Solution(float(log), np.asarray(root, float), scaled, whitened)


def _likeliest_sizes(equations: _Equations) -> Steps[tuple[float, ...]]:
    """Return the exponents of the sizes that make the motion most probable."""
    known: dict[tuple[float, ...], float] = {}
    best = START_OCTAVES
    for _ in range(SWEEPS):
        for place, grid in enumerate(OCTAVES):
            tried = [
                (*best[:place], float(octave), *best[place + 1 :]) for octave in grid
            ]
            for octaves in tried:
                if octaves not in known:
                    known[octaves] = equations.solve(octaves).log
                    if len(known) % SIZES_PER_STEP == 0:
                        yield
            best = max(tried, key=lambda octaves: known[octaves])
    return best


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
