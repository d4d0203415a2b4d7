"""Fits a tare to free motion: Bayesian least squares with learnt prior sizes.

The prior states how large link errors, friction and drift are on arms of a kind. On one
arm they may be several times smaller or larger: the sizes that make the motion
likeliest are used (empirical Bayes), so that the tare's covariance is that of this arm.
The size of hysteresis is not learnt: in air it is so similar to friction that each
would take half of the other.
"""

from collections.abc import Iterator

import numpy as np
from scipy.optimize import nnls

from foundation.arrays import Array
from residual.bias.model import BiasModel, Tare, TareBlocks

LEARNT = ("links", "friction", "drift")
"""Groups of columns whose size is learnt, as is the random walk's; offset and ripple
show directly in the data."""

OCTAVES = np.arange(-2.0, 5.1)
"""Exponents of the sizes that are tried: powers of two, relative to the prior's."""

OCTAVES_STD = 1.5
"""Prior deviation of that exponent: it holds sizes that the motion does not show."""

MAX_SWEEPS = 3
"""Passes over the groups, one at a time."""

WALK_TERMS = 8
"""Terms of the Karhunen-Loeve series of a random walk: 96 % of its variance."""

MIN_WALK_S = 1e-3
"""Shortest motion for which a random walk is fitted."""

CONTACT_STD_N = 100.0
"""Prior deviation of a contact's force: practically any."""

MIN_BLOCKS = 8
"""Fewest blocks for a variance from their differences: seven give it to two thirds of
itself, fewer may give nearly zero by chance, and the blocks would get too much
weight."""

BATCHES = (1, 2, 4)
"""Numbers of blocks that are averaged to see coloured noise: a filter of 8 Hz outlasts
two blocks."""

MIN_WAVELENGTHS = 4.0
"""Travel of a joint, in correlation lengths of the waviness, in which the fit does not
take a wave for a slope."""


