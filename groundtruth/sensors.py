"""Link-side joint torque as the robot's strain gauges report it."""

import numpy as np
from numpy.typing import NDArray

from groundtruth.plant_model import PlantModel
from urdf import LWR_GEAR_RATIO

Array = NDArray[np.float64]

SECONDS_PER_MINUTE = 60.0


def measured_torque(
    tau_Nm: Array,
    q_rad: Array,
    tick_s: float,
    limit_Nm: Array,
    level: PlantModel,
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


def _signed_uniform(level: PlantModel, rng: np.random.Generator) -> Array:
    """Offset per joint: magnitude uniform, sign by coin."""
    size = rng.uniform(level.torque_bias_min_Nm, level.torque_bias_max_Nm)
    return size * rng.choice((-1.0, 1.0), size.shape)


def _drift_share(
    shape: tuple[int, ...], tick_s: float, level: PlantModel, rng: np.random.Generator
) -> Array:
    """Linear drift and a random walk, from zero, as shares of the limit."""
    minutes = np.arange(shape[0]) * (tick_s / SECONDS_PER_MINUTE)
    rate = level.torque_drift_std_per_min * rng.standard_normal(shape[1])
    step = level.torque_walk_std_per_sqrt_min * np.sqrt(tick_s / SECONDS_PER_MINUTE)
    walk = np.cumsum(step * rng.standard_normal(shape), axis=0)
    return minutes[:, None] * rate + walk - walk[0]


# Joint position and velocity as the robot's interface reports them.


def measured_position(q_rad: Array, level: PlantModel, rng: np.random.Generator) -> Array:
    """Add noise, then round to the encoder's step.

    Args:
        q_rad: True positions, shape (n, 7).
        level: Gives noise and step.
        rng: Source of the noise.
    """
    noisy = q_rad + level.position_noise_std_rad * rng.standard_normal(q_rad.shape)
    step = level.position_step_rad
    return np.round(noisy / step) * step if step > 0.0 else noisy


def measured_velocity(dq_rad_s: Array, level: PlantModel, rng: np.random.Generator) -> Array | None:
    """Add noise; None on an interface that reports no velocity.

    Args:
        dq_rad_s: True velocities, shape (n, 7).
        level: Gives the noise.
        rng: Source of the noise.
    """
    std = level.velocity_noise_std_rad_s
    return None if std is None else dq_rad_s + std * rng.standard_normal(dq_rad_s.shape)


# The reference force/torque sensor at the needle's base: what a good one adds to the truth.


def measured_wrench(
    wrench: Array, tick_s: float, level: PlantModel, rng: np.random.Generator
) -> Array:
    """Add white noise and a linear drift from zero (the sensor was biased without load).

    Args:
        wrench: True reading at every tick, shape (n, 6), N and Nm.
        tick_s: Spacing of the ticks.
        level: Gives noise and drift.
        rng: Source of both.
    """
    minutes = np.arange(len(wrench)) * (tick_s / SECONDS_PER_MINUTE)
    rate = np.array(level.ft_drift_std_per_min) * rng.standard_normal(wrench.shape[1])
    noise = np.array(level.ft_noise_std) * rng.standard_normal(wrench.shape)
    return wrench + minutes[:, None] * rate + noise


# When samples arrive: jittered stamps and losses on the way.


_JITTER_LIMIT = 0.4
"""Largest error of a stamp in ticks; below one half, so that stamps keep their order."""


def stamps(
    true_s: NDArray[np.float64], tick_s: float, level: PlantModel, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Time stamps as written: the true instants with the clock's jitter.

    The samples themselves are taken on the tick; only their stamps are wrong.

    Args:
        true_s: Instants of the samples, shape (n,).
        tick_s: Spacing of the ticks.
        level: Gives the jitter.
        rng: Source of the jitter.
    """
    error = level.clock_jitter_std_s * rng.standard_normal(true_s.shape)
    return true_s + np.clip(error, -_JITTER_LIMIT * tick_s, _JITTER_LIMIT * tick_s)


def received(count: int, level: PlantModel, rng: np.random.Generator) -> NDArray[np.intp]:
    """Which samples arrive; the first and the last always do.

    Args:
        count: Number of samples sent.
        level: Gives how often and how many are lost.
        rng: Source of the losses.

    Returns:
        Their indices, ascending.
    """
    kept = np.ones(count, dtype=bool)
    starts = np.flatnonzero(rng.random(count) < level.drop_probability)
    lengths = rng.integers(1, level.drop_max_samples, len(starts), endpoint=True)
    for start, length in zip(starts, lengths, strict=True):
        kept[start : start + length] = False
    kept[[0, -1]] = True
    return np.flatnonzero(kept)
