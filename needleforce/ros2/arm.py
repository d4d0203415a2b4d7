"""An arm whose driver publishes joint states; ros2_control can drive it, too."""

# pyright: reportMissingImports=false

import math
from collections import deque
from copy import copy
from time import monotonic
from typing import Any

import numpy as np
import rclpy
from numpy.typing import ArrayLike
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import JointState

from needleforce.devices import ArmReading, DeviceSettingError
from needleforce.devices.arm_limits import ArmLimits, limits_with_our_rates
from needleforce.devices.guard import GuardedArm
from needleforce.ros2.joint_samples import JointReader
from needleforce.ros2.velocity_controller import (
    CONTROLLER,
    CYCLE_S,
    VelocityController,
)
from urdf import Robot

MAX_START_S = 10.0
"""Time within which publisher and subscription find each other, and a state comes."""

MAX_BLIND_S = 0.1
"""No velocity is taken for an arm that was not heard for so long."""

MAX_SILENCE_S = 2.0
"""Silence after which an arm that has sent is lost [s]."""


class Ros2Arm(GuardedArm):
    """Joint states of a topic as an arm.

    With ``takes_commands`` a velocity controller of ros2_control moves it; see
    `VelocityController` for what stops it, and what cannot.

    Args:
        topic: Such as ``/joint_states``.
        joint_names: The arm's joints, in its order.
        takes_commands: Whether it shall move; otherwise it is only listened to.
        controller: Name of the controller's node, active and of velocities.
        robot: The model of the arm, needed to move.
        preset: Limits of commands, or their name in `ARM_LIMITS`; None for speeds and
            stops of the model, with acceleration and jerk of ours.

    Attributes:
        joints: How many there are.
        robot: The model of the arm.

    Raises:
        LinkError: The controller does not answer.
        DeviceSettingError: It is of other joints, or not of velocities; no model.
    """

    def __init__(
        self,
        topic: str,
        joint_names: tuple[str, ...],
        *,
        takes_commands: bool = False,
        controller: str = CONTROLLER,
        robot: Robot | None = None,
        preset: str | ArmLimits | None = None,
    ) -> None:
        if takes_commands and robot is None:
            raise DeviceSettingError(
                "takes_commands without robot; expected the model, which has the "
                "limits of the joints"
            )
        joints = len(joint_names)
        # Without a model it is only listened to.
        speed_rad_s = robot.velocity_limit_rad_s if robot else np.zeros(joints)
        self.preset = preset or limits_with_our_rates(
            tuple(speed_rad_s), CYCLE_S, "of the model"
        )
        # Joint states may come at 100 Hz: a velocity holds for five of those.
        hold_cycles = round(0.05 / CYCLE_S)
        super().__init__(
            joints, robot, MAX_START_S, cycle_s=CYCLE_S, hold_cycles=hold_cycles
        )
        self._topic = topic
        self._reader = JointReader(joint_names)
        self._readings: deque[ArmReading] = deque()
        self._context = rclpy.Context()
        # Signals are the command's, which ends the arm.
        self._context.init(args=[])
        node = rclpy.create_node("needleforce_arm", context=self._context)
        quality = copy(qos_profile_sensor_data)
        quality.depth = 1000  # joint states that wait: a second at 1 kHz
        node.create_subscription(JointState, topic, self._take, quality)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(node)
        self._stated_s = -math.inf
        self._controller: VelocityController | None = None
        if takes_commands:
            try:
                self._controller = VelocityController(
                    node, self._executor, controller, joint_names, self._guard
                )
            except Exception:
                self.close()
                raise

    def _take(self, message: Any) -> None:
        """Keep the reading of a joint state."""
        sample = self._reader.read(message)
        counts = self._reader.counts
        self.report.malformed = counts["malformed"] + counts["without_effort"]
        self.report.stale = counts["stale"]
        if sample is None or sample.dt_s < 0.0:
            return
        self.report.count_used(1, sample.dt_s)
        self.give_up_s = MAX_SILENCE_S
        self._stated_s = monotonic()
        if self._controller is not None:
            self._controller.place_rad = sample.q_rad
        self._readings.append(
            ArmReading(
                dt_s=sample.dt_s,
                q_rad=sample.q_rad,
                dq_rad_s=sample.dq_rad_s,
                tau_Nm=sample.effort_Nm,
                external_Nm=None,
                missed=0,  # a topic has no cycles that could be counted
                accepts_commands=self._accepts_commands,
                is_real=self._controller is not None,
            )
        )

    def _read(self, wait_s: float) -> ArmReading | None:
        self._executor.spin_once(timeout_sec=wait_s)
        return self._readings.popleft() if self._readings else None

    def _place(self) -> str:
        return f"of {self._topic}{self._reader.problem and ': '}{self._reader.problem},"

    def _find_refusal(self) -> str:
        if self._controller is None:
            return "the arm was opened without takes_commands=True"
        if monotonic() - self._stated_s > MAX_BLIND_S:
            self._guard.interrupt()
            return f"no joint state has come for {MAX_BLIND_S:g} s"
        return "" if self._controller.is_heard else "the controller does not listen"

    def send(self, dq_rad_s: ArrayLike) -> bool:
        """Command a joint velocity; see `GuardedArm.send`."""
        if not super().send(dq_rad_s) or self._controller is None:
            return False
        self._controller.start()
        return True

    def close(self) -> None:
        """Brake the arm to rest if it was commanded; end the readings and the node."""
        super().close()
        if self._controller is not None:
            self._controller.stop()
        self._executor.shutdown()
        self._context.try_shutdown()
