"""The state of a virtual force sensor, and the slow work that waits in it."""

from enum import StrEnum
from typing import NamedTuple

from foundation.arrays import Array
from residual.bias.estimator import BiasState
from residual.checks.monitor import MonitorState
from residual.estimate import WrenchEstimate
from residual.sample_stream import StreamState
from residual.wrench_estimator import WrenchFilterState


class DueWork(StrEnum):
    """Slow work that waits for its tick, so that no tick does all of it.

    After the bias was renewed the next tick checks consistency, the one after that
    computes the gain anew.
    """

    CHECK = "check"
    """The consistency check, and after it the gain."""
    GAIN = "gain"
    """The gain."""
    NONE = ""
    """Nothing until the bias is renewed; it counts as false."""


class SensorState(NamedTuple):
    """State of a `VirtualForceSensor`, with the robot and settings that it is of.

    Attributes:
        robot: `robot_digest` of its robot.
        config: Its settings in words; they must be the same to go on.
        stream: Of the stream of samples; None before the first.
        is_external: Whether it is one of the robot's own external torques.
        lag_s: Of the stream that the last sample came by.
        offset: Of the offset removal.
        torque_covariance: Covariance of the residual's error, as last renewed [Nm^2],
            shape (n, n).
        gain_configuration: Where the gain was computed last [rad], shape (n,).
        monitor: Of the consistency checks.
        wrench_filter: Of the smoothing of the wrench.
        is_smoothing: Whether that is of a sample.
        unchecked_s: Time since the last consistency check.
        due: Slow work that waits for its tick.
        last: Last estimate; None before the first.
        missed_s: Time of samples rejected since then.
        rejected: Number of bad samples so far.
    """

    robot: str
    config: str
    stream: StreamState | None
    is_external: bool
    lag_s: float
    offset: BiasState
    torque_covariance: Array
    gain_configuration: Array
    monitor: MonitorState
    wrench_filter: WrenchFilterState
    is_smoothing: bool
    unchecked_s: float
    due: DueWork
    last: WrenchEstimate | None
    missed_s: float
    rejected: int
