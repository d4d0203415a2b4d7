"""Fits a tare to free motion: Bayesian least squares with learnt prior sizes.

The prior states how large link errors, friction and drift are on arms of a kind. On one
arm they may be several times smaller or larger: the sizes that make the motion
likeliest are used (empirical Bayes), so that the tare's covariance is that of this arm.
The size of hysteresis is not learnt: in air it is so similar to friction that each
would take half of the other.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.optimize import nnls

from foundation.arrays import Array
from foundation.steps import Steps
from residual.bias.coloured_noise import NoiseRoot, invert_covariance
from residual.bias.model import BiasModel, Tare, TareBlocks

LEARNT = ("links", "friction", "drift")
"""Groups of columns whose size is learnt, as is the random walk's; offset and ripple
show directly in the data."""

MIN_BLOCKS = 8
"""Fewest blocks for a variance from their differences: seven give it to two thirds of
itself, fewer may give nearly zero by chance, and the blocks would get too much
weight."""

Octaves = tuple[float, ...]
"""Exponents of two of sizes, relative to the prior's."""


class JointRows(NamedTuple):
    """What parameters do to one joint's residual over all blocks.

    Attributes:
        own: Numbers of the parameters that do anything, shape (k,).
        rows: Residual per unit of each, shape (blocks, k).
    """

    own: NDArray[np.intp]
    rows: Array


