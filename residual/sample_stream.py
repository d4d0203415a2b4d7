"""One stream of samples into external torque: joint torques, or the robot's own estimate of it."""

from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from residual.config import SensorConfig
from residual.errors import SampleError
from residual.fault_detection import FaultDetector, GuardState
from residual.input_validation import ROUNDING_S, check_rows, read_rows
from residual.momentum_observer import MomentumObserver, MomentumState
from residual.stuck_signals import NoiseProbe, NoiseState
from residual.tool_kinematics import ToolKinematics
from residual.velocity_estimator import VelocityEstimator, VelocityState
from urdf import Robot

Array = NDArray[np.float64]
COARSE = 2.0
"""Times the white noise of positions: steps of an encoder last longer than a sample."""
_new = tuple.__new__  # makes a named tuple in half the time: there is one in every tick


class TorqueSample(NamedTuple):
    """External joint torque with the motion of the same instant; arrays (n,)."""

    q: Array  # Position [rad], delayed like the residual when velocity is estimated
    dq: Array  # Velocity [rad/s]
    tau: Array  # Measured torque [Nm]; the external torque where the robot sends that
    residual: Array  # External joint torque before offset removal [Nm]
    settled: bool  # Whether the filters have forgotten their start
    data: pin.Data | None = None  # In which joint placements and Jacobians at q stand


class StreamState(NamedTuple):
    """All that a stream remembers."""

    # Of the velocity estimator; None where the robot sends velocities
    velocity: VelocityState | None
    guard: GuardState | None  # Of the fault detector; None where there is none
    # Of the momentum observer; None in a stream of external torques, as the next
    observer: MomentumState | None = None
    probe: NoiseState | None = None  # Of the noise probe; None once the noise is known
    age_s: float = 0.0  # Time since the filters started [s]
    missed_s: float = 0.0  # Time that the observer has not seen yet [s]


class SampleStream:
    """Positions, velocities if there are any, and torques; all or none with velocities.

    Samples are copied, checked once and judged; then `_estimate` makes external torque of them.
    """

    TORQUE = ""
    """What the caller calls the torque."""
    lag_s = 0.0
    """Time by which the estimate follows the torque [s], where that is known here."""
    filter_lag_s = 0.0
    """The part of it by which the estimate follows the positions that it is reported with [s]."""

    def __init__(self, robot: Robot, config: SensorConfig, *, has_velocity: bool) -> None:
        self.has_velocity = has_velocity
        """Whether samples carry a measured velocity."""
        self._joints, self._model, self._data = robot.nv, robot.model, robot.create_data()
        self._adds_gravity = False
        self._names = ("q", "dq", self.TORQUE) if has_velocity else ("q", self.TORQUE)
        self._velocity = None
        if not has_velocity:
            self._velocity = VelocityEstimator(
                robot.nv,
                config.velocity_bandwidth_per_s,
                alignment=config.alignment,
                max_gap_s=config.max_gap_s,
            )
        self._delay_s = 0.0 if self._velocity is None else self._velocity.delay_s
        self._guard = None
        if config.guard:
            tip = None
            if any(config.tool_offset_m):
                tip = ToolKinematics(robot, config.frame, offset_m=config.tool_offset_m)
            self._guard = FaultDetector(
                robot, has_velocity=has_velocity, velocity_delay_s=self._delay_s, tool=tip
            )

    def update(
        self, q: ArrayLike, dq: ArrayLike | None, torque: ArrayLike, dt_s: float
    ) -> TorqueSample:
        """Take one sample; arguments as of `VirtualForceSensor.update`.

        Raises:
            SampleError: For a wrong shape, numbers that are not finite, or a velocity that comes
                and goes; nothing has then changed but what the fault detector knows of it.
            SuspectSampleError: For a spike, frozen signals or a saturated torque.
        """
        if (dq is None) == self.has_velocity:
            raise SampleError(
                "dq was given before and is missing now, or the reverse; keep to one of the two "
                "for a stream, or reset() first"
            )
        values = (q, torque) if dq is None else (q, dq, torque)
        rows = read_rows(self._names, values, self._joints)
        if self._adds_gravity:
            rows = self._with_gravity(rows)
        now, guard = rows.ravel(), self._guard
        # What is hardly off the last sample needs no other check, nor one of its numbers.
        if guard is None or not guard.surely_passes(now):
            check_rows(self._names, rows)
            has_jumped = guard is not None and guard.check(now, dt_s)
            if has_jumped and self._velocity is not None:
                self._velocity.reset()  # the position reading is elsewhere now
        sample = self._estimate(rows, dt_s)
        if guard is not None:
            guard.accept(now, sample.dq, dt_s)
        return sample

    def _with_gravity(self, rows: Array) -> Array:
        """Samples whose torque leaves gravity out, with it."""
        rows = rows.copy()
        rows[-1] += pin.computeGeneralizedGravity(self._model, self._data, rows[0])
        rows.setflags(write=False)
        return rows

    def _estimate(self, rows: Array, dt_s: float) -> TorqueSample:
        raise NotImplementedError

    @property
    def warning(self) -> str:
        """What seems frozen in samples that are taken all the same; empty if nothing does."""
        return "" if self._guard is None else self._guard.memory.warning

    @property
    def state(self) -> StreamState:
        """All that is remembered, as copies."""
        return StreamState(
            None if self._velocity is None else self._velocity.state,
            None if self._guard is None else self._guard.state,
        )

    def restore(self, state: StreamState) -> None:
        """Go on from a `state` taken earlier, of a stream with or without velocity as this one."""
        if self._velocity is not None and state.velocity is not None:
            self._velocity.restore(state.velocity)
        if self._guard is not None and state.guard is not None:
            self._guard.restore(state.guard)


