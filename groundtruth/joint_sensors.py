"""Joint position and velocity as the robot's interface reports them."""

import numpy as np
from numpy.typing import NDArray

from groundtruth.arm_level import ArmLevel

Array = NDArray[np.float64]


def measured_position(q_rad: Array, level: ArmLevel, rng: np.random.Generator) -> Array:
    """Add noise, then round to the encoder's step.

    Args:
        q_rad: True positions, shape (n, 7).
        level: Gives noise and step.
        rng: Source of the noise.
    """
    noisy = q_rad + level.position_noise_std_rad * rng.standard_normal(q_rad.shape)
    step = level.position_step_rad
    return np.round(noisy / step) * step if step > 0.0 else noisy


def measured_velocity(dq_rad_s: Array, level: ArmLevel, rng: np.random.Generator) -> Array | None:
    """Add noise; None on an interface that reports no velocity.

    Args:
        dq_rad_s: True velocities, shape (n, 7).
        level: Gives the noise.
        rng: Source of the noise.
    """
    std = level.velocity_noise_std_rad_s
    return None if std is None else dq_rad_s + std * rng.standard_normal(dq_rad_s.shape)
