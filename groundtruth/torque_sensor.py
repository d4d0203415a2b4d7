"""Link-side joint torque as the robot's strain gauges report it."""

import numpy as np
from numpy.typing import NDArray

from groundtruth.arm_level import ArmLevel
from urdf import LWR_GEAR_RATIO

Array = NDArray[np.float64]

SECONDS_PER_MINUTE = 60.0


def measured_torque(
    tau_Nm: Array,
    q_rad: Array,
    tick_s: float,
    limit_Nm: Array,
    level: ArmLevel,
    rng: np.random.Generator,
) -> Array:
    """Pass true torques through the sensor: hysteresis, ripple, offset, drift, noise.

    Args:
        tau_Nm: True torques at every tick, shape (n, 7).
        q_rad: True positions, shape (n, 7).
        tick_s: Spacing of the ticks.
        limit_Nm: Effort limits, shape (7,); ranges of the sensors.
        level: How large each fault is.
        rng: Source of everything drawn.

    Returns:
        Shape (n, 7).
    """
    shape = tau_Nm.shape
    bias = _signed_uniform(level, rng)
    phase = rng.uniform(0.0, 2.0 * np.pi, shape[1])
    drift = limit_Nm * _drift_share(shape, tick_s, level, rng)
    noise = np.array(level.torque_noise_std_Nm) * rng.standard_normal(shape)
    seen = tau_Nm
    if level.torque_hysteresis > 0.0:
        seen = play(tau_Nm, level.torque_hysteresis * limit_Nm)
    if level.torque_ripple > 0.0:
        angle = 2.0 * np.array(LWR_GEAR_RATIO) * q_rad + phase
        seen = seen + level.torque_ripple * limit_Nm * np.sin(angle)
    return seen + bias + drift + noise


def play(signal: Array, half_width: Array) -> Array:
    """Backlash: the output rests until the input has moved by the half-width, then follows.

    Args:
        signal: Shape (n, k).
        half_width: Shape (k,).

    Returns:
        Shape (n, k), within the half-width of the signal; starts on it.
    """
    low, high = signal - half_width, signal + half_width
    out = np.empty_like(signal)
    held = signal[0]
    for row, (below, above) in enumerate(zip(low, high, strict=True)):
        held = np.minimum(np.maximum(held, below), above)
        out[row] = held
    return out


def _signed_uniform(level: ArmLevel, rng: np.random.Generator) -> Array:
    """Offset per joint: magnitude uniform, sign by coin."""
    size = rng.uniform(level.torque_bias_min_Nm, level.torque_bias_max_Nm)
    return size * rng.choice((-1.0, 1.0), size.shape)


def _drift_share(
    shape: tuple[int, ...], tick_s: float, level: ArmLevel, rng: np.random.Generator
) -> Array:
    """Linear drift and a random walk, from zero, as shares of the limit."""
    minutes = np.arange(shape[0]) * (tick_s / SECONDS_PER_MINUTE)
    rate = level.torque_drift_std_per_min * rng.standard_normal(shape[1])
    step = level.torque_walk_std_per_sqrt_min * np.sqrt(tick_s / SECONDS_PER_MINUTE)
    walk = np.cumsum(step * rng.standard_normal(shape), axis=0)
    return minutes[:, None] * rate + walk - walk[0]
