"""The reference force/torque sensor at the needle's base: what a good one adds to the truth."""

import numpy as np
from numpy.typing import NDArray

from groundtruth.arm_level import ArmLevel
from groundtruth.torque_sensor import SECONDS_PER_MINUTE

Array = NDArray[np.float64]


def measured_wrench(
    wrench: Array, tick_s: float, level: ArmLevel, rng: np.random.Generator
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
