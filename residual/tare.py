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
        scatter_Nm2: Covariance of single residuals about their block's mean, shape (n, n).
    """

    q_rad: NDArray[np.float64]
    direction: NDArray[np.float64]
    residual_Nm: NDArray[np.float64]
    age_s: NDArray[np.float64]
    scatter_Nm2: NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Tare:
    """A fitted offset.

    Attributes:
        basis: The linear model.
        mean: Its parameters, shape (m,).
        covariance: Of the parameters, shape (m, m).
        noise_Nm2: Covariance of a single residual about the model, shape (n, n).
        misfit_Nm: What the model left of each block, shape (blocks, n).
    """

    basis: TareBasis
    mean: NDArray[np.float64]
    covariance: NDArray[np.float64]
    noise_Nm2: NDArray[np.float64]
    misfit_Nm: NDArray[np.float64]

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
        misfit_Nm=np.zeros((0, basis.joints)),
    )


def fit_tare(basis: TareBasis, blocks: TareBlocks) -> Tare:
    """Fit the offset over blocks of free motion.

    Two passes: the first with the noise seen between neighbouring blocks, the second with the
    covariance of what the first left, widened by the time over which that stays alike, so that
    slow errors the model does not know (torque ripple) do not pass for many independent samples.

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
    floor = np.diag(blocks.scatter_Nm2.diagonal() * 1e-3 + 1e-12)
    steps = np.diff(blocks.residual_Nm, axis=0)
    noise = np.diag((steps**2).mean(axis=0) / 2.0) if len(steps) else blocks.scatter_Nm2
    mean, _ = _posterior(design, blocks.residual_Nm, noise + floor, basis.std)
    misfit = blocks.residual_Nm - design @ mean
    between = misfit.T @ misfit / len(misfit)
    if len(misfit) > 2 * basis.joints:
        noise = between * _correlated_blocks(misfit)
    mean, covariance = _posterior(design, blocks.residual_Nm, noise + floor, basis.std)
    misfit = blocks.residual_Nm - design @ mean
    return Tare(
        basis=basis,
        mean=mean,
        covariance=covariance,
        noise_Nm2=blocks.scatter_Nm2 + misfit.T @ misfit / len(misfit) + floor,
        misfit_Nm=misfit,
    )


def _posterior(
    design: NDArray[np.float64],
    residual: NDArray[np.float64],
    noise: NDArray[np.float64],
    prior_std: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean and covariance of theta for stacked ``residual = design theta + noise``.

    Solved in units of the prior, where the information matrix is I plus data: well conditioned.
    """
    precision = np.linalg.inv(noise)
    scaled = design * prior_std
    weighted = np.einsum("ij,bjk->bik", precision, scaled)
    information = np.eye(len(prior_std)) + np.einsum("bij,bik->jk", scaled, weighted)
    covariance = np.linalg.inv(information)
    mean = covariance @ np.einsum("bij,bi->j", weighted, residual)
    return prior_std * mean, covariance * np.outer(prior_std, prior_std)


def _correlated_blocks(misfit: NDArray[np.float64]) -> float:
    """Blocks over which a misfit stays alike (integrated autocorrelation), at least 1."""
    size = len(misfit)
    power = (misfit**2).sum()
    if power <= 0.0:
        return 1.0
    total = 1.0
    for lag in range(1, size // 4):
        share = (misfit[lag:] * misfit[:-lag]).sum() / power
        # The first lag without correlation ends the sum: beyond it there is only noise.
        if share <= 0.05:
            break
        total += 2.0 * share
    return total
