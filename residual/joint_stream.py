"""One stream of samples through its guard: joint signals, or the robot's own estimate."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from residual.external_torque import ExternalTorqueEstimator, ExternalTorqueState, TorqueSample
from residual.sample_check import check_joint_vector
from residual.sample_guard import GuardState, SampleGuard
from residual.sensor_config import SensorConfig
from residual.velocity_estimator import VelocityEstimator, VelocityState
from urdf import Robot


class JointStreamState(NamedTuple):
    """All that a `JointStream` remembers.

    Attributes:
        torque: Of the external torque.
        guard: Of the sample guard.
    """

    torque: ExternalTorqueState
    guard: GuardState


class JointStream:
    """Positions, velocities if there are any, and torques, into external torque.

    Args:
        robot: The arm with its payload.
        config: Settings of the sensor.
        has_velocity: Whether the robot sends joint velocities.
    """

    def __init__(self, robot: Robot, config: SensorConfig, *, has_velocity: bool) -> None:
        self._torque = ExternalTorqueEstimator(robot, config, has_velocity=has_velocity)
        self._guard = SampleGuard(
            robot, has_velocity=has_velocity, velocity_delay_s=self._torque.delay_s
        )
        self._guarded = config.guard
        self.lag_s = self._torque.lag_s
        """Time by which the estimate follows the torque [s]."""

    def update(
        self, q: ArrayLike, dq: ArrayLike | None, tau: ArrayLike, dt_s: float
    ) -> TorqueSample:
        """Take one sample; see `VirtualForceSensor.update`.

        Raises:
            SampleError: For a bad sample; nothing has then changed but what the guard knows of it.
        """
        if self._guarded and self._guard.check(q, dq, tau, dt_s):
            self._torque.restart_velocity()
        sample = self._torque.update(q, dq, tau, dt_s)
        self._guard.accept(sample.dq, dt_s)
        return sample

    @property
    def state(self) -> JointStreamState:
        """All that is remembered, as copies."""
        return JointStreamState(self._torque.state, self._guard.state)

    def restore(self, state: JointStreamState) -> None:
        """Go on from a `state` taken earlier, of a stream with or without velocity as this one."""
        self._torque.restore(state.torque)
        self._guard.restore(state.guard)


class EstimateStreamState(NamedTuple):
    """All that an `EstimateStream` remembers.

    Attributes:
        velocity: Of the velocity estimator.
        guard: Of the sample guard.
    """

    velocity: VelocityState
    guard: GuardState


class EstimateStream:
    """Positions and external torques that the robot estimates itself.

    Args:
        robot: The arm.
        config: Settings of the sensor.
    """

    lag_s = 0.0
    """Whatever lag the robot's estimate has is not known here."""

    def __init__(self, robot: Robot, config: SensorConfig) -> None:
        self._joints = robot.nv
        self._velocity = VelocityEstimator(
            robot.nv, config.velocity_bandwidth_per_s, max_gap_s=config.max_gap_s
        )
        self._guard = SampleGuard(
            robot, has_velocity=False, velocity_delay_s=self._velocity.delay_s
        )
        self._guarded = config.guard

    def update(
        self, q: ArrayLike, dq: ArrayLike | None, external_torque: ArrayLike, dt_s: float
    ) -> TorqueSample:
        """Take one sample; see `VirtualForceSensor.update_external_torque`.

        Raises:
            SampleError: For a bad sample; nothing has then changed but what the guard knows of it.
        """
        torque = check_joint_vector("external_torque", external_torque, self._joints)
        q = check_joint_vector("q", q, self._joints)
        velocity = None if dq is None else check_joint_vector("dq", dq, self._joints)
        if self._guarded and self._guard.check(q, None, torque, dt_s):
            self._velocity.reset()
        if velocity is None:
            matched = self._velocity.update(q, torque, dt_s)
            velocity = matched.dq if matched.settled else np.zeros(self._joints)
        self._guard.accept(velocity, dt_s)
        return TorqueSample(q, velocity, torque, torque, True)

    @property
    def state(self) -> EstimateStreamState:
        """All that is remembered, as copies."""
        return EstimateStreamState(self._velocity.state, self._guard.state)

    def restore(self, state: EstimateStreamState) -> None:
        """Go on from a `state` taken earlier."""
        self._velocity.restore(state.velocity)
        self._guard.restore(state.guard)
