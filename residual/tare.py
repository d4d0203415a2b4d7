"""Offset removal that lasts: the residual's error without contact, fitted over the free approach.

Section IV of the paper subtracts a constant r_0, which holds near where it was taken only. Here
the error is a linear model of physical causes with a prior on each (`TareBasis`), fitted by
Bayesian least squares over the free motion before contact. It extrapolates along the insertion and
its covariance says how far. The offset is subtracted from the observer's output, never inside its
integral, so that it does not fade.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residual.tare_prior import TareBasis


@dataclass(frozen=True, slots=True, kw_only=True)
class TareBlocks:
    """Means over short blocks of free motion, one row each.

    Attributes:
        q_rad: Positions, shape (m, n).
        direction: Directions of motion, -1 to 1, shape (m, n).
        residual_Nm: Residuals before offset removal, shape (m, n).
        age_s: Time relative to the end of the tare, <= 0, shape (m,).
        scatter_Nm2: Variance of single residuals about their block's mean, shape (n,).
    """

    q_rad: NDArray[np.float64]
    direction: NDArray[np.float64]
    residual_Nm: NDArray[np.float64]
    age_s: NDArray[np.float64]
    scatter_Nm2: NDArray[np.float64]

    def split(self, count: int) -> tuple["TareBlocks", "TareBlocks"]:
        """The first ``count`` blocks and the others."""
        return tuple(
            TareBlocks(
                q_rad=self.q_rad[part],
                direction=self.direction[part],
                residual_Nm=self.residual_Nm[part],
                age_s=self.age_s[part],
                scatter_Nm2=self.scatter_Nm2,
            )
            for part in (slice(None, count), slice(count, None))
        )  # type: ignore[return-value]


@dataclass(frozen=True, slots=True, kw_only=True)
class Tare:
    """A fitted offset.

    Attributes:
        basis: The linear model.
        mean: Its parameters, shape (m,).
        covariance: Of the parameters, shape (m, m).
        noise_Nm2: Covariance of a single residual about the model, shape (n, n).
    """

    basis: TareBasis
    mean: NDArray[np.float64]
    covariance: NDArray[np.float64]
    noise_Nm2: NDArray[np.float64]

    def bias_Nm(
        self, q: NDArray[np.float64], direction: NDArray[np.float64], age_s: float
    ) -> NDArray[np.float64]:
        """Residual without contact at a configuration, direction and age since the tare, (n,)."""
        groups, mean = self.basis.groups, self.mean
        bias = mean[groups["offset"]]
        if "links" not in groups:
            return bias
        return (
            bias
            + self.basis.regressor(q).dot(mean[groups["links"]])
            + direction * mean[groups["reversal"]]
            + age_s * mean[groups["drift"]]
        )

    def covariance_Nm2(
        self, q: NDArray[np.float64], direction: NDArray[np.float64], age_s: float
    ) -> NDArray[np.float64]:
        """Covariance of the residual's error after the tare: noise, model and drift, (n, n)."""
        columns = self.basis.columns(q, direction, age_s)
        model = columns.dot(self.covariance).dot(columns.T)
        walk = np.diag(self.basis.walk_variance(age_s))
        return model + self.noise_Nm2 + walk


def prior_tare(basis: TareBasis) -> Tare:
    """What is known before any free motion was seen: no offset, the prior's covariance."""
    noise = np.diag((1e-3 * basis.effort_Nm) ** 2)
    return Tare(
        basis=basis,
        mean=np.zeros(len(basis.std)),
        covariance=np.diag(basis.std**2),
        noise_Nm2=noise,
    )


def fit_tare(basis: TareBasis, blocks: TareBlocks) -> Tare:
    """Fit the offset over blocks of free motion.

    Two passes: the first takes the noise seen between neighbouring blocks for independent; what it
    leaves beyond that is the sensors' waviness (torque ripple, hysteresis), a wave along each
    joint's position that comes back when the joint does. The second pass knows of it, so that
    waves do not pass for many independent samples of a slope.

    Args:
        basis: The linear model with its prior.
        blocks: What was seen.

    Returns:
        The fitted tare.
    """
    design = np.stack(
        [
            basis.columns(q, direction, age)
            for q, direction, age in zip(blocks.q_rad, blocks.direction, blocks.age_s, strict=True)
        ]
    )
    residual = blocks.residual_Nm
    resolution = basis.resolution_variance()
    white = _neighbour_variance(residual) + resolution
    whiteners = [np.eye(len(residual)) / v for v in white]
    mean, _ = _posterior(design, residual, whiteners, basis.std)
    misfit = residual - design @ mean
    wave = _wave_variance(misfit, white, np.ptp(blocks.q_rad, axis=0), basis)
    if wave.any():
        alike = [_alike(q, basis.prior.wave_rad) for q in blocks.q_rad.T]
        whiteners = [
            np.linalg.inv(v * np.eye(len(residual)) + w * k)
            for v, w, k in zip(white, wave, alike, strict=True)
        ]
    mean, covariance = _posterior(design, residual, whiteners, basis.std)
    return Tare(
        basis=basis,
        mean=mean,
        covariance=covariance,
        noise_Nm2=np.diag(blocks.scatter_Nm2 + white + wave),
    )


def _neighbour_variance(residual: NDArray[np.float64]) -> NDArray[np.float64]:
    """Variance of a block's noise per joint, from the differences of neighbours, shape (n,)."""
    if len(residual) < 2:
        return np.zeros(residual.shape[1])
    return np.square(np.diff(residual, axis=0)).mean(axis=0) / 2.0


def _wave_variance(
    misfit: NDArray[np.float64],
    white: NDArray[np.float64],
    travel_rad: NDArray[np.float64],
    basis: TareBasis,
) -> NDArray[np.float64]:
    """Variance of the sensors' waviness per joint [Nm^2], shape (n,).

    What the first pass left beyond the white noise. A joint that moved less than a few wavelengths
    has had its wave fitted away as a slope: it is given what the others have, in proportion to
    range, since an arm's torque sensors are of one kind.
    """
    own = np.maximum((misfit**2).mean(axis=0) - white, 0.0)
    moved = travel_rad > 4.0 * basis.prior.wave_rad
    if not moved.any():
        return own
    share = np.mean(own[moved] / basis.effort_Nm[moved] ** 2)
    return np.maximum(own, share * basis.effort_Nm**2)


def _alike(position: NDArray[np.float64], length: float) -> NDArray[np.float64]:
    """How much a wave at two positions is the same, 0 to 1, shape (m, m)."""
    distance = (position[:, None] - position) / length
    return np.exp(-0.5 * distance**2)


def _posterior(
    design: NDArray[np.float64],
    residual: NDArray[np.float64],
    whiteners: list[NDArray[np.float64]],
    prior_std: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean and covariance of theta for ``residual = design theta + noise``.

    The noise of joint i has the inverse covariance ``whiteners[i]`` over the blocks. Solved in
    units of the prior, where the information matrix is I plus data: well conditioned.
    """
    information = np.eye(len(prior_std))
    evidence = np.zeros(len(prior_std))
    for joint, whitener in enumerate(whiteners):
        rows = design[:, joint] * prior_std
        weighted = whitener @ rows
        information += rows.T @ weighted
        evidence += weighted.T @ residual[:, joint]
    covariance = np.linalg.inv(information)
    return prior_std * (covariance @ evidence), covariance * np.outer(prior_std, prior_std)
