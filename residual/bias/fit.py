"""Fits a tare to blocks of free motion: Bayesian least squares with sizes that are
learnt.

The prior states how large link errors, friction and drift are on arms of a kind. On one
arm they may be several times smaller or larger: the sizes that make the motion
likeliest are used (empirical Bayes), so that the tare's covariance is that of this arm.
The size of hysteresis is not learnt: in air it is so similar to friction that each
would take half of the other.
"""

from collections.abc import Iterator

import numpy as np
from scipy.optimize import nnls

from residual.bias.model import BiasModel, Tare, TareBlocks
from residual.errors import Array

LEARNT = ("links", "friction", "drift")
"""Groups of columns whose size is learnt, as is the random walk's; offset and ripple
show directly in the data."""
OCTAVES = np.arange(
    -2.0, 5.1
)  # sizes that are tried: powers of two, relative to the prior's
OCTAVES_STD = (
    1.5  # prior deviation of that exponent: holds sizes that the motion does not show
)
SWEEPS = 3  # passes over the groups, one at a time
WALK_TERMS = 8  # of the Karhunen-Loeve series of a random walk: 96 % of its variance
CONTACT_STD_N = 100.0  # prior deviation of a contact's force: practically any
FEW_BLOCKS = 8
"""Least blocks for a variance from their differences: seven give it to two thirds of
itself, fewer may give nearly zero by chance, and the blocks would get too much weight."""
BATCHES = (
    1,
    2,
    4,
)  # blocks averaged to see coloured noise: a filter of 8 Hz outlasts two blocks


class FreeMotionFit:
    """The likeliest causes of the residuals of a free motion.

    Two passes. The first assumes independent noise, as large as between neighbouring
    blocks; what it leaves beyond that is the sensors' waviness, a wave along each
    joint's position that repeats when the joint returns. The second pass includes the
    waves in the noise, so that they do not count as many independent samples of a
    slope.

    Args:
        basis: The causes.
        blocks: The motion.
        contact: Torque per newton of a force that is fitted beside them [Nm/N], shape
            (blocks, n, 3); None if there is none.
        learn: Whether the sizes are learnt; the prior's otherwise.

    Attributes:
        tare: What was found.
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
        touched = columns[:, :, :0] if contact is None else contact
        self._columns = np.concatenate((columns, touched), axis=2)
        residual = blocks.residual_Nm
        is_model = basis.kind == "model"
        is_few = len(residual) < FEW_BLOCKS
        terms = WALK_TERMS if is_model and not is_few else 0
        self._walk = _walk_columns(blocks.age_s, terms)
        walk_std = np.repeat(np.sqrt(basis.walk_Nm2_per_s()), terms)
        groups = {name: basis.groups[name] for name in LEARNT if name in basis.groups}
        std = np.concatenate(
            (basis.std, np.full(touched.shape[2], CONTACT_STD_N), walk_std)
        )
        if terms:
            groups["walk"] = slice(len(std) - len(walk_std), len(std))

        noise_Nm2 = self._fit(
            basis, std, groups if learn and not is_few else {}, is_few
        )
        own = slice(0, len(basis.std))
        self.tare = Tare(
            self._mean[own].copy(),
            self._covariance[own, own].copy(),
            np.diag(noise_Nm2),
            blocks.scatter_Nm2.copy(),
            basis.walk_Nm2_per_s() * self.sizes.get("walk", 1.0) ** 2,
        )
        for array in self.tare:
            array.setflags(write=False)

    def _fit(
        self, basis: BiasModel, std: Array, groups: dict[str, slice], is_few: bool
    ) -> Array:
        """Both passes; returns the variance of a single residual about the fit,
        shape (n,).
        """
        blocks = self.blocks
        residual = self.blocks.residual_Nm
        # With few blocks their differences mean nothing: a block then counts as noisy
        # as a sample.
        least = np.square(basis.prior.resolution_fraction * basis.effort_Nm)
        white = least + (
            blocks.scatter_Nm2 if is_few else _noise_density(residual, (1,))
        )
        self._whiteners = [np.eye(len(residual)) / v for v in white]
        left = self._solve(std, groups)
        density = white if is_few else least + _noise_density(left, BATCHES)
        wave = _wave_variance(left, density, np.ptp(blocks.q_rad, axis=0), basis)
        apart = [(q[:, None] - q) / basis.prior.wave_rad for q in blocks.q_rad.T]
        self._whiteners = [
            np.linalg.inv(d * np.eye(len(left)) + w * np.exp(-0.5 * far**2))
            for d, w, far in zip(density, wave, apart, strict=True)
        ]
        self._left = self._solve(std, groups)
        return blocks.scatter_Nm2 + np.maximum(
            white + wave, np.square(self._left).mean(axis=0)
        )

    def contact_N(self, axis: Array) -> tuple[float, float]:
        """The force that was fitted, along an axis, shape (3,), and its standard
        deviation [N].
        """
        own = slice(len(self.tare.mean), len(self.tare.mean) + 3)
        variance = float(axis @ self._covariance[own, own] @ axis)
        return float(axis @ self._mean[own]), float(np.sqrt(variance))

    def _rows(self) -> Iterator[tuple[int, Array]]:
        """Every joint with its columns over all blocks, the walk's last; shape
        (blocks, m).
        """
        joints = self._columns.shape[1]
        terms = self._walk.shape[1]
        for joint in range(joints):
            walk = np.zeros((len(self._walk), joints * terms))
            walk[:, joint * terms : (joint + 1) * terms] = self._walk
            yield joint, np.hstack((self._columns[:, joint], walk))

    def _solve(self, std: Array, groups: dict[str, slice]) -> Array:
        """Learn the sizes, then mean and covariance; returns what is left, shape
        (blocks, n).
        """
        residual = self.blocks.residual_Nm
        information = np.zeros((len(std), len(std)))
        evidence = np.zeros(len(std))
        for joint, rows in self._rows():
            weighted = self._whiteners[joint] @ rows
            information += rows.T @ weighted
            evidence += weighted.T @ residual[:, joint]
        self.sizes = _likeliest_sizes(information, evidence, std, groups)
        std = _sized(std, groups, self.sizes)
        # In units of the prior: well conditioned.
        units = np.outer(std, std)
        covariance = np.linalg.inv(np.eye(len(std)) + information * units).astype(float)
        mean = covariance @ (std * evidence)
        self._mean = std * self._lagging(mean, covariance)
        self._covariance = covariance * units
        return np.stack(
            [residual[:, k] - rows @ self._mean for k, rows in self._rows()], axis=1
        )

    def _lagging(self, mean: Array, covariance: Array) -> Array:
        """Parameters, in units of the prior, with non-negative sizes of the wide
        hysteresis loops.

        Torque noise drives the loops, too, so least squares can find negative ones,
        whose output leads: wide ones would hide changes of the force. The narrowest
        removes some of the noise.
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
        """Information about causes that were not fitted, with all fitted parameters
        left free.

        From the torque of a unit of every such cause [Nm], shape (blocks, n, causes),
        it returns their information, shape (causes, causes), and evidence, shape
        (causes,). The estimate of a sum of causes is the sum of its evidence over that
        of its information.
        """
        count = torque.shape[2]
        information = np.zeros((count, count))
        evidence = np.zeros(count)
        shared = np.zeros((len(self._mean), count))
        for joint, rows in self._rows():
            weighted = self._whiteners[joint] @ torque[:, joint]
            information += torque[:, joint].T @ weighted
            shared += rows.T @ weighted
            evidence += weighted.T @ self._left[:, joint]
        return information - shared.T @ self._covariance @ shared, evidence