class FreeMotionFit:
    """The likeliest causes of the residuals of a free motion.

    Two passes. The first assumes independent noise, as large as between neighbouring
    blocks; what it leaves beyond that is the sensors' waviness, a wave along each
    joint's position that repeats when the joint returns. The second pass includes the
    waves in the noise, so that they do not count as many independent samples of a
    slope. `in_steps` makes a fit.

    Attributes:
        basis: Model of the causes.
        blocks: The motion.
        joint_rows: What the causes do to every joint.
        tare: The fitted offset.
        sizes: Of the groups in `LEARNT` and of the random walk, relative to the
            prior's.
    """

    joint_rows: list[JointRows]
    tare: Tare
    sizes: dict[str, float]

    def __init__(self, basis: BiasModel, blocks: TareBlocks) -> None:
        self.basis = basis
        self.blocks = blocks
        self._has_few_blocks = len(blocks.residual_Nm) < MIN_BLOCKS
        self._rows: list[JointRows] = []
        self._whitened: list[Array] = []

    @classmethod
    def in_steps(
        cls,
        basis: BiasModel,
        blocks: TareBlocks,
        contact: Array | None = None,
        *,
        learn: bool = True,
        joint_rows: list[JointRows] | None = None,
    ) -> Steps[Self]:
        """Fit the causes of a motion.

        Args:
            basis: Model of the causes.
            blocks: The motion.
            contact: Torque per newton of a force that is fitted beside them [Nm/N],
                shape (blocks, n, 3); None if there is none.
            learn: Whether the sizes are learnt; the prior's otherwise.
            joint_rows: Those of the blocks where another fit has them already.
        """
        yield
        fit = cls(basis, blocks)
        if joint_rows is None:
            joint_rows = yield from _joint_rows_of(basis, blocks)
        fit.joint_rows = joint_rows
        if contact is None:
            contact = np.zeros((*blocks.q_rad.shape, 0))
        has_walk = basis.kind == "model" and not fit._has_few_blocks
        # Eight terms of the series have 96 % of a random walk's variance.
        terms = 8 if has_walk else 0
        walk = _walk_columns(blocks.age_s, terms)
        walk_std = np.repeat(np.sqrt(basis.walk_Nm2_per_s()), terms)
        contact_std = np.full(contact.shape[2], 100.0)  # N: practically any force
        std = np.concatenate((basis.std, contact_std, walk_std))
        groups: dict[str, slice] = {}
        if learn and not fit._has_few_blocks:
            groups = {
                name: basis.groups[name] for name in LEARNT if name in basis.groups
            }
            if has_walk:
                groups["walk"] = slice(len(std) - len(walk_std), len(std))
        fit._rows = [
            _with_contact_and_walk(joint, rows, contact, walk, len(basis.std))
            for joint, rows in enumerate(joint_rows)
        ]
        yield
        noise_Nm2 = yield from fit._fit(std, groups)
        fit._keep_tare(noise_Nm2)
        return fit

    def _keep_tare(self, noise_Nm2: Array) -> None:
        """Keep the fitted parameters as a tare.

        Args:
            noise_Nm2: Variance of a single residual about the fit, shape (n,).
        """
        basis = self.basis
        own = slice(0, len(basis.std))
        self.tare = Tare(
            mean=self._mean[own].copy(),
            covariance=self._covariance[own, own].copy(),
            noise_Nm2=np.diag(noise_Nm2),
            scatter_Nm2=self.blocks.scatter_Nm2.copy(),
            walk_Nm2_per_s=basis.walk_Nm2_per_s() * self.sizes.get("walk", 1.0) ** 2,
        )
        for array in self.tare:
            if isinstance(array, np.ndarray):
                array.setflags(write=False)

    def _fit(self, std: Array, groups: dict[str, slice]) -> Steps[Array]:
        """Do both passes; return the variance of a residual about the fit, shape (n,).

        Args:
            std: Prior deviation of every parameter, shape (m,).
            groups: Parameters whose sizes are learnt, by their cause.
        """
        basis = self.basis
        blocks = self.blocks
        is_few = self._has_few_blocks
        # With few blocks their differences mean nothing: a block then counts as noisy
        # as a sample.
        resolution = np.square(basis.prior.resolution_fraction * basis.effort_Nm)
        white = resolution + (
            blocks.scatter_Nm2 if is_few else _noise_density(blocks.residual_Nm, (1,))
        )
        yield from self._set_noise(white, np.zeros_like(white))
        remaining = yield from self._solve(std, groups)
        yield
        density = white if is_few else resolution + _noise_density(remaining, (1, 2, 4))
        wave = _wave_variance(remaining, density, np.ptp(blocks.q_rad, axis=0), basis)
        yield from self._set_noise(density, wave)
        self._remaining = yield from self._solve(std, groups)
        yield
        return blocks.scatter_Nm2 + np.maximum(
            white + wave, np.square(self._remaining).mean(axis=0)
        )

    def _set_noise(self, white_Nm2: Array, wave_Nm2: Array) -> Steps[None]:
        """Set the variances of white noise and waviness per joint, shape (n,)."""
        yield
        wave_rad = self.basis.prior.wave_rad
        sizes = zip(
            white_Nm2.tolist(), wave_Nm2.tolist(), self.blocks.q_rad.T, strict=True
        )
        self._roots = [NoiseRoot(white, wave, q, wave_rad) for white, wave, q in sizes]
        for root in self._roots:
            yield from root.compute()

    def contact_N(self, axis: Array) -> tuple[float, float]:
        """Return the fitted force along an axis, shape (3,), and its deviation [N]."""
        own = slice(len(self.tare.mean), len(self.tare.mean) + 3)
        variance = float(axis @ self._covariance[own, own] @ axis)
        return float(axis @ self._mean[own]), float(np.sqrt(variance))

    def _solve(self, std: Array, groups: dict[str, slice]) -> Steps[Array]:
        """Learn sizes, mean and covariance; return the remaining residual.

        It has the shape (blocks, n); arguments are those of `_fit`.
        """
        residual = self.blocks.residual_Nm
        information = np.zeros((len(std), len(std)))
        evidence = np.zeros(len(std))
        self._whitened = []
        for joint, (own, rows) in enumerate(self._rows):
            values = np.column_stack((rows, residual[:, joint]))
            white = yield from self._roots[joint].whiten(values)
            products = white[:, :-1].T @ white
            information[np.ix_(own, own)] += products[:, :-1]
            evidence[own] += products[:, -1]
            self._whitened.append(white[:, :-1])
            yield
        self.sizes = yield from _likeliest_sizes(information, evidence, std, groups)
        std = _scale_groups(std, groups, self.sizes)
        # In units of the prior: well conditioned.
        units = np.outer(std, std)
        covariance = yield from invert_covariance(
            np.eye(len(std)) + information * units
        )
        mean = covariance @ (std * evidence)
        self._mean = std * self._constrain_hysteresis(mean, covariance)
        self._covariance = covariance * units
        yield
        return np.stack(
            [
                residual[:, joint] - rows @ self._mean[own]
                for joint, (own, rows) in enumerate(self._rows)
            ],
            axis=1,
        )

    def _constrain_hysteresis(self, mean: Array, covariance: Array) -> Array:
        """Return the mean with non-negative sizes of the wide hysteresis loops.

        Mean and covariance are in units of the prior. Torque noise drives the loops,
        too, so least squares can find negative ones, whose output leads: wide ones
        would hide changes of the force. The narrowest removes some of the noise.
        """
        basis = self.basis
        loops = self.basis.groups.get("hysteresis")
        if loops is None or basis.loops == 1:
            return mean
        own = np.arange(loops.start, loops.stop).reshape(basis.loops, basis.joints)
        wide = np.delete(own, np.argmin(basis.prior.hysteresis_widths), axis=0).ravel()
        shared = np.linalg.inv(covariance[np.ix_(wide, wide)])
        root = np.linalg.cholesky(shared).T
        change = nnls(root, root @ mean[wide])[0] - mean[wide]
        return mean + covariance[:, wide] @ (shared @ change)

    def information_on(self, torque: Array) -> Steps[tuple[Array, Array]]:
        """Return information and evidence about causes that were not fitted.

        All fitted parameters are left free. The estimate of a sum of causes is the sum
        of its evidence over that of its information.

        Args:
            torque: Torque of a unit of every such cause [Nm], shape (blocks, n,
                causes).

        Returns:
            Information, shape (causes, causes), and evidence, shape (causes,).
        """
        count = torque.shape[2]
        information = np.zeros((count, count))
        evidence = np.zeros(count)
        shared = np.zeros((len(self._mean), count))
        for joint, (own, _) in enumerate(self._rows):
            values = np.column_stack((torque[:, joint], self._remaining[:, joint]))
            yield
            white = yield from self._roots[joint].whiten(values)
            products = white[:, :-1].T @ white
            information += products[:, :-1]
            evidence += products[:, -1]
            shared[own] += self._whitened[joint].T @ white[:, :-1]
            yield
        return information - shared.T @ self._covariance @ shared, evidence


