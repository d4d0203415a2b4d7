"""Regressions that are judged on what they have not seen: one group left out at a time."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

Array = NDArray[np.float64]


class Seen(NamedTuple):
    """What a regression learns from: n rows of p features.

    Attributes:
        features: Shape (n, p).
        target: Shape (n,).
        group: Rows of one group tell of each other; shape (n,).
    """

    features: Array
    target: Array
    group: NDArray[np.int64]

    def only(self, rows: NDArray[np.bool_]) -> "Seen":
        """Some of the rows."""
        return Seen(self.features[rows], self.target[rows], self.group[rows])


Fit = Callable[[Seen, Array], Array]
"""Takes what to learn from and features (m, p) to predict, gives predictions (m,)."""

PENALTIES = tuple(float(10.0**k) for k in range(-2, 4))
NOISE_LEAST = 1e-3


def left_out(fit: Fit, seen: Seen) -> Array:
    """Prediction of every target by a fit that has not seen its group, shape (n,)."""
    found = np.empty(len(seen.target))
    for each in np.unique(seen.group):
        out = seen.group == each
        found[out] = fit(seen.only(~out), seen.features[out])
    return found


def level(seen: Seen, asked: Array) -> Array:
    """Median of the targets with the same first feature: what knowing nothing else gives."""
    return np.array([np.median(seen.target[seen.features[:, 0] == row[0]]) for row in asked])


def linear(seen: Seen, asked: Array) -> Array:
    """Ordinary least squares."""
    return _ridge(seen, asked, 1e-9)


def ridge(seen: Seen, asked: Array) -> Array:
    """Least squares with a penalty chosen by leaving out one group once more, of what is seen."""
    scores = [
        float(np.sum((left_out(partial(_ridge, penalty=penalty), seen) - seen.target) ** 2))
        for penalty in PENALTIES
    ]
    return _ridge(seen, asked, PENALTIES[int(np.argmin(scores))])


def gaussian_process(seen: Seen, asked: Array) -> Array:
    """Squared-exponential process; size, length and noise of greatest likelihood."""
    known, wanted = _standardised(seen.features, asked)
    target = seen.target
    mean, spread = float(target.mean()), float(target.std()) or 1.0
    values = (target - mean) / spread
    apart = _squared_distance(known, known)

    def surprise(logs: Array) -> float:
        size, length, noise = np.exp(logs)
        covariance = size * np.exp(-0.5 * apart / length) + (noise + NOISE_LEAST) * np.eye(
            len(values)
        )
        factor = cho_factor(covariance, lower=True)
        fit = float(values @ cho_solve(factor, values))
        return 0.5 * fit + float(np.sum(np.log(np.diag(factor[0]))))

    start = np.log([1.0, float(known.shape[1]), 0.5])
    size, length, noise = np.exp(
        minimize(surprise, start, bounds=[(-5.0, 5.0)] * 3, method="L-BFGS-B").x
    )
    covariance = size * np.exp(-0.5 * apart / length) + (noise + NOISE_LEAST) * np.eye(len(values))
    cross = size * np.exp(-0.5 * _squared_distance(wanted, known) / length)
    return mean + spread * np.asarray(cross @ np.linalg.solve(covariance, values))


def _ridge(seen: Seen, asked: Array, penalty: float) -> Array:
    known, wanted = _standardised(seen.features, asked)
    target = seen.target
    normal = known.T @ known + penalty * np.eye(known.shape[1])
    weights = np.linalg.solve(normal, known.T @ (target - target.mean()))
    return np.asarray(target.mean() + wanted @ weights)


def _standardised(features: Array, asked: Array) -> tuple[Array, Array]:
    """Both by mean and deviation of what is seen."""
    mean, spread = features.mean(axis=0), features.std(axis=0) + 1e-12
    return (features - mean) / spread, (asked - mean) / spread


def _squared_distance(a: Array, b: Array) -> Array:
    return np.sum((a[:, None, :] - b[None, :, :]) ** 2, axis=2)
