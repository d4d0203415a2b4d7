"""Fits a tare to blocks of free motion: Bayesian least squares with sizes that are learnt.

The prior says how large link errors, friction and drift are on arms of a kind. Of one arm they may
be several times smaller or larger: the sizes that make the motion likeliest are taken (empirical
Bayes), so that the tare's covariance is that of this arm. The size of hysteresis is not learnt: in
air it is so like friction that either would take half of the other.
"""

from collections.abc import Iterator

import numpy as np
from scipy.optimize import nnls

from residual.bias_model import BiasModel, Tare, TareBlocks
from residual.errors import Array

LEARNT = ("links", "friction", "drift")
"""Groups of columns whose size is learnt, and the random walk; offset and ripple are seen
directly."""
OCTAVES = np.arange(-2.0, 5.1)  # sizes that are tried, as powers of two of the prior's
OCTAVES_STD = 1.5  # how far an arm may be from those: keeps what the motion does not show
SWEEPS = 3  # passes over the groups, one at a time
WALK_TERMS = 8  # of the Karhunen-Loeve series of a random walk: 96 % of its variance
CONTACT_STD_N = 100.0  # of a contact's force before data: any
FEW_BLOCKS = 8
"""From seven differences between neighbours a variance is known to two thirds of itself; from fewer
it may be nearly nothing by chance, and a few blocks would count for too much."""
BATCHES = (1, 2, 4)  # blocks averaged to see coloured noise: a filter of 8 Hz outlasts two


class FreeMotionFit:
    """The likeliest causes of the residuals of a free motion.

    Two passes: the first takes the noise seen between neighbouring blocks for independent; what it
    leaves beyond that is the sensors' waviness, a wave along each joint's position that comes back
    when the joint does. The second pass knows of it, so that waves do not pass for many independent
    samples of a slope.

    Args:
        basis: The causes.
        blocks: The motion.
        contact: Torque per newton of a force that is fitted beside them [Nm/N], shape (blocks, n,
            3); None if there is none.
        learn: Whether the sizes are learnt; the prior's otherwise.

    Attributes:
        tare: What was found.
        sizes: Of the groups in `LEARNT` and of the random walk, relative to the prior's.
    """

    def __init__(
        self,
        basis: BiasModel,
        blocks: TareBlocks,
        contact: Array | None = None,
        *,
        learn: bool = True,
    ) -> None:
        self.basis, self.blocks = basis, blocks
        columns = np.stack(list(map(basis.columns, blocks.q_rad, blocks.states, blocks.age_s)))
        touched = columns[:, :, :0] if contact is None else contact
        self._columns = np.concatenate((columns, touched), axis=2)
        residual = blocks.residual_Nm
        is_model, is_few = basis.kind == "model", len(residual) < FEW_BLOCKS
        terms = WALK_TERMS if is_model and not is_few else 0
        self._walk = _walk_columns(blocks.age_s, terms)
        walk_std = np.repeat(np.sqrt(basis.walk_Nm2_per_s()), terms)
        groups = {name: basis.groups[name] for name in LEARNT if name in basis.groups}
        std = np.concatenate((basis.std, np.full(touched.shape[2], CONTACT_STD_N), walk_std))
        if terms:
            groups["walk"] = slice(len(std) - len(walk_std), len(std))

        noise_Nm2 = self._fit(basis, std, groups if learn and not is_few else {}, is_few)
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

    def _fit(self, basis: BiasModel, std: Array, groups: dict[str, slice], is_few: bool) -> Array:
        """Both passes; returns the variance of a single residual about the fit, shape (n,)."""
        blocks, residual = self.blocks, self.blocks.residual_Nm
        # Neighbours of which there are few mean nothing: then a block is as noisy as its samples.
        least = np.square(basis.prior.resolution_fraction * basis.effort_Nm)
        white = least + (blocks.scatter_Nm2 if is_few else _noise_density(residual, (1,)))
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
        return blocks.scatter_Nm2 + np.maximum(white + wave, np.square(self._left).mean(axis=0))

    def contact_N(self, axis: Array) -> tuple[float, float]:
        """The force that was fitted, along an axis, shape (3,), and its standard deviation [N]."""
        own = slice(len(self.tare.mean), len(self.tare.mean) + 3)
        variance = float(axis @ self._covariance[own, own] @ axis)
        return float(axis @ self._mean[own]), float(np.sqrt(variance))

    def _rows(self) -> Iterator[tuple[int, Array]]:
        """Every joint with its columns over all blocks, the walk's last; shape (blocks, m)."""
        joints, terms = self._columns.shape[1], self._walk.shape[1]
        for joint in range(joints):
            walk = np.zeros((len(self._walk), joints * terms))
            walk[:, joint * terms : (joint + 1) * terms] = self._walk
            yield joint, np.hstack((self._columns[:, joint], walk))

    def _solve(self, std: Array, groups: dict[str, slice]) -> Array:
        """Learn the sizes, then mean and covariance; returns what is left, shape (blocks, n)."""
        residual = self.blocks.residual_Nm
        information, evidence = np.zeros((len(std), len(std))), np.zeros(len(std))
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
        self._mean, self._covariance = std * self._lagging(mean, covariance), covariance * units
        return np.stack([residual[:, k] - rows @ self._mean for k, rows in self._rows()], axis=1)

    def _lagging(self, mean: Array, covariance: Array) -> Array:
        """The likeliest parameters with which wide loops of hysteresis lag; in units of the prior.

        Noise of the torque moves the loops, too, so that least squares finds loops that lead: wide
        ones would hide changes of the force. The narrowest takes some of the noise away.
        """
        basis, loops = self.basis, self.basis.groups.get("hysteresis")
        if loops is None or basis.loops == 1:
            return mean
        own = np.arange(loops.start, loops.stop).reshape(basis.loops, basis.joints)
        wide = np.delete(own, np.argmin(basis.prior.hysteresis_widths), axis=0).ravel()
        shared = np.linalg.inv(covariance[np.ix_(wide, wide)])
        root = np.linalg.cholesky(shared).T
        change = nnls(root, root @ mean[wide])[0] - mean[wide]
        return mean + covariance[:, wide] @ (shared @ change)

    def information_on(self, torque: Array) -> tuple[Array, Array]:
        """What the motion says of causes that were not fitted, all that was fitted left free.

        Of the torque of a unit of every such cause [Nm], shape (blocks, n, causes), it makes their
        information, shape (causes, causes), and evidence, shape (causes,): an estimate of a sum of
        causes is the sum of its evidence over that of its information.
        """
        count = torque.shape[2]
        information, evidence = np.zeros((count, count)), np.zeros(count)
        shared = np.zeros((len(self._mean), count))
        for joint, rows in self._rows():
            weighted = self._whiteners[joint] @ torque[:, joint]
            information += torque[:, joint].T @ weighted
            shared += rows.T @ weighted
            evidence += weighted.T @ self._left[:, joint]
        return information - shared.T @ self._covariance @ shared, evidence


