"""Fits a tare to blocks of free motion: Bayesian least squares (pure functions)."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from residual.bias_model import BiasModel, Tare, TareBlocks

LINK_SCALES = (0.25, 0.5, 1.0, 2.0)
"""How good the link table may be, against the prior's figure; the motion itself chooses."""

FEW_BLOCKS = 8
"""From seven differences between neighbours a variance is known to two thirds of itself; from fewer
it may be nearly nothing by chance, and a few blocks would be believed too much."""


class _Normal(NamedTuple):
    """Normal equations of ``residual = design theta + noise``."""

    information: NDArray[np.float64]
    evidence: NDArray[np.float64]


def fit_tare(basis: BiasModel, blocks: TareBlocks) -> Tare:
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
            basis.columns(q, trend, age)
            for q, trend, age in zip(blocks.q_rad, blocks.trend, blocks.age_s, strict=True)
        ]
    )
    residual = blocks.residual_Nm
    few = len(residual) < FEW_BLOCKS
    # Neighbours of which there are few tell nothing: then a block is as noisy as its samples.
    white = blocks.scatter_Nm2 if few else _neighbour_variance(residual)
    white = white + basis.resolution_variance()
    whiteners = [np.eye(len(residual)) / v for v in white]
    mean, _ = _posterior(_normal(design, residual, whiteners), basis.std)
    wave = _wave_variance(residual - design @ mean, white, np.ptp(blocks.q_rad, axis=0), basis)
    if wave.any():
        alike = [_alike(q, basis.prior.wave_rad) for q in blocks.q_rad.T]
        whiteners = [
            np.linalg.inv(v * np.eye(len(residual)) + w * k)
            for v, w, k in zip(white, wave, alike, strict=True)
        ]
    normal = _normal(design, residual, whiteners)
    mean, covariance = _posterior(normal, _likeliest_prior(normal, basis))
    return Tare(
        basis=basis,
        mean=mean,
        covariance=covariance,
        noise_Nm2=np.diag(blocks.scatter_Nm2 + white + wave),
    )


def _neighbour_variance(residual: NDArray[np.float64]) -> NDArray[np.float64]:
    """Variance of a block's noise per joint, from the differences of neighbours, shape (n,)."""
    return np.square(np.diff(residual, axis=0)).mean(axis=0) / 2.0


def _wave_variance(
    model_mismatch: NDArray[np.float64],
    white: NDArray[np.float64],
    travel_rad: NDArray[np.float64],
    basis: BiasModel,
) -> NDArray[np.float64]:
    """Variance of the sensors' waviness per joint [Nm^2], shape (n,).

    What the first pass left beyond the white noise. A joint that moved less than a few wavelengths
    has had its wave fitted away as a slope: it is given what the others have, in proportion to
    range, since an arm's torque sensors are of one kind.
    """
    own = np.maximum((model_mismatch**2).mean(axis=0) - white, 0.0)
    moved = travel_rad > 4.0 * basis.prior.wave_rad
    if not moved.any():
        return own
    share = np.mean(own[moved] / basis.effort_Nm[moved] ** 2)
    return np.maximum(own, share * basis.effort_Nm**2)


def _alike(position: NDArray[np.float64], length: float) -> NDArray[np.float64]:
    """How much a wave at two positions is the same, 0 to 1, shape (m, m)."""
    distance = (position[:, None] - position) / length
    return np.exp(-0.5 * distance**2)


def _normal(
    design: NDArray[np.float64], residual: NDArray[np.float64], whiteners: list[NDArray[np.float64]]
) -> _Normal:
    """Normal equations; the noise of joint i has the inverse covariance ``whiteners[i]``."""
    size = design.shape[2]
    information, evidence = np.zeros((size, size)), np.zeros(size)
    for joint, whitener in enumerate(whiteners):
        rows = design[:, joint]
        weighted = whitener @ rows
        information += rows.T @ weighted
        evidence += weighted.T @ residual[:, joint]
    return _Normal(information, evidence)


def _posterior(
    normal: _Normal, prior_std: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean and covariance of theta, solved in units of the prior: well conditioned."""
    covariance = np.linalg.inv(np.eye(len(prior_std)) + _in_units(normal, prior_std))
    mean = prior_std * (covariance @ (prior_std * normal.evidence))
    return mean, covariance * np.outer(prior_std, prior_std)


def _in_units(normal: _Normal, std: NDArray[np.float64]) -> NDArray[np.float64]:
    return normal.information * np.outer(std, std)


def _likeliest_prior(normal: _Normal, basis: BiasModel) -> NDArray[np.float64]:
    """The prior with the scale of link errors that makes the data likeliest (empirical Bayes)."""
    if "links" not in basis.groups:
        return basis.std
    candidates = []
    for scale in LINK_SCALES:
        std = basis.std.copy()
        std[basis.groups["links"]] *= scale
        precision = np.eye(len(std)) + _in_units(normal, std)
        pull = std * normal.evidence
        _, log_volume = np.linalg.slogdet(precision)
        candidates.append((pull @ np.linalg.solve(precision, pull) - log_volume, std))
    return max(candidates, key=lambda candidate: candidate[0])[1]