def _joint_rows_of(basis: BiasModel, blocks: TareBlocks) -> Steps[list[JointRows]]:
    """Return what the causes do to every joint."""
    columns: list[Array] = []
    for k, q in enumerate(blocks.q_rad):
        columns.append(basis.columns(q, blocks.states[k], float(blocks.age_s[k])))
        if k % 8 == 0:
            yield
    joint_rows: list[JointRows] = []
    for joint in range(basis.joints):
        rows = np.array([one[joint] for one in columns])
        causes = np.flatnonzero(rows.any(axis=0))
        joint_rows.append(JointRows(causes, rows[:, causes]))
        yield
    return joint_rows


def _with_contact_and_walk(
    joint: int, causes: JointRows, contact: Array, walk: Array, count: int
) -> JointRows:
    """Return the rows of a joint with those of parameters behind so many causes."""
    forces = contact.shape[2]
    terms = walk.shape[1]
    walks = count + forces + joint * terms + np.arange(terms)
    own = np.concatenate((causes.own, count + np.arange(forces), walks))
    return JointRows(own, np.hstack((causes.rows, contact[:, joint], walk)))


def _walk_columns(age_s: Array, terms: int) -> Array:
    """Return a random walk as a Karhunen-Loeve series, shape (blocks, terms).

    It is zero at the tare's end.
    """
    span_s = max(float(-age_s.min()), 1e-3)
    rate = (np.arange(terms) + 0.5) * np.pi / span_s
    return np.sqrt(2.0 / span_s) / rate * np.sin(-age_s[:, None] * rate)


