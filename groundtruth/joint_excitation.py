"""Free motion: all joints at once, incommensurate slow sines that start and end at rest."""

import numpy as np
from numpy.typing import NDArray

from groundtruth.joint_reference import JointMotion

# Peak speeds near 0.5 rad/s; no two periods with a small common multiple within a run.
_AMPLITUDE_rad = np.array([0.55, 0.40, 0.50, 0.45, 0.50, 0.45, 0.40])
_FREQUENCY_Hz = np.array([0.11, 0.13, 0.12, 0.14, 0.15, 0.16, 0.18])
_REST_s = 1.0
_FADE_s = 4.0


def joint_excitation(
    centre_rad: NDArray[np.float64], duration_s: float, tick_s: float
) -> JointMotion:
    """Sample the excitation.

    Args:
        centre_rad: Posture around which the joints swing, shape (7,).
        duration_s: Length of the run; a rest of 1 s at both ends is part of it.
        tick_s: Spacing of the ticks.

    Returns:
        The motion, n = duration / tick + 1 samples.
    """
    time = np.arange(round(duration_s / tick_s) + 1, dtype=np.float64) * tick_s
    moving = np.clip(time - _REST_s, 0.0, duration_s - 2.0 * _REST_s)
    fade, fade_rate = _fade(moving, duration_s - 2.0 * _REST_s)
    angle = 2.0 * np.pi * _FREQUENCY_Hz
    sine, cosine = np.sin(moving[:, None] * angle), np.cos(moving[:, None] * angle)
    rate = fade_rate[:, None] * sine + fade[:, None] * angle * cosine
    at_rest = (time <= _REST_s) | (time >= duration_s - _REST_s)
    rate[at_rest] = 0.0
    return JointMotion(
        q_rad=centre_rad + _AMPLITUDE_rad * fade[:, None] * sine, dq_rad_s=_AMPLITUDE_rad * rate
    )


def _fade(
    time: NDArray[np.float64], duration_s: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Quintic fade-in and fade-out between 0 and 1, and its rate."""
    edge = np.minimum(time, duration_s - time)
    x = np.clip(edge / _FADE_s, 0.0, 1.0)
    value = x**3 * (10.0 + x * (6.0 * x - 15.0))
    rate = 30.0 * x**2 * (1.0 - x) ** 2 / _FADE_s
    return value, np.where(time < duration_s / 2.0, rate, -rate)
