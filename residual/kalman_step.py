"""Kalman momentum observer, one step, every joint on its own (pure function).

State per joint: momentum p and external torque x. Over a tick

    p+ = p + dt (mean(u) + x) + noise,      x+ = x + random walk,

and the momentum computed from the velocity is the measurement. Cf. Wahrburg et al., "Motor-current-
based estimation of Cartesian contact forces and torques", IEEE T-ASE 2018; here joints are taken
as uncoupled, which keeps the step a handful of vector operations.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class KalmanBelief:
    """Mean and covariance of (momentum, external torque), one pair per joint; arrays (n,).

    Attributes:
        momentum: Mean of p [kg m^2/s].
        external_torque_Nm: Mean of x [Nm].
        var_momentum: Variance of p.
        covariance: Covariance of p and x.
        var_torque_Nm2: Variance of x [Nm^2].
    """

    momentum: NDArray[np.float64]
    external_torque_Nm: NDArray[np.float64]
    var_momentum: NDArray[np.float64]
    covariance: NDArray[np.float64]
    var_torque_Nm2: NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class KalmanNoise:
    """What disturbs the observer; arrays (n,).

    Attributes:
        torque_Nm: Standard deviation of one torque sample [Nm].
        velocity_rad_s: Standard deviation of one velocity sample [rad/s].
        walk_Nm_per_sqrt_s: How fast the external torque may wander [Nm/sqrt(s)].
    """

    torque_Nm: NDArray[np.float64]
    velocity_rad_s: NDArray[np.float64]
    walk_Nm_per_sqrt_s: NDArray[np.float64]


def kalman_step(
    belief: KalmanBelief,
    drive_Nm: NDArray[np.float64],
    momentum: NDArray[np.float64],
    var_momentum: NDArray[np.float64],
    noise: KalmanNoise,
    dt_s: float,
) -> KalmanBelief:
    """Predict over one tick and correct with the measured momentum.

    Args:
        belief: Before the tick.
        drive_Nm: mean(u) over the tick [Nm], shape (n,).
        momentum: M dq at its end [kg m^2/s], shape (n,).
        var_momentum: Variance of that measurement, shape (n,).
        noise: Torque noise and random walk.
        dt_s: Length of the tick [s].

    Returns:
        Belief at the end of the tick.
    """
    walk = noise.walk_Nm_per_sqrt_s**2 * dt_s
    mean = belief.momentum + dt_s * (drive_Nm + belief.external_torque_Nm)
    cross = belief.covariance + dt_s * belief.var_torque_Nm2 + 0.5 * dt_s * walk
    var_p = (
        belief.var_momentum
        + dt_s * (belief.covariance + cross)
        + dt_s**2 * (noise.torque_Nm**2 + walk / 3.0)
        - 0.5 * dt_s**2 * walk
    )
    var_x = belief.var_torque_Nm2 + walk
    surprise = momentum - mean
    inverse = 1.0 / (var_p + var_momentum)
    gain_p, gain_x = var_p * inverse, cross * inverse
    return KalmanBelief(
        momentum=mean + gain_p * surprise,
        external_torque_Nm=belief.external_torque_Nm + gain_x * surprise,
        var_momentum=gain_p * var_momentum,
        covariance=gain_x * var_momentum,
        var_torque_Nm2=var_x - gain_x * cross,
    )
