"""How disturbances of the force go on: coloured noise, heartbeat, breathing, texture.

Each but the first is a value and its rate, driven by white noise that keeps its
stationary variance.
"""

import math
from typing import NamedTuple

import numpy as np

from foundation.arrays import Matrix
from foundation.jit import compiled_inside

HEARTBEAT_HZ = 1.2
"""Frequency of the heartbeat."""

HEARTBEAT_DAMPING = 0.3
"""Damping ratio of the heartbeat: beats differ."""

BREATHING_HZ = 0.3
"""Frequency of breathing."""

BREATHING_DAMPING = 0.5
"""Damping ratio of breathing: breaths differ more."""

COLOURED_NOISE_S = 0.025
"""Correlation time of a force sensor's noise behind its filter."""


class RandomMotion(NamedTuple):
    """Step of a value and its rate that noise drives.

    Attributes:
        transition: Without the noise, shape (2, 2).
        noise: Covariance that the noise adds, shape (2, 2).
    """

    transition: Matrix
    noise: Matrix


@compiled_inside
def oscillation(duration_s: float, frequency_hz: float, damping: float) -> Matrix:
    """Return the transition of a damped oscillator's deflection and rate, (2, 2)."""
    w = 2.0 * math.pi * frequency_hz
    d = w * math.sqrt(1.0 - damping**2)
    decay = math.exp(-damping * w * duration_s)
    cosine = math.cos(d * duration_s)
    sine = math.sin(d * duration_s)
    return np.array(
        [
            [decay * (cosine + damping * w / d * sine), decay * sine / d],
            [-decay * w * w / d * sine, decay * (cosine - damping * w / d * sine)],
        ]
    )


@compiled_inside
def smooth_walk(travel: float, length: float) -> Matrix:
    """Return the transition of a critically damped value and its slope, (2, 2).

    It is that of a Matern process of order 3/2.
    """
    reach = travel / length
    decay = math.exp(-reach)
    return np.array(
        [
            [decay * (1.0 + reach), decay * travel],
            [-decay * reach / length, decay * (1.0 - reach)],
        ]
    )


@compiled_inside
def driven(transition: Matrix, rate: float, variance: float) -> RandomMotion:
    """Return a step with the noise that keeps its stationary variances.

    Args:
        transition: Of the step, shape (2, 2).
        rate: Ratio of the stationary deviations of rate and value.
        variance: Stationary variance of the value.
    """
    stationary = np.array([variance, variance * rate**2])
    noise = np.diag(stationary)
    for i in range(2):
        for j in range(2):
            for k in range(2):
                noise[i, j] -= transition[i, k] * transition[j, k] * stationary[k]
    return RandomMotion(transition, noise)