def _scale_groups(
    std: Array, groups: dict[str, slice], sizes: dict[str, float]
) -> Array:
    """Return prior deviations with every group scaled by its size."""
    std = std.copy()
    for name, columns in groups.items():
        std[columns] *= sizes[name]
    return std


def _likeliest_sizes(
    information: Array, evidence: Array, std: Array, groups: dict[str, slice]
) -> Steps[dict[str, float]]:
    """Return the sizes of the groups that make the data likeliest.

    They are relative to the prior's, by name.
    """

    def log_at(octaves: Octaves) -> float:
        sizes = {name: 2.0**one for name, one in zip(groups, octaves, strict=True)}
        log = _log_likelihood(information, evidence, _scale_groups(std, groups, sizes))
        # The deviation of 1.5 holds sizes that the motion does not show.
        return log - 0.5 * np.square(octaves).sum() / 1.5**2

    grids = [np.arange(-2.0, 5.1)] * len(groups)
    octaves = yield from search_octaves(log_at, (0.0,) * len(groups), grids, sweeps=3)
    return {name: 2.0**one for name, one in zip(groups, octaves, strict=True)}


def search_octaves(
    log_at: Callable[[Octaves], float],
    start: Octaves,
    grids: Sequence[Array],
    *,
    sweeps: int,
) -> Steps[Octaves]:
    """Return the exponents of sizes that are most probable, found one at a time.

    Args:
        log_at: Returns the logarithm of the probability.
        start: Exponents from which the search starts.
        grids: What is tried for each.
        sweeps: Passes over all of them.
    """
    known: dict[Octaves, float] = {}
    best = start
    for _ in range(sweeps):
        for place, grid in enumerate(grids):
            tried = [(*best[:place], float(one), *best[place + 1 :]) for one in grid]
            for octaves in tried:
                if octaves not in known:
                    known[octaves] = log_at(octaves)
                    yield
            best = max(tried, key=lambda octaves: known[octaves])
    return best


def _log_likelihood(information: Array, evidence: Array, std: Array) -> float:
    """Return the log likelihood of data at prior deviations, but for a constant."""
    normal = information * std
    normal *= std[:, None]
    normal.flat[:: len(std) + 1] += 1.0
    root = np.linalg.cholesky(normal)
    whitened = solve_triangular(root, std * evidence, lower=True, check_finite=False)
    return float(0.5 * whitened @ whitened - np.log(root.diagonal()).sum())


def _noise_density(residual: Array, batches: tuple[int, ...]) -> Array:
    """Return the variance per joint of equally strong white noise, shape (n,).

    Equally strong at low frequency, by batch means: averaging several blocks reduces
    noise that outlasts a block less than white noise.
    """
    variances = []
    for size in batches:
        count = len(residual) // size
        if count < MIN_BLOCKS:
            break
        means = residual[: count * size].reshape(count, size, -1).mean(axis=1)
        variances.append(size * np.square(np.diff(means, axis=0)).mean(axis=0) / 2.0)
    return np.max(variances, axis=0)


def _wave_variance(
    remaining: Array, white: Array, travel_rad: Array, basis: BiasModel
) -> Array:
    """Return the variance of the sensors' waviness per joint [Nm^2], shape (n,).

    It is that of the remaining residual beyond the white noise. In a joint that moved
    less than a few wavelengths the fit has taken the wave for a slope: it gets the
    variance of the others, in proportion to range, since an arm's torque sensors are of
    one kind.
    """
    own = np.maximum((remaining**2).mean(axis=0) - white, 0.0)
    has_moved = travel_rad > 4.0 * basis.prior.wave_rad
    if not has_moved.any():
        return own
    per_range = np.mean(own[has_moved] / basis.effort_Nm[has_moved] ** 2)
    return np.maximum(own, per_range * basis.effort_Nm**2)
