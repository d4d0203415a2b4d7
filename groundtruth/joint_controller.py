"""The arm's inner position loop: torque feed-forward and a stiff, mass-weighted PD."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

BANDWIDTH_rad_s = 200.0
"""Natural frequency of the loop, critically damped: stiff enough that the few newtons of a rupture
move the tip by less than 0.1 mm, slow against the 1 kHz tick."""


def joint_torque(
    position_error_rad: Array,
    velocity_error_rad_s: Array,
    mass_matrix: Array,
    feed_forward_Nm: Array,
) -> Array:
    """Torque to hold over the next tick.

    The mass matrix makes all directions of the arm equally fast, whatever its posture. The loop
    reads the true joint state: it runs inside the robot on the fine motor encoders, while the
    noise of an arm level belongs to what the robot's interface reports.

    Args:
        position_error_rad: Wanted minus actual, shape (n,).
        velocity_error_rad_s: Wanted minus actual, shape (n,).
        mass_matrix: Shape (n, n), near the present posture.
        feed_forward_Nm: Torque that the motion itself takes, shape (n,).

    Returns:
        tau = tau_ff + M (w^2 e + 2 w de), shape (n,).
    """
    acceleration = (BANDWIDTH_rad_s * BANDWIDTH_rad_s) * position_error_rad
    acceleration += (2.0 * BANDWIDTH_rad_s) * velocity_error_rad_s
    return feed_forward_Nm + mass_matrix @ acceleration
