"""Regressions that are judged on what they have not seen: one group left out at a time."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

Array = NDArray[np.float64]
Fit = Callable[[Array, Array, Array], Array]
"""Takes features (n, p) and targets (n,) to learn from and features (m, p) to predict, gives
predictions (m,)."""

PENALTIES = tuple(float(10.0**k) for k in range(-2, 4))
NOISE_LEAST = 1e-3


def left_out(fit: Fit, features: Array, target: Array, group: NDArray[np.int64]) -> Array:
    """Prediction of every target by a fit that has not seen its group, shape (n,)."""
    found = np.empty(len(target))
    for each in np.unique(group):
        out = group == each
        found[out] = fit(features[~out], target[~out], features[out])
    return found


def level(features: Array, target: Array, asked: Array) -> Array:
    """Median of the targets with the same first feature: what knowing nothing else gives."""
    return np.array([np.median(target[features[:, 0] == row[0]]) for row in asked])


def linear(features: Array, target: Array, asked: Array) -> Array:
    """Ordinary least squares."""
    return _ridge(features, target, asked, 1e-9)


def ridge(features: Array, target: Array, asked: Array) -> Array:
    """Least squares with a penalty chosen by leaving one out once more, inside what is seen."""
    scores = []
    for penalty in PENALTIES:
        one_out = [
            _ridge(np.delete(features, k, 0), np.delete(target, k), features[k : k + 1], penalty)
            for k in range(len(target))
        ]
        scores.append(float(np.sum((np.concatenate(one_out) - target) ** 2)))
    return _ridge(features, target, asked, PENALTIES[int(np.argmin(scores))])


def gaussian_process(features: Array, target: Array, asked: Array) -> Array:
    """Squared-exponential process; size, length and noise of greatest likelihood."""
    known, wanted = _standardised(features, asked)
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

    start = np.log([1.0, float(features.shape[1]), 0.5])
    size, length, noise = np.exp(
        minimize(surprise, start, bounds=[(-5.0, 5.0)] * 3, method="L-BFGS-B").x
    )
    covariance = size * np.exp(-0.5 * apart / length) + (noise + NOISE_LEAST) * np.eye(len(values))
    cross = size * np.exp(-0.5 * _squared_distance(wanted, known) / length)
    return mean + spread * np.asarray(cross @ np.linalg.solve(covariance, values))


def _ridge(features: Array, target: Array, asked: Array, penalty: float) -> Array:
    known, wanted = _standardised(features, asked)
    normal = known.T @ known + penalty * np.eye(known.shape[1])
    weights = np.linalg.solve(normal, known.T @ (target - target.mean()))
    return np.asarray(target.mean() + wanted @ weights)


def _standardised(features: Array, asked: Array) -> tuple[Array, Array]:
    """Both by mean and deviation of what is seen."""
    mean, spread = features.mean(axis=0), features.std(axis=0) + 1e-12
    return (features - mean) / spread, (asked - mean) / spread


def _squared_distance(a: Array, b: Array) -> Array:
    return np.sum((a[:, None, :] - b[None, :, :]) ** 2, axis=2)
