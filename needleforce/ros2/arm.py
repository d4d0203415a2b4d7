"""An arm whose driver publishes joint states; ros2_control can drive it, too.

A velocity controller of ros2_control is an independent process, and holds the velocity
that it was sent last for ever. So a thread sends one in every cycle, and brakes to zero
when no new one comes.
"""

# pyright: reportMissingImports=false

import math
import threading
from collections import deque
from time import monotonic
from typing import Any

import numpy as np
import rclpy
from numpy.typing import ArrayLike
from rcl_interfaces.msg import ParameterValue
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from foundation.arrays import Array
from needleforce.devices import ArmReading, DeviceSettingError, LinkError
from needleforce.devices.arm_limits import ArmLimits, limits_with_our_rates
from needleforce.devices.guard import GuardedArm
from needleforce.recordings.joint_names import match_joints
from needleforce.ros2.joint_samples import JointReader
from urdf import Robot

CYCLE_S = 0.002
"""Of the commands."""

MAX_SILENCE_S = 2.0
"""Silence after which an arm that has sent is lost [s]."""


class Ros2Arm(GuardedArm):
    """Joint states of a topic as an arm.

    With ``takes_commands`` a velocity controller of ros2_control moves it. Nothing
    stops the arm where this process is killed (SIGKILL) or frozen: it then keeps its
    velocity, and needs a limit of its own.

    Args:
        topic: Such as ``/joint_states``.
        joint_names: The arm's joints, in its order.
        takes_commands: Whether it shall move; otherwise it is only listened to.
        controller: Name of the controller's node, active and of velocities; by default
            as examples of ros2_control name it.
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
        controller: str = "/forward_velocity_controller",
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
        super().__init__(
            joints,
            robot,
            # Publisher and subscription find each other, and a state comes [s].
            give_up_s=10.0,
            cycle_s=CYCLE_S,
            # Joint states may come at 100 Hz: a velocity holds for five of those.
            hold_cycles=round(0.05 / CYCLE_S),
        )
        self._topic = topic
        self._reader = JointReader(joint_names)
        self._readings: deque[ArmReading] = deque()
        self._context = rclpy.Context()
        # Signals are the command's, which ends the arm.
        self._context.init(args=[])
        node = rclpy.create_node("needleforce_arm", context=self._context)
        # Joint states that wait: a second at 1 kHz.
        quality = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
        node.create_subscription(JointState, topic, self._take, quality)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(node)
        self._stated_s = -math.inf  # when the latest state came
        self._place_rad = np.zeros(joints)
        self._takes_commands = takes_commands
        self._is_ended = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        if takes_commands:
            self._commands = node.create_publisher(
                Float64MultiArray, f"{controller}/commands", 1
            )
            try:
                self._order = _find_order(node, self._executor, controller, joint_names)
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
        self._place_rad = sample.q_rad
        self._readings.append(
            sample._replace(
                accepts_commands=self._accepts_commands, is_real=self._takes_commands
            )
        )

    def _read(self, wait_s: float) -> ArmReading | None:
        # Those that came while the controller was looked for go first: if each waited
        # for a new one, every reading would stay as late as the first.
        if not self._readings:
            self._executor.spin_once(timeout_sec=wait_s)
        return self._readings.popleft() if self._readings else None

    def _place(self) -> str:
        return f"of {self._topic}{self._reader.problem and ': '}{self._reader.problem},"

    def _find_refusal(self) -> str:
        # No velocity is taken for an arm that was not heard for so long.
        max_blind_s = 0.1
        if not self._takes_commands:
            return "the arm was opened without takes_commands=True"
        if monotonic() - self._stated_s > max_blind_s:
            self._guard.interrupt()
            return f"no joint state has come for {max_blind_s:g} s"
        is_heard = self._is_heard and not self._is_ended.is_set()
        return "" if is_heard else "the controller does not listen"

    @property
    def _is_heard(self) -> bool:
        """Whether the controller listens."""
        return self._commands.get_subscription_count() > 0

    def send(self, dq_rad_s: ArrayLike) -> bool:
        """Command a joint velocity; see `GuardedArm.send`."""
        is_taken = super().send(dq_rad_s)
        if is_taken and self._thread.ident is None:
            self._thread.start()
        return is_taken

    def _run(self) -> None:
        """Send a velocity in every cycle, until the end; zero is the last."""
        due_s = monotonic()
        try:
            while not self._is_ended.wait(max(due_s - monotonic(), 0.0)):
                # Cycles that were missed are not made up for.
                due_s = max(due_s, monotonic() - CYCLE_S) + CYCLE_S
                if not self._is_heard:  # who moved the arm has gone
                    self._guard.anchor()
                self._publish(self._guard.advance(self._place_rad))
        finally:
            self._is_ended.set()
            self._publish(np.zeros(self.joints))

    def _publish(self, velocity_rad_s: Array) -> None:
        """Publish a velocity, in the order of the controller's joints."""
        data = velocity_rad_s[self._order].tolist()
        self._commands.publish(Float64MultiArray(data=data))

    def close(self) -> None:
        """Brake the arm to rest if it was commanded; end the readings and the node."""
        super().close()
        if self._thread.ident is not None:
            # An arm that moves at its highest speed has come to rest before.
            max_brake_s = 2.0
            self._guard.brake()
            end_s = monotonic() + max_brake_s
            while not self._guard.is_at_rest and monotonic() < end_s:
                if self._is_ended.wait(CYCLE_S):
                    break
            self._is_ended.set()
            self._thread.join()
        self._executor.shutdown()
        self._context.try_shutdown()


def _find_order(
    node: Any, executor: Any, name: str, joint_names: tuple[str, ...]
) -> list[int]:
    """Return where the joints of a controller stand among the arm's.

    Raises:
        LinkError: The controller does not answer.
        DeviceSettingError: It is of other joints, or not of velocities.
    """
    max_answer_s = 10.0
    client = AsyncParameterClient(node, name)
    if not client.wait_for_services(max_answer_s):
        raise LinkError(
            f"{name}: no controller of that name within {max_answer_s:g} s",
            "Load and activate a velocity controller of ros2_control, or name yours "
            "as controller.",
        )

    def ask(parameter: str) -> Any:
        """Return the value of a parameter; an empty one if it has none."""
        future = client.get_parameters([parameter])
        executor.spin_until_future_complete(future, timeout_sec=max_answer_s)
        if not future.done():
            raise LinkError(
                f"{name} does not say its {parameter} within {max_answer_s:g} s"
            )
        return next(iter(future.result().values), ParameterValue())

    kind = ask("interface_name").string_value
    if kind not in ("", "velocity"):
        raise DeviceSettingError(
            f"{name} commands {kind}; expected a controller of velocity"
        )
    joints = tuple(ask("joints").string_array_value)
    matches = match_joints(joints, joint_names)
    if len(matches) != 1 or len(joints) != len(joint_names):
        raise DeviceSettingError(
            f"{name} moves {', '.join(joints) or 'no joints'}; expected those of the "
            f"arm, {', '.join(joint_names)}"
        )
    return [matches[0].names.index(joint) for joint in joints]