def _walk_columns(age_s: Array, terms: int) -> Array:
    """A random walk before the end of the tare, zero there, as a series of sines, (blocks, terms).

    Karhunen and Loeve: with coefficients of unit spread the series has a variance of one per
    second.
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
        root = np.linalg.cholesky(np.eye(len(std)) + information * np.outer(scaled, scaled))
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
    """Variance per joint of white noise as strong as this one is at low frequency, shape (n,).

    Batch means: of noise that outlasts a block the mean of several is less quiet than of white.
    """
    found = []
    for size in batches:
        count = len(residual) // size
        if count < FEW_BLOCKS:
            break
        means = residual[: count * size].reshape(count, size, -1).mean(axis=1)
        found.append(size * np.square(np.diff(means, axis=0)).mean(axis=0) / 2.0)
    return np.max(found, axis=0)


def _wave_variance(left: Array, white: Array, travel_rad: Array, basis: BiasModel) -> Array:
    """Variance of the sensors' waviness per joint [Nm^2], shape (n,).

    What the first pass left beyond the white noise. A joint that moved less than a few wavelengths
    has had its wave fitted away as a slope: it is given what the others have, in proportion to
    range, since an arm's torque sensors are of one kind.
    """
    own = np.maximum((left**2).mean(axis=0) - white, 0.0)
    moved = travel_rad > 4.0 * basis.prior.wave_rad
    if not moved.any():
        return own
    of_range = np.mean(own[moved] / basis.effort_Nm[moved] ** 2)
    return np.maximum(own, of_range * basis.effort_Nm**2)
