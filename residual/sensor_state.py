"""All that a virtual force sensor remembers, as one immutable value."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from residual.errors import SnapshotError
from residual.external_torque_stream import ExternalTorqueStreamState
from residual.joint_stream import JointStreamState
from residual.offset_removal import OffsetState
from residual.slow_checks import SlowState
from residual.wrench import AxialWeights
from residual.wrench_estimate import WrenchEstimate


class SensorState(NamedTuple):
    """State of a `VirtualForceSensor`.

    Attributes:
        robot: `robot_digest` of its robot.
        config: Its settings in words; they must be the same to go on.
        joints: Of the stream of joint signals; None before the first sample of one.
        external_torque: Of the stream of external torques; None before the first sample of one.
        lag_s: Of the stream that the last sample came by [s].
        offset: Of the offset removal.
        torque_covariance: Of the residual's error, as last renewed [Nm^2], shape (n, n).
        weights: Of the wrench, as last renewed.
        slow: Of the slow checks.
        doubt: Of the doubt that the lag adds [N].
        looked_s: Time since the last slow check [s].
        velocity: Joint velocity of the last sample [rad/s], shape (n,).
        last: Last estimate; None before the first.
        missed_s: Time of samples skipped since then [s].
        skipped: Number of bad samples so far.
    """

    robot: str
    config: str
    joints: JointStreamState | None
    external_torque: ExternalTorqueStreamState | None
    lag_s: float
    offset: OffsetState
    torque_covariance: NDArray[np.float64]
    weights: AxialWeights
    slow: SlowState
    doubt: float | None
    looked_s: float
    velocity: NDArray[np.float64]
    last: WrenchEstimate | None
    missed_s: float
    skipped: int


def check_belongs(state: object, robot: str, config: str) -> None:
    """Refuse a state that is not of such a sensor.

    Args:
        state: What is to be restored.
        robot: `robot_digest` of the sensor's robot.
        config: Its settings in words.

    Raises:
        SnapshotError: With what differs.
    """
    if not isinstance(state, SensorState):
        raise SnapshotError(f"expected a SensorState, got {type(state).__name__}")
    if state.robot != robot:
        raise SnapshotError(
            "the snapshot is of another robot (joints, links, payload, frames or limits differ); "
            "restore it with the robot it was taken with"
        )
    if state.config != config:
        raise SnapshotError(
            f"the snapshot is of other settings: {state.config}, this sensor has {config}"
        )
