"""How disturbances of the force go on: coloured noise, heartbeat, breathing, texture.

Each but the first is a value and its rate, driven by white noise that keeps its
stationary variance.
"""

import math
from typing import NamedTuple

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


class Transition(NamedTuple):
    """Linear map of a value and its rate.

    Attributes:
        value_by_value: What the new value takes of the old one.
        value_by_rate: What it takes of the old rate.
        rate_by_value: What the new rate takes of the old value.
        rate_by_rate: What it takes of the old one.
    """

    value_by_value: float
    value_by_rate: float
    rate_by_value: float
    rate_by_rate: float


class RandomMotion(NamedTuple):
    """Step of a value and its rate that noise drives.

    Attributes:
        transition: Without the noise.
        value_variance: Variance that the noise adds to the value.
        covariance: Covariance that it adds to both.
        rate_variance: Variance that it adds to the rate.
    """

    transition: Transition
    value_variance: float
    covariance: float
    rate_variance: float


@compiled_inside
def oscillation(duration_s: float, frequency_hz: float, damping: float) -> Transition:
    """Return the transition of a damped oscillator's deflection and rate."""
    w = 2.0 * math.pi * frequency_hz
    d = w * math.sqrt(1.0 - damping**2)
    decay = math.exp(-damping * w * duration_s)
    cosine = math.cos(d * duration_s)
    sine = math.sin(d * duration_s)
    return Transition(
        decay * (cosine + damping * w / d * sine),
        decay * sine / d,
        -decay * w * w / d * sine,
        decay * (cosine - damping * w / d * sine),
    )


@compiled_inside
def smooth_walk(travel: float, length: float) -> Transition:
    """Return the transition of a critically damped value and its slope (Matern 3/2)."""
    reach = travel / length
    decay = math.exp(-reach)
    slope = -decay * reach / length
    return Transition(
        decay * (1.0 + reach), decay * travel, slope, decay * (1.0 - reach)
    )


@compiled_inside
def driven(transition: Transition, rate: float, variance: float) -> RandomMotion:
    """Return a step with the noise that keeps its stationary variances.

    Args:
        transition: Of the step.
        rate: Ratio of the stationary deviations of rate and value.
        variance: Stationary variance of the value.
    """
    a = transition.value_by_value
    b = transition.value_by_rate
    c = transition.rate_by_value
    d = transition.rate_by_rate
    rate_variance = variance * rate**2
    return RandomMotion(
        transition,
        variance - a * a * variance - b * b * rate_variance,
        -(a * c * variance + b * d * rate_variance),
        rate_variance - c * c * variance - d * d * rate_variance,
    )


@compiled_inside
def heartbeat_step(duration_s: float, variance: float) -> RandomMotion:
    """Return the step of the force by the heartbeat."""
    transition = oscillation(duration_s, HEARTBEAT_HZ, HEARTBEAT_DAMPING)
    return driven(transition, 2.0 * math.pi * HEARTBEAT_HZ, variance)


@compiled_inside
def breathing_step(duration_s: float, variance: float) -> RandomMotion:
    """Return the step of the force by breathing."""
    transition = oscillation(duration_s, BREATHING_HZ, BREATHING_DAMPING)
    return driven(transition, 2.0 * math.pi * BREATHING_HZ, variance)


@compiled_inside
def smooth_walk_step(travel: float, length: float, variance: float) -> RandomMotion:
    """Return the step, over a travel, of an error that lasts for a length."""
    return driven(smooth_walk(travel, length), 1.0 / length, variance)