class FreeMotionFit:
    """The likeliest causes of the residuals of a free motion.

    Two passes. The first assumes independent noise, as large as between neighbouring
    blocks; what it leaves beyond that is the sensors' waviness, a wave along each
    joint's position that repeats when the joint returns. The second pass includes the
    waves in the noise, so that they do not count as many independent samples of a
    slope.

    Args:
        basis: Model of the causes.
        blocks: The motion.
        contact: Torque per newton of a force that is fitted beside them [Nm/N], shape
            (blocks, n, 3); None if there is none.
        learn: Whether the sizes are learnt; the prior's otherwise.

    Attributes:
        basis: As given.
        blocks: As given.
        tare: The fitted offset.
        sizes: Of the groups in `LEARNT` and of the random walk, relative to the
            prior's.
    """

    def __init__(
        self,
        basis: BiasModel,
        blocks: TareBlocks,
        contact: Array | None = None,
        *,
        learn: bool = True,
    ) -> None:
        self.basis = basis
        self.blocks = blocks
        columns = np.stack(
            list(map(basis.columns, blocks.q_rad, blocks.states, blocks.age_s))
        )
        contact_columns = columns[:, :, :0] if contact is None else contact
        self._columns = np.concatenate((columns, contact_columns), axis=2)
        self._has_few_blocks = len(blocks.residual_Nm) < MIN_BLOCKS
        has_walk = basis.kind == "model" and not self._has_few_blocks
        terms = WALK_TERMS if has_walk else 0
        self._walk = _walk_columns(blocks.age_s, terms)
        walk_std = np.repeat(np.sqrt(basis.walk_Nm2_per_s()), terms)
        contact_std = np.full(contact_columns.shape[2], CONTACT_STD_N)
        std = np.concatenate((basis.std, contact_std, walk_std))
        groups: dict[str, slice] = {}
        if learn and not self._has_few_blocks:
            groups = {
                name: basis.groups[name] for name in LEARNT if name in basis.groups
            }
            if has_walk:
                groups["walk"] = slice(len(std) - len(walk_std), len(std))
        noise_Nm2 = self._fit(std, groups)
        own = slice(0, len(basis.std))
        self.tare = Tare(
            mean=self._mean[own].copy(),
            covariance=self._covariance[own, own].copy(),
            noise_Nm2=np.diag(noise_Nm2),
            scatter_Nm2=blocks.scatter_Nm2.copy(),
            walk_Nm2_per_s=basis.walk_Nm2_per_s() * self.sizes.get("walk", 1.0) ** 2,
        )
        for array in self.tare:
            if isinstance(array, np.ndarray):
                array.setflags(write=False)

    def _fit(self, std: Array, groups: dict[str, slice]) -> Array:
        """Do both passes; return the variance of a residual about the fit, shape (n,).

        Args:
            std: Prior deviation of every parameter, shape (m,).
            groups: Parameters whose sizes are learnt, by their cause.
        """
        basis = self.basis
        blocks = self.blocks
        count = len(blocks.residual_Nm)
        is_few = self._has_few_blocks
        # With few blocks their differences mean nothing: a block then counts as noisy
        # as a sample.
        resolution = np.square(basis.prior.resolution_fraction * basis.effort_Nm)
        white = resolution + (
            blocks.scatter_Nm2 if is_few else _noise_density(blocks.residual_Nm, (1,))
        )
        self._whiteners = [np.eye(count) / variance for variance in white]
        remaining = self._solve(std, groups)
        density = white if is_few else resolution + _noise_density(remaining, BATCHES)
        wave = _wave_variance(remaining, density, np.ptp(blocks.q_rad, axis=0), basis)
        self._whiteners = [
            np.linalg.inv(
                white_variance * np.eye(count)
                + wave_variance * _wave_correlation(q, basis.prior.wave_rad)
            )
            for white_variance, wave_variance, q in zip(
                density, wave, blocks.q_rad.T, strict=True
            )
        ]
        self._remaining = self._solve(std, groups)
        return blocks.scatter_Nm2 + np.maximum(
            white + wave, np.square(self._remaining).mean(axis=0)
        )

    def contact_N(self, axis: Array) -> tuple[float, float]:
        """Return the fitted force along an axis, shape (3,), and its deviation [N]."""
        own = slice(len(self.tare.mean), len(self.tare.mean) + 3)
        variance = float(axis @ self._covariance[own, own] @ axis)
        return float(axis @ self._mean[own]), float(np.sqrt(variance))

    def _rows(self) -> Iterator[tuple[int, Array]]:
        """Yield every joint with its columns over all blocks, shape (blocks, m).

        The walk's columns come last.
        """
        joints = self._columns.shape[1]
        terms = self._walk.shape[1]
        for joint in range(joints):
            walk = np.zeros((len(self._walk), joints * terms))
            walk[:, joint * terms : (joint + 1) * terms] = self._walk
            yield joint, np.hstack((self._columns[:, joint], walk))

    def _solve(self, std: Array, groups: dict[str, slice]) -> Array:
        """Learn sizes, mean and covariance; return the remaining residual.

        It has the shape (blocks, n); arguments are those of `_fit`.
        """
        residual = self.blocks.residual_Nm
        information = np.zeros((len(std), len(std)))
        evidence = np.zeros(len(std))
        for joint, rows in self._rows():
            weighted = self._whiteners[joint] @ rows
            information += rows.T @ weighted
            evidence += weighted.T @ residual[:, joint]
        self.sizes = _likeliest_sizes(information, evidence, std, groups)
        std = _scale_groups(std, groups, self.sizes)
        # In units of the prior: well conditioned.
        units = np.outer(std, std)
        covariance = np.linalg.inv(np.eye(len(std)) + information * units).astype(float)
        mean = covariance @ (std * evidence)
        self._mean = std * self._constrain_hysteresis(mean, covariance)
        self._covariance = covariance * units
        return np.stack(
            [residual[:, k] - rows @ self._mean for k, rows in self._rows()], axis=1
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

    def information_on(self, torque: Array) -> tuple[Array, Array]:
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
        for joint, rows in self._rows():
            weighted = self._whiteners[joint] @ torque[:, joint]
            information += torque[:, joint].T @ weighted
            shared += rows.T @ weighted
            evidence += weighted.T @ self._remaining[:, joint]
        return information - shared.T @ self._covariance @ shared, evidence


def _walk_columns(age_s: Array, terms: int) -> Array:
    """Return a random walk as a Karhunen-Loeve series, shape (blocks, terms).

    It is zero at the tare's end.
    """
    span_s = max(float(-age_s.min()), MIN_WALK_S)
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
) -> dict[str, float]:
    """Return the sizes of the groups that make the data likeliest.

    They are relative to the prior's, by name.
    """

    def log_likelihood(octaves: dict[str, float]) -> float:
        scaled = _scale_groups(std, groups, _sizes_of(octaves))
        root = np.linalg.cholesky(
            np.eye(len(std)) + information * np.outer(scaled, scaled)
        )
        whitened = np.linalg.solve(root, scaled * evidence)
        deviations = np.array(list(octaves.values())) / OCTAVES_STD
        log_determinant = float(np.log(root.diagonal()).sum())
        squares = whitened @ whitened - np.square(deviations).sum()
        return 0.5 * squares - log_determinant

    octaves = dict.fromkeys(groups, 0.0)
    for _ in range(MAX_SWEEPS):
        octaves_before = dict(octaves)
        for name in groups:
            candidates = [octaves | {name: float(octave)} for octave in OCTAVES]
            octaves = max(candidates, key=log_likelihood)
        if octaves == octaves_before:
            break
    return _sizes_of(octaves)


def _sizes_of(octaves: dict[str, float]) -> dict[str, float]:
    return {name: 2.0**octave for name, octave in octaves.items()}


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


def _wave_correlation(q: Array, wave_rad: float) -> Array:
    """Return the correlation of a joint's waviness, shape (blocks, blocks).

    It falls with the distance of the joint's positions [rad], shape (blocks,).
    """
    distance = (q[:, None] - q) / wave_rad
    return np.exp(-0.5 * distance**2)


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
    has_moved = travel_rad > MIN_WAVELENGTHS * basis.prior.wave_rad
    if not has_moved.any():
        return own
    per_range = np.mean(own[has_moved] / basis.effort_Nm[has_moved] ** 2)
    return np.maximum(own, per_range * basis.effort_Nm**2)
