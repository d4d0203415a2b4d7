"""One stream of samples with the external torque that the robot estimates itself."""

from typing import NamedTuple

from numpy.typing import ArrayLike

from residual.external_torque import TorqueSample, velocity_estimator
from residual.guard_state import GuardState
from residual.sample_entry import SampleEntry
from residual.sensor_config import SensorConfig
from residual.velocity_estimator import VelocityState
from urdf import Robot


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
