"""One stream of samples with joint torques, into external torque."""

from typing import NamedTuple

from numpy.typing import ArrayLike

from residual.external_torque import ExternalTorqueEstimator, ExternalTorqueState, TorqueSample
from residual.guard_state import GuardState
from residual.sample_entry import SampleEntry
from residual.sensor_config import SensorConfig
from urdf import Robot


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
