"""The Kalman momentum observer: the residual with a variance, its gain set by the noise."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residual.errors import ConfigurationError, SampleError
from residual.input_validation import check_alignment, check_gap, check_interval, check_joint_vector
from residual.joint_friction import FrictionModel
from residual.momentum_observer import Alignment, MomentumTerms
from urdf import Robot

# Kalman momentum observer, one step, every joint on its own (pure function).
#
# State per joint: momentum p and external torque x. Over a tick
#
#     p+ = p + dt (mean(u) + x) + noise,      x+ = x + random walk,
#
# and the momentum computed from the velocity is the measurement. Cf. Wahrburg et al.,
# "Motor-current- based estimation of Cartesian contact forces and torques", IEEE T-ASE 2018; here
# joints are taken as uncoupled, which keeps the step a handful of vector operations.


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


class KalmanObserver:
    """External joint torque with its variance, from the same signals as `MomentumObserver`.

    Without velocity noise its steady state is the momentum residual with the gain
    ``K = walk / (torque_noise sqrt(dt))``; with velocity noise it also smooths the momentum.

    Args:
        robot: The arm with its payload.
        torque_noise_Nm: Standard deviation of one torque sample, one or one per joint [Nm].
        velocity_noise_rad_s: The same of velocity [rad/s].
        walk_Nm_per_sqrt_s: How fast the external torque may wander [Nm/sqrt(s)].
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
        check_alignment(alignment)
        check_gap(max_gap_s)
        self._joints = robot.nv
        self._noise = KalmanNoise(
            torque_Nm=self._vector("torque_noise_Nm", torque_noise_Nm),
            velocity_rad_s=self._vector("velocity_noise_rad_s", velocity_noise_rad_s),
            walk_Nm_per_sqrt_s=self._vector("walk_Nm_per_sqrt_s", walk_Nm_per_sqrt_s),
        )
        if not (self._noise.torque_Nm > 0).all():
            raise ConfigurationError("torque_noise_Nm must be positive: it sets the gain")
        self._terms = MomentumTerms(robot, friction)
        self._held = alignment == "hold"
        self._max_gap_s = max_gap_s
        self.reset()

    def _vector(self, name: str, value: float | ArrayLike) -> NDArray[np.float64]:
        array = np.asarray(value, dtype=np.float64)
        if array.ndim == 0:
            array = np.full(self._joints, float(array))
        if array.shape != (self._joints,) or not np.isfinite(array).all() or (array < 0).any():
            raise ConfigurationError(
                f"{name} is {value!r}, expected one number >= 0 or {self._joints} of them"
            )
        return array.copy()

    def update(
        self, q: ArrayLike, dq: ArrayLike, tau: ArrayLike, dt_s: float
    ) -> NDArray[np.float64]:
        """Take one sample and return the external joint torque [Nm], shape (n,).

        Arguments and errors are those of `MomentumObserver.update`.

        Raises:
            SampleError: For a bad sample; the state is then unchanged.
        """
        q = check_joint_vector("q", q, self._joints)
        dq = check_joint_vector("dq", dq, self._joints)
        tau = check_joint_vector("tau", tau, self._joints)
        momentum, coriolis, gravity = (np.empty(self._joints) for _ in range(3))
        self._terms.write(q, dq, momentum, coriolis, gravity)
        motion = coriolis - gravity
        var_momentum = self._terms.momentum_variance(self._noise.velocity_rad_s, q)
        if self._belief is not None:
            dt_s = check_interval(dt_s)
        if self._belief is None or dt_s > self._max_gap_s:
            belief = self._seat(momentum, var_momentum)
        else:
            torque = self._torque if self._held else 0.5 * (self._torque + tau)
            drive = torque + 0.5 * (self._motion + motion)
            belief = kalman_step(self._belief, drive, momentum, var_momentum, self._noise, dt_s)
        if not np.isfinite(belief.external_torque_Nm).all():
            raise SampleError("q, dq and tau are finite but the estimate overflows; check units")
        self._belief, self._motion, self._torque = belief, motion, tau.copy()
        return self.external_torque_Nm

    def _seat(
        self, momentum: NDArray[np.float64], var_momentum: NDArray[np.float64]
    ) -> KalmanBelief:
        """Belief at a first sample or after a gap: momentum as measured, torque as last known."""
        last = self._belief
        zero = np.zeros(self._joints)
        # Over the first seconds anything within ten steps of the walk's own size is likely.
        open_variance = (10.0 * self._noise.walk_Nm_per_sqrt_s) ** 2
        return KalmanBelief(
            momentum=momentum.copy(),
            external_torque_Nm=zero if last is None else last.external_torque_Nm,
            var_momentum=var_momentum,
            covariance=zero,
            var_torque_Nm2=open_variance,
        )

    @property
    def external_torque_Nm(self) -> NDArray[np.float64]:
        """Latest estimate [Nm], shape (n,), a copy; zeros before the first sample."""
        if self._belief is None:
            return np.zeros(self._joints)
        return self._belief.external_torque_Nm.copy()

    @property
    def variance_Nm2(self) -> NDArray[np.float64]:
        """Variance of the latest estimate [Nm^2], shape (n,); infinite before the first sample."""
        if self._belief is None:
            return np.full(self._joints, np.inf)
        return self._belief.var_torque_Nm2.copy()

    def reset(self) -> None:
        """Forget everything; the next sample is a first one."""
        self._belief: KalmanBelief | None = None
        self._motion = np.zeros(self._joints)
        self._torque = np.zeros(self._joints)
