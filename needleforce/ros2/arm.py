"""An arm whose driver publishes joint states, for the commands on an arm."""

from collections import deque
from collections.abc import Iterator
from time import monotonic
from typing import Any

from needleforce.devices import ArmReading, LinkError
from needleforce.devices.link import ReadOnlyArm
from needleforce.ros2.joint_samples import JointReader
from needleforce.ros2.message_loss import LossCounter, identify_sender
from needleforce.ros2.messages import read_joint_state
from needleforce.ros2.ros_modules import import_ros

QUEUE_DEPTH = 1000
"""Joint states that wait: a second at 1 kHz."""

WAIT_S = 0.1
"""Longest wait for a message before the end is looked for."""

MAX_START_S = 10.0
"""Time within which publisher and subscription find each other, and a state comes."""

MAX_SILENCE_S = 2.0
"""Silence after which an arm that has sent is taken for gone."""


class Ros2Arm(ReadOnlyArm):
    """Joint states of a topic as an arm that is only listened to.

    Args:
        topic: Such as ``/joint_states``.
        joint_names: The arm's joints, in its order.

    Attributes:
        joints: How many there are.

    Raises:
        MissingRosError: This Python cannot import ROS 2.
    """

    def __init__(self, topic: str, joint_names: tuple[str, ...]) -> None:
        super().__init__()
        ros = import_ros()
        self.joints = len(joint_names)
        self._topic = topic
        self._reader = JointReader(joint_names)
        self._loss = LossCounter()
        self._lost_before = 0
        self._readings: deque[ArmReading] = deque()
        self._context = ros.rclpy.Context()
        # Signals are the command's, which ends the arm.
        self._context.init(args=[])
        node = ros.rclpy.create_node("needleforce_arm", context=self._context)
        quality = ros.qos.QoSProfile(
            depth=QUEUE_DEPTH, reliability=ros.qos.ReliabilityPolicy.BEST_EFFORT
        )
        node.create_subscription(ros.sensor.JointState, topic, self._take, quality)
        self._executor = ros.executors.SingleThreadedExecutor(context=self._context)
        self._executor.add_node(node)

    def _take(self, message: Any, info: Any) -> None:
        """Keep the reading of a joint state."""
        self._loss.count(*identify_sender(info))
        sample = self._reader.read(read_joint_state(message))
        counts = self._reader.counts
        self.report.malformed = counts.malformed + counts.without_effort
        self.report.stale = counts.stale
        if sample is None or sample.dt_s < 0.0:
            return
        missed = self._loss.lost - self._lost_before
        self._lost_before = self._loss.lost
        self.report.count_used(missed + 1, sample.dt_s)
        self._readings.append(
            ArmReading(
                dt_s=sample.dt_s,
                q_rad=sample.q_rad,
                dq_rad_s=sample.dq_rad_s,
                tau_Nm=sample.effort_Nm,
                external_Nm=None,
                missed=missed,
                accepts_commands=False,
            )
        )

    def __iter__(self) -> Iterator[ArmReading]:
        """Yield readings as they come, until the arm stays away.

        Raises:
            LinkError: None came within `MAX_START_S`.
        """
        heard_s = monotonic()
        while self._is_open:
            self._executor.spin_once(timeout_sec=WAIT_S)
            if self._readings:
                heard_s = monotonic()
                yield self._readings.popleft()
                continue
            silent_s = monotonic() - heard_s
            if not self.report.used and silent_s > MAX_START_S:
                raise LinkError(
                    f"{self._topic}: {self._reader.problem} within {MAX_START_S:g} s"
                )
            if self.report.used and silent_s > MAX_SILENCE_S:
                self.report.outages += 1
                return

    def close(self) -> None:
        """End the readings and the node."""
        super().close()
        self._executor.shutdown()
        self._context.try_shutdown()
