"""The Kalman momentum observer: the residual with a variance, its gain set by the noise.

Cf. Wahrburg et al., "Motor-current-based estimation of Cartesian contact forces and torques",
IEEE T-ASE 2018; here joints are taken as uncoupled, which keeps the step a handful of vector
operations.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residual.errors import ConfigurationError, SampleError
from residual.input_validation import (
    check_choice,
    check_interval,
    check_joint_vector,
    check_positive,
)
from residual.joint_friction import FrictionModel
from residual.momentum_observer import ALIGNMENTS, Alignment, MomentumTerms
from urdf import Robot

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class KalmanPosterior:
    """Mean and covariance of (momentum, external torque), one pair per joint; arrays (n,)."""

    momentum: Array  # Mean of p [kg m^2/s]
    external_torque_Nm: Array  # Mean of x [Nm]
    var_momentum: Array  # Variance of p
    covariance: Array  # Covariance of p and x
    var_torque_Nm2: Array  # Variance of x [Nm^2]


def kalman_step(
    last: KalmanPosterior,
    drive_Nm: Array,
    momentum: Array,
    var_momentum: Array,
    noise: tuple[Array, Array],
    dt_s: float,
) -> KalmanPosterior:
    """Predict over one tick and correct with the measured momentum.

    Per joint ``p+ = p + dt (mean(u) + x) + noise`` and ``x+ = x + random walk``; the momentum
    computed from the velocity is the measurement.

    Args:
        last: Before the tick.
        drive_Nm: mean(u) over the tick [Nm], shape (n,).
        momentum: M dq at its end [kg m^2/s], shape (n,).
        var_momentum: Variance of that measurement, shape (n,).
        noise: Standard deviation of one torque sample [Nm] and random walk of the external torque
            [Nm/sqrt(s)], both (n,).
        dt_s: Length of the tick [s].

    Returns:
        Posterior at the end of the tick.
    """
    torque_std, walk_std = noise
    walk = walk_std**2 * dt_s
    mean = last.momentum + dt_s * (drive_Nm + last.external_torque_Nm)
    cross = last.covariance + dt_s * last.var_torque_Nm2 + 0.5 * dt_s * walk
    var_p = (
        last.var_momentum
        + dt_s * (last.covariance + cross)
        + dt_s**2 * (torque_std**2 + walk / 3.0)
        - 0.5 * dt_s**2 * walk
    )
    var_x = last.var_torque_Nm2 + walk
    innovation = momentum - mean
    inverse = 1.0 / (var_p + var_momentum)
    gain_p, gain_x = var_p * inverse, cross * inverse
    return KalmanPosterior(
        momentum=mean + gain_p * innovation,
        external_torque_Nm=last.external_torque_Nm + gain_x * innovation,
        var_momentum=gain_p * var_momentum,
        covariance=gain_x * var_momentum,
        var_torque_Nm2=var_x - gain_x * cross,
    )


class KalmanObserver:
    """External joint torque with its variance, from the same signals as `MomentumObserver`.

    Without velocity noise its steady state is the momentum residual with the gain
    ``K = walk / (torque_noise sqrt(dt))``; with velocity noise it also smooths the momentum.

    Args:
        robot: The arm with its payload.
        torque_noise_Nm: Standard deviation of one torque sample, one or one per joint [Nm].
        velocity_noise_rad_s: The same of velocity [rad/s].
        walk_Nm_per_sqrt_s: Random walk of the external torque [Nm/sqrt(s)].
        alignment: How torque fills a tick.
        friction: Joint friction between torque sensor and link, if any is modelled.
        max_gap_s: Longest time step that is still integrated [s].

    Raises:
        ConfigurationError: For noise that is negative, not finite or of the wrong length, and for
            an alignment or gap that cannot work.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        torque_noise_Nm: float | ArrayLike,
        velocity_noise_rad_s: float | ArrayLike,
        walk_Nm_per_sqrt_s: float | ArrayLike,
        alignment: Alignment = "trapezoid",
        friction: FrictionModel | None = None,
        max_gap_s: float = 0.1,
    ) -> None:
        check_choice("alignment", alignment, ALIGNMENTS)
        check_positive("max_gap_s", max_gap_s)
        self._joints = robot.nv
        self._torque_std = self._vector("torque_noise_Nm", torque_noise_Nm)
        self._velocity_std = self._vector("velocity_noise_rad_s", velocity_noise_rad_s)
        self._walk_std = self._vector("walk_Nm_per_sqrt_s", walk_Nm_per_sqrt_s)
        if not (self._torque_std > 0).all():
            raise ConfigurationError("torque_noise_Nm must be positive: it sets the gain")
        self._terms = MomentumTerms(robot, friction)
        self._held = alignment == "hold"
        self._max_gap_s = max_gap_s
        self.reset()

    def _vector(self, name: str, value: float | ArrayLike) -> Array:
        array = np.asarray(value, dtype=np.float64)
        if array.ndim == 0:
            array = np.full(self._joints, float(array))
        if array.shape != (self._joints,) or not np.isfinite(array).all() or (array < 0).any():
            raise ConfigurationError(
                f"{name} is {value!r}, expected one number >= 0 or {self._joints} of them"
            )
        return array.copy()

    def update(self, q: ArrayLike, dq: ArrayLike, tau: ArrayLike, dt_s: float) -> Array:
        """Take one sample and return the external joint torque [Nm], shape (n,).

        Arguments and errors are those of `MomentumObserver.update`.

        Raises:
            SampleError: For a bad sample; the state is then unchanged.
        """
        q = check_joint_vector("q", q, self._joints)
        dq = check_joint_vector("dq", dq, self._joints)
        tau = check_joint_vector("tau", tau, self._joints)
        inertia, coriolis, gravity = self._terms.at(q, dq)
        momentum, motion = inertia.dot(dq), dq.dot(coriolis) - gravity
        var_momentum = self._terms.momentum_variance(self._velocity_std, q)
        last = self._posterior
        if last is not None:
            dt_s = check_interval(dt_s)
        if last is None or dt_s > self._max_gap_s:
            posterior = self._start(momentum, var_momentum)
        else:
            torque = self._torque if self._held else 0.5 * (self._torque + tau)
            drive = torque + 0.5 * (self._motion + motion)
            noise = (self._torque_std, self._walk_std)
            posterior = kalman_step(last, drive, momentum, var_momentum, noise, dt_s)
        if not np.isfinite(posterior.external_torque_Nm).all():
            raise SampleError("q, dq and tau are finite but the estimate overflows; check units")
        self._posterior, self._motion, self._torque = posterior, motion, tau.copy()
        return self.external_torque_Nm

    def _start(self, momentum: Array, var_momentum: Array) -> KalmanPosterior:
        """At a first sample or after a gap: momentum as measured, torque as last known."""
        zero = np.zeros(self._joints)
        return KalmanPosterior(
            momentum=momentum,
            external_torque_Nm=self.external_torque_Nm,
            var_momentum=var_momentum,
            covariance=zero,
            # Over the first seconds anything within ten steps of the walk's own size is likely.
            var_torque_Nm2=(10.0 * self._walk_std) ** 2,
        )

    @property
    def external_torque_Nm(self) -> Array:
        """Latest estimate [Nm], shape (n,), a copy; zeros before the first sample."""
        last = self._posterior
        return np.zeros(self._joints) if last is None else last.external_torque_Nm.copy()

    @property
    def variance_Nm2(self) -> Array:
        """Variance of the latest estimate [Nm^2], shape (n,); infinite before the first sample."""
        last = self._posterior
        return np.full(self._joints, np.inf) if last is None else last.var_torque_Nm2.copy()

    def reset(self) -> None:
        """Forget everything; the next sample is a first one."""
        self._posterior: KalmanPosterior | None = None
        self._motion = np.zeros(self._joints)
        self._torque = np.zeros(self._joints)