def _walk_columns(age_s: Array, terms: int) -> Array:
    """Random walk as sines of Karhunen and Loeve, zero at the tare's end; shape
    (blocks, terms).
    """
    span_s = max(float(-age_s.min()), 1e-3)
    rate = (np.arange(terms) + 0.5) * np.pi / span_s
    return np.sqrt(2.0 / span_s) / rate * np.sin(-age_s[:, None] * rate)


def _sized(std: Array, groups: dict[str, slice], sizes: dict[str, float]) -> Array:
    std = std.copy()
    for name, columns in groups.items():
        std[columns] *= sizes[name]
    return std


def _likeliest_sizes(
    information: Array, evidence: Array, std: Array, groups: dict[str, slice]
) -> dict[str, float]:
    """Sizes of the groups, relative to their prior, that make the data likeliest."""

    def likelihood(octaves: dict[str, float]) -> float:
        scaled = _sized(std, groups, {name: 2.0**k for name, k in octaves.items()})
        root = np.linalg.cholesky(
            np.eye(len(std)) + information * np.outer(scaled, scaled)
        )
        pull = np.linalg.solve(root, scaled * evidence)
        far = np.square(np.array(list(octaves.values())) / OCTAVES_STD).sum()
        return 0.5 * (pull @ pull - far) - float(np.log(root.diagonal()).sum())

    octaves = dict.fromkeys(groups, 0.0)
    for _ in range(SWEEPS):
        before = dict(octaves)
        for name in groups:
            octaves = max([octaves | {name: float(k)} for k in OCTAVES], key=likelihood)
        if octaves == before:
            break
    return {name: 2.0**k for name, k in octaves.items()}


def _noise_density(residual: Array, batches: tuple[int, ...]) -> Array:
    """Variance per joint of white noise as strong as this noise at low frequency, shape
    (n,).

    Batch means: averaging several blocks reduces noise that outlasts a block less than
    white noise.
    """
    found = []
    for size in batches:
        count = len(residual) // size
        if count < FEW_BLOCKS:
            break
        means = residual[: count * size].reshape(count, size, -1).mean(axis=1)
        found.append(size * np.square(np.diff(means, axis=0)).mean(axis=0) / 2.0)
    return np.max(found, axis=0)


def _wave_variance(
    left: Array, white: Array, travel_rad: Array, basis: BiasModel
) -> Array:
    """Variance of the sensors' waviness per joint [Nm^2], shape (n,).

    It is what the first pass left beyond the white noise. In a joint that moved less
    than a few wavelengths the fit has taken the wave for a slope: it gets the variance
    of the others, in proportion to range, since an arm's torque sensors are of one
    kind.
    """
    own = np.maximum((left**2).mean(axis=0) - white, 0.0)
    moved = travel_rad > 4.0 * basis.prior.wave_rad
    if not moved.any():
        return own
    of_range = np.mean(own[moved] / basis.effort_Nm[moved] ** 2)
    return np.maximum(own, of_range * basis.effort_Nm**2)
