"""One stream of samples with joint torques, into external torque."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residual.config import SensorConfig
from residual.errors import SampleError
from residual.external_torque import (
    ExternalTorqueEstimator,
    ExternalTorqueState,
    TorqueSample,
    velocity_estimator,
)
from residual.fault_detection import FaultDetector, GuardState
from residual.input_validation import check_rows, read_rows
from residual.velocity_estimator import VelocityState
from urdf import Robot

# Where the samples of a stream come in: copied, checked once, and judged.


class SampleEntry:
    """Reads positions, velocities if there are any, and torques; all or none with velocities.

    Args:
        robot: The arm.
        config: Settings of the sensor.
        has_velocity: Whether samples carry a velocity.
        torque_name: What the caller calls the torque.
        velocity_delay_s: Age of the velocity that `accept` is told [s].
    """

    def __init__(
        self,
        robot: Robot,
        config: SensorConfig,
        *,
        has_velocity: bool,
        torque_name: str,
        velocity_delay_s: float,
    ) -> None:
        self._joints, self._has_velocity = robot.nv, has_velocity
        self._names = ("q", "dq", torque_name) if has_velocity else ("q", torque_name)
        self._guard = (
            FaultDetector(robot, has_velocity=has_velocity, velocity_delay_s=velocity_delay_s)
            if config.guard
            else None
        )
        self._read = np.zeros(0)

    def read(
        self, q: ArrayLike, dq: ArrayLike | None, torque: ArrayLike, dt_s: float
    ) -> tuple[NDArray[np.float64], bool]:
        """Read a sample; nothing changes before `accept` but what the guard knows of spikes.

        Args:
            q: Positions [rad], shape (n,).
            dq: Velocities [rad/s], shape (n,), or None.
            torque: Torques [Nm], shape (n,).
            dt_s: Time since the last accepted sample [s].

        Returns:
            The signals, one a row, torque last, as a read-only copy of shape (2, n) or (3, n); and
            whether the position has jumped, and stayed there.

        Raises:
            SampleError: For a wrong shape, numbers that are not finite, or a velocity that comes
                and goes.
            SuspectSampleError: For a spike, frozen signals or a saturated torque.
        """
        if (dq is None) == self._has_velocity:
            raise SampleError(
                "dq was given before and is missing now, or the reverse; keep to one of the two "
                "for a stream, or reset() first"
            )
        values = (q, torque) if dq is None else (q, dq, torque)
        rows = read_rows(self._names, values, self._joints)
        now, guard = rows.ravel(), self._guard
        if guard is None:
            check_rows(self._names, rows)
            return rows, False
        self._read = now
        # What is hardly off the last sample needs no other look, nor a check of its numbers.
        if guard.surely_passes(now):
            return rows, False
        check_rows(self._names, rows)
        return rows, guard.check(now, dt_s)

    def accept(self, velocity: NDArray[np.float64], dt_s: float) -> None:
        """The sample last read has been absorbed; see `FaultDetector.accept`."""
        if self._guard is not None:
            self._guard.accept(self._read, velocity, dt_s)

    @property
    def warning(self) -> str:
        """What seems frozen in samples that are accepted all the same; empty if nothing does."""
        return "" if self._guard is None else self._guard.warning

    @property
    def state(self) -> GuardState | None:
        """All that is remembered; None without a guard."""
        return None if self._guard is None else self._guard.state

    def restore(self, state: GuardState | None) -> None:
        """Go on from a `state` taken earlier with the same settings."""
        if self._guard is not None and state is not None:
            self._guard.restore(state)


class JointStreamState(NamedTuple):
    """All that a `JointStream` remembers.

    Attributes:
        torque: Of the external torque.
        guard: Of the sample guard; None where there is none.
    """

    torque: ExternalTorqueState
    guard: GuardState | None


class JointStream:
    """Positions, velocities if there are any, and torques, into external torque.

    Args:
        robot: The arm with its payload.
        config: Settings of the sensor.
        has_velocity: Whether the robot sends joint velocities.
    """

    def __init__(self, robot: Robot, config: SensorConfig, *, has_velocity: bool) -> None:
        self._torque = ExternalTorqueEstimator(robot, config, has_velocity=has_velocity)
        self._entry = SampleEntry(
            robot,
            config,
            has_velocity=has_velocity,
            torque_name="tau",
            velocity_delay_s=self._torque.delay_s,
        )
        self.has_velocity = has_velocity
        """Whether samples carry a measured velocity."""
        self.lag_s = self._torque.lag_s
        """Time by which the estimate follows the torque [s]."""

    def update(
        self, q: ArrayLike, dq: ArrayLike | None, tau: ArrayLike, dt_s: float
    ) -> TorqueSample:
        """Take one sample; see `VirtualForceSensor.update`.

        Raises:
            SampleError: For a bad sample; nothing has then changed but what the guard knows of it.
        """
        rows, has_jumped = self._entry.read(q, dq, tau, dt_s)
        if has_jumped:
            self._torque.restart_velocity()
        velocity = rows[1] if self.has_velocity else None
        sample = self._torque.update(rows[0], velocity, rows[-1], dt_s)
        self._entry.accept(sample.dq, dt_s)
        return sample

    @property
    def warning(self) -> str:
        """What seems frozen in samples that are taken all the same; empty if nothing does."""
        return self._entry.warning

    @property
    def state(self) -> JointStreamState:
        """All that is remembered, as copies."""
        return JointStreamState(self._torque.state, self._entry.state)

    def restore(self, state: JointStreamState) -> None:
        """Go on from a `state` taken earlier, of a stream with or without velocity as this one."""
        self._torque.restore(state.torque)
        self._entry.restore(state.guard)


# One stream of samples with the external torque that the robot estimates itself.


class ExternalTorqueStreamState(NamedTuple):
    """All that an `ExternalTorqueStream` remembers.

    Attributes:
        velocity: Of the velocity estimator; None where the robot sends velocities.
        guard: Of the sample guard; None where there is none.
    """

    velocity: VelocityState | None
    guard: GuardState | None


class ExternalTorqueStream:
    """Positions, velocities if there are any, and external torques.

    Where velocities are estimated, position is as late as they are; the torque stays as it is: how
    late the robot's own estimate is cannot be known here.

    Args:
        robot: The arm.
        config: Settings of the sensor.
        has_velocity: Whether the robot sends joint velocities.
    """

    lag_s = 0.0
    """Whatever lag the robot's estimate has is not known here."""

    def __init__(self, robot: Robot, config: SensorConfig, *, has_velocity: bool) -> None:
        self._velocity = None if has_velocity else velocity_estimator(robot, config)
        self._entry = SampleEntry(
            robot,
            config,
            has_velocity=has_velocity,
            torque_name="external_torque",
            velocity_delay_s=0.0 if self._velocity is None else self._velocity.delay_s,
        )
        self.has_velocity = has_velocity
        """Whether samples carry a measured velocity."""

    def update(
        self, q: ArrayLike, dq: ArrayLike | None, external_torque: ArrayLike, dt_s: float
    ) -> TorqueSample:
        """Take one sample; see `VirtualForceSensor.update_external_torque`.

        Raises:
            SampleError: For a bad sample; nothing has then changed but what the guard knows of it.
        """
        rows, has_jumped = self._entry.read(q, dq, external_torque, dt_s)
        position, torque = rows[0], rows[-1]
        if self._velocity is None:
            velocity, settled = rows[1], True
        else:
            if has_jumped:
                self._velocity.reset()
            position, velocity, _, settled = self._velocity.absorb(position, torque, dt_s)
        self._entry.accept(velocity, dt_s)
        return TorqueSample(position, velocity, torque, torque, settled)

    @property
    def warning(self) -> str:
        """What seems frozen in samples that are taken all the same; empty if nothing does."""
        return self._entry.warning

    @property
    def state(self) -> ExternalTorqueStreamState:
        """All that is remembered, as copies."""
        velocity = None if self._velocity is None else self._velocity.state
        return ExternalTorqueStreamState(velocity, self._entry.state)

    def restore(self, state: ExternalTorqueStreamState) -> None:
        """Go on from a `state` taken earlier, of a stream with or without velocity as this one."""
        if self._velocity is not None and state.velocity is not None:
            self._velocity.restore(state.velocity)
        self._entry.restore(state.guard)
