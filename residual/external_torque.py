"""Joint signals to external joint torque, whether or not the robot sends velocities."""

from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from residual.config import SensorConfig
from residual.input_validation import ROUNDING_S
from residual.momentum_observer import MomentumObserver, MomentumState
from residual.stuck_signals import NoiseProbe, NoiseState
from residual.velocity_estimator import VelocityEstimator, VelocityState
from urdf import Robot

_new = tuple.__new__  # makes a named tuple in half the time: there is one in every tick


class TorqueSample(NamedTuple):
    """External joint torque with the motion it belongs to.

    Attributes:
        q: Position [rad], shape (n,); delayed like the residual when velocity is estimated.
        dq: Velocity [rad/s], shape (n,), of the same instant.
        tau: Measured torque [Nm], shape (n,), of the same instant; the external torque where the
            robot sends that.
        residual: External joint torque before offset removal [Nm], shape (n,).
        settled: Whether the filters have forgotten their start.
        data: Workspace in which joint placements and Jacobians at q stand; None if in none.
    """

    q: NDArray[np.float64]
    dq: NDArray[np.float64]
    tau: NDArray[np.float64]
    residual: NDArray[np.float64]
    settled: bool
    data: pin.Data | None = None


class ExternalTorqueState(NamedTuple):
    """All that an `ExternalTorqueEstimator` remembers.

    Attributes:
        velocity: Of the velocity estimator; None where the robot sends velocities.
        observer: Of the momentum observer.
        probe: Of the noise probe; None once the noise is known.
        age_s: Time since the filters started [s].
        missed_s: Time that the observer has not seen yet [s].
    """

    velocity: VelocityState | None
    observer: MomentumState
    probe: NoiseState | None
    age_s: float
    missed_s: float


def velocity_estimator(robot: Robot, config: SensorConfig) -> VelocityEstimator:
    """The velocity estimator of a stream without velocities.

    Args:
        robot: The arm.
        config: Settings of the sensor.
    """
    return VelocityEstimator(
        robot.nv,
        config.velocity_bandwidth_per_s,
        alignment=config.alignment,
        max_gap_s=config.max_gap_s,
    )


class ExternalTorqueEstimator:
    """The residual of one stream of samples, all with ``dq`` or all without.

    Args:
        robot: The arm with its payload.
        config: Settings of the sensor.
        has_velocity: Whether the robot sends joint velocities.
    """

    SETTLING_LAGS = 5.0
    """Lags after which the start of the residual has faded to 1 %."""

    def __init__(self, robot: Robot, config: SensorConfig, *, has_velocity: bool) -> None:
        self._velocity = None if has_velocity else velocity_estimator(robot, config)
        self._observer = MomentumObserver(
            robot,
            config.gain_per_s,
            # The matched filter hands on a continuous torque.
            alignment=config.alignment if has_velocity else "trapezoid",
            friction=config.friction,
            max_gap_s=config.max_gap_s,
        )
        self._data = self._observer.data
        self._probe = NoiseProbe(robot.nv) if config.smooth_momentum else None
        self._max_gap_s = config.max_gap_s
        self._settling_s = self.SETTLING_LAGS / config.slowest_gain_per_s - ROUNDING_S
        self._age_s = 0.0
        self._missed_s = 0.0
        self.delay_s = 0.0 if self._velocity is None else self._velocity.delay_s
        """Age of position and velocity of a `TorqueSample` [s]."""
        self.lag_s = 1.0 / config.slowest_gain_per_s + self.delay_s
        """Time by which the estimate follows the torque [s]."""

    def update(
        self,
        q: NDArray[np.float64],
        dq: NDArray[np.float64] | None,
        tau: NDArray[np.float64],
        dt_s: float,
    ) -> TorqueSample:
        """Take one sample that has been checked; see `MomentumObserver.absorb`.

        Args:
            q: Positions [rad], shape (n,): kept, not copied, as the others.
            dq: Velocities [rad/s], shape (n,); None for a stream without.
            tau: Torques [Nm], shape (n,).
            dt_s: Time since the previous sample [s].

        Raises:
            SampleError: For a bad sample; the state is then unchanged.
        """
        if self._velocity is not None:
            return self._update_without_velocity(self._velocity, q, tau, dt_s)
        assert dq is not None, "this stream has velocities"
        residual = self._observer.absorb(q, dq, tau, dt_s)
        self._age_s = 0.0 if dt_s > self._max_gap_s else self._age_s + dt_s
        settled = self._age_s >= self._settling_s
        if self._probe is not None:
            self._learn_noise(dq, q, dt_s)
            settled = self._settled
        return _new(TorqueSample, (q, dq, tau, residual, settled, self._data))

    def _update_without_velocity(
        self,
        velocity: VelocityEstimator,
        q: NDArray[np.float64],
        tau: NDArray[np.float64],
        dt_s: float,
    ) -> TorqueSample:
        position = q
        q, dq, tau, settled = velocity.absorb(position, tau, dt_s)
        self._missed_s += dt_s
        if not settled:
            self._age_s = 0.0
            return TorqueSample(q, dq, tau, self._observer.residual, False)
        residual = self._observer.absorb(q, dq, tau, self._missed_s)
        missed_s, self._missed_s = self._missed_s, 0.0
        self._age_s = 0.0 if missed_s > self._max_gap_s else self._age_s + missed_s
        if self._probe is not None:
            self._learn_noise(position, q, dt_s)
        return _new(TorqueSample, (q, dq, tau, residual, self._settled, self._data))

    def restart_velocity(self) -> None:
        """Start the velocity estimate anew: the position reading is elsewhere now."""
        if self._velocity is not None:
            self._velocity.reset()

    @property
    def state(self) -> ExternalTorqueState:
        """All that the estimator remembers, as copies."""
        return ExternalTorqueState(
            None if self._velocity is None else self._velocity.state,
            self._observer.state,
            None if self._probe is None else self._probe.state,
            self._age_s,
            self._missed_s,
        )

    def restore(self, state: ExternalTorqueState) -> None:
        """Go on from a `state` taken earlier, of a stream with or without velocity as this one."""
        if self._velocity is not None and state.velocity is not None:
            self._velocity.restore(state.velocity)
        self._observer.restore(state.observer)
        if state.probe is None:
            self._probe = None
        else:
            self._probe = NoiseProbe(state.probe.rows.shape[1])
            self._probe.restore(state.probe)
        self._age_s, self._missed_s = state.age_s, state.missed_s

    @property
    def _settled(self) -> bool:
        return self._probe is None and self._age_s >= self._settling_s

    def _learn_noise(
        self, signal: NDArray[np.float64], q: NDArray[np.float64], dt_s: float
    ) -> None:
        """Learn the velocity's noise from the first samples, then quieten the momentum."""
        if self._probe is None:
            return
        noise = self._probe.add(signal, dt_s)
        if noise is not None:
            if self._velocity is not None:
                noise = noise * self._velocity.noise_per_position_noise(dt_s)
            self._observer.smooth_momentum(noise, q)
            self._probe = None
