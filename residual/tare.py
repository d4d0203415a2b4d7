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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TareBlocks:
    """Means over short blocks of free motion, one row each.

    Attributes:
        q_rad: Positions, shape (m, n).
        trend: Trends of the torques, -1 to 1, shape (m, loops, n), see `residual.torque_trend`.
        residual_Nm: Residuals before offset removal, shape (m, n).
        age_s: Time relative to the end of the tare, <= 0, shape (m,).
        scatter_Nm2: Variance of single residuals about their block's mean, shape (n,).
    """

    q_rad: NDArray[np.float64]
    trend: NDArray[np.float64]
    residual_Nm: NDArray[np.float64]
    age_s: NDArray[np.float64]
    scatter_Nm2: NDArray[np.float64]

    def split(self, count: int) -> tuple["TareBlocks", "TareBlocks"]:
        """The first ``count`` blocks and the others."""
        return tuple(
            TareBlocks(
                q_rad=self.q_rad[part],
                trend=self.trend[part],
                residual_Nm=self.residual_Nm[part],
                age_s=self.age_s[part],
                scatter_Nm2=self.scatter_Nm2,
            )
            for part in (slice(None, count), slice(count, None))
        )  # type: ignore[return-value]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
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

    def __post_init__(self) -> None:
        for array in (self.mean, self.covariance, self.noise_Nm2):
            array.setflags(write=False)

    def bias_Nm(
        self, q: NDArray[np.float64], trend: NDArray[np.float64], age_s: float
    ) -> NDArray[np.float64]:
        """Residual without contact at a configuration, trend and age since the tare, (n,)."""
        groups, mean = self.basis.groups, self.mean
        bias = mean[groups["offset"]]
        if "links" not in groups:
            return bias
        bias = (
            bias
            + self.basis.regressor(q).dot(mean[groups["links"]])
            + (trend * mean[groups["hysteresis"]].reshape(trend.shape)).sum(axis=0)
            + age_s * mean[groups["drift"]]
        )
        if self.basis.ripple_per_rad is not None:
            angle = self.basis.ripple_per_rad * q
            bias += np.sin(angle) * mean[groups["sine"]] + np.cos(angle) * mean[groups["cosine"]]
        return bias

    def covariance_Nm2(
        self, q: NDArray[np.float64], trend: NDArray[np.float64], age_s: float
    ) -> NDArray[np.float64]:
        """Covariance of the residual's error after the tare: noise, model and drift, (n, n)."""
        columns = self.basis.columns(q, trend, age_s)
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