class JointStream(SampleStream):
    """Measured joint torques; see `SampleStream`."""

    TORQUE = "tau"
    SETTLING_LAGS = 5.0
    """Lags after which the start of the residual has faded to 1 %."""

    def __init__(self, robot: Robot, config: SensorConfig, *, has_velocity: bool) -> None:
        super().__init__(robot, config, has_velocity=has_velocity)
        self._observer = MomentumObserver(
            robot,
            config.gain_per_s,
            # The matched filter hands on a continuous torque.
            alignment=config.alignment if has_velocity else "trapezoid",
            friction=config.friction,
            max_gap_s=config.max_gap_s,
        )
        self._data = self._observer.data
        self._adds_gravity = config.torque_is_gravity_compensated
        self._probe = NoiseProbe(robot.nv) if config.smooth_momentum else None
        self._max_gap_s = config.max_gap_s
        self._settling_s = self.SETTLING_LAGS / config.slowest_gain_per_s - ROUNDING_S
        self._age_s = self._missed_s = 0.0
        self.filter_lag_s = 1.0 / config.slowest_gain_per_s
        self.lag_s = self.filter_lag_s + self._delay_s

    def _estimate(self, rows: Array, dt_s: float) -> TorqueSample:
        last_s = dt_s
        if self._velocity is None:
            q, dq, tau = rows[0], rows[1], rows[2]
        else:
            q, dq, tau, settled = self._velocity.absorb(rows, dt_s)
            self._missed_s += dt_s
            if not settled:
                self._age_s = 0.0
                return TorqueSample(q, dq, tau, self._observer.residual, False)
            dt_s, self._missed_s = self._missed_s, 0.0
        residual = self._observer.absorb(q, dq, tau, dt_s)
        self._age_s = 0.0 if dt_s > self._max_gap_s else self._age_s + dt_s
        probe = self._probe
        if probe is not None:
            signal = rows[1] if self._velocity is None else rows[0]
            self._learn_noise(probe, signal, q, last_s)
        settled = self._age_s >= self._settling_s and self._probe is None
        return _new(TorqueSample, (q, dq, tau, residual, settled, self._data))

    def _learn_noise(self, probe: NoiseProbe, signal: Array, q: Array, dt_s: float) -> None:
        """Learn the velocity's noise from the first samples, then smooth the momentum."""
        noise = probe.add(signal, dt_s)
        if noise is not None:
            if self._velocity is not None:
                # At rest a coarse encoder may show no noise; in motion its steps are not white.
                largest = np.full_like(noise, COARSE * noise.max())
                noise = largest * self._velocity.noise_per_position_noise(dt_s)
            self._observer.smooth_momentum(noise, q)
            self._probe = None

    @property
    def state(self) -> StreamState:
        """All that is remembered, as copies."""
        return super().state._replace(
            observer=self._observer.state,
            probe=None if self._probe is None else self._probe.state,
            age_s=self._age_s,
            missed_s=self._missed_s,
        )

    def restore(self, state: StreamState) -> None:
        """Go on from a `state` taken earlier, of a stream with or without velocity as this one."""
        super().restore(state)
        assert state.observer is not None, "a state of a stream of joint torques"
        self._observer.restore(state.observer)
        self._probe = None if state.probe is None else NoiseProbe.of(state.probe)
        self._age_s, self._missed_s = state.age_s, state.missed_s


class ExternalTorqueStream(SampleStream):
    """External torques that the robot estimates itself; see `SampleStream`.

    Where velocities are estimated, position is as late as they are; the torque stays as it is: how
    late the robot's own estimate is cannot be known here.
    """

    TORQUE = "external_torque"

    def _estimate(self, rows: Array, dt_s: float) -> TorqueSample:
        torque = rows[-1]
        if self._velocity is None:
            return TorqueSample(rows[0], rows[1], torque, torque, True)
        q, dq, _, settled = self._velocity.absorb(rows, dt_s)
        return TorqueSample(q, dq, torque, torque, settled)
