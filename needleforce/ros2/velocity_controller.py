"""The velocity controller of ros2_control that moves an arm.

It is an independent process, and holds the velocity that it was sent last for ever. So
a thread sends one in every cycle, and brakes to zero when no new one comes.
"""

# pyright: reportMissingImports=false

import threading
from time import monotonic
from typing import Any

import numpy as np
from rcl_interfaces.msg import ParameterValue
from rclpy.parameter_client import AsyncParameterClient
from std_msgs.msg import Float64MultiArray

from foundation.arrays import Array
from needleforce.devices import DeviceSettingError, LinkError
from needleforce.devices.guard import Guard
from needleforce.recordings.joint_names import match_joints

CONTROLLER = "/forward_velocity_controller"
"""As examples of ros2_control name it."""

CYCLE_S = 0.002
"""Of the commands."""

MAX_ANSWER_S = 10.0
"""Time within which the controller answers."""

MAX_BRAKE_S = 2.0
"""An arm that moves at its highest speed has come to rest before."""


class VelocityController:
    """Sends velocities to a controller until it is stopped.

    It does not stop the arm where the process is killed (SIGKILL) or frozen: the arm
    then keeps its velocity, and needs a limit of its own.

    Args:
        node: That publishes the commands.
        executor: That serves it.
        name: Of the controller's node.
        joint_names: The arm's joints, in its order.
        guard: Gives the velocity of every cycle.

    Attributes:
        place_rad: Where the arm is, shape (n,).

    Raises:
        LinkError: The controller does not answer.
        DeviceSettingError: It is of other joints, or not of velocities.
    """

    def __init__(
        self,
        node: Any,
        executor: Any,
        name: str,
        joint_names: tuple[str, ...],
        guard: Guard,
    ) -> None:
        self._name = name
        self._guard = guard
        self._order = self._find_order(node, executor, joint_names)
        self.place_rad = np.zeros(len(joint_names))
        self._is_ended = threading.Event()
        self._publisher = node.create_publisher(
            Float64MultiArray, f"{name}/commands", 1
        )
        self._thread = threading.Thread(target=self._run, daemon=True)

    def _find_order(
        self, node: Any, executor: Any, joint_names: tuple[str, ...]
    ) -> list[int]:
        """Return where the controller's joints stand among the arm's."""
        client = AsyncParameterClient(node, self._name)
        if not client.wait_for_services(MAX_ANSWER_S):
            raise LinkError(
                f"{self._name}: no controller of that name within {MAX_ANSWER_S:g} s",
                "Load and activate a velocity controller of ros2_control, or name "
                "yours as controller.",
            )

        def ask(parameter: str) -> Any:
            """Return the value of a parameter; an empty one if it has none."""
            future = client.get_parameters([parameter])
            executor.spin_until_future_complete(future, timeout_sec=MAX_ANSWER_S)
            if not future.done():
                raise LinkError(
                    f"{self._name} does not say its {parameter} within "
                    f"{MAX_ANSWER_S:g} s"
                )
            values = future.result().values
            return values[0] if values else ParameterValue()

        kind = ask("interface_name").string_value
        if kind not in ("", "velocity"):
            raise DeviceSettingError(
                f"{self._name} commands {kind}; expected a controller of velocity"
            )
        joints = tuple(ask("joints").string_array_value)
        matches = match_joints(joints, joint_names)
        if len(matches) != 1 or len(joints) != len(joint_names):
            raise DeviceSettingError(
                f"{self._name} moves {', '.join(joints) or 'no joints'}; expected "
                f"those of the arm, {', '.join(joint_names)}"
            )
        return [matches[0].names.index(joint) for joint in joints]

    @property
    def is_heard(self) -> bool:
        """Whether the controller listens, and commands are sent."""
        if self._is_ended.is_set():
            return False
        return self._publisher.get_subscription_count() > 0

    def start(self) -> None:
        """Begin to send, if it has not begun."""
        if self._thread.ident is None:
            self._thread.start()

    def _run(self) -> None:
        """Send a velocity in every cycle, until the end; zero is the last."""
        due_s = monotonic()
        try:
            while not self._is_ended.wait(max(due_s - monotonic(), 0.0)):
                # Cycles that were missed are not made up for.
                due_s = max(due_s, monotonic() - CYCLE_S) + CYCLE_S
                if not self.is_heard:  # who moved the arm has gone
                    self._guard.anchor()
                self._send(self._guard.advance(self.place_rad))
        finally:
            self._is_ended.set()
            self._send(np.zeros(len(self._order)))

    def _send(self, velocity_rad_s: Array) -> None:
        """Publish a velocity, in the order of the controller's joints."""
        data = velocity_rad_s[self._order].tolist()
        self._publisher.publish(Float64MultiArray(data=data))

    def stop(self) -> None:
        """Brake the arm to rest, and send nothing more."""
        if self._thread.ident is not None:
            self._guard.brake()
            end_s = monotonic() + MAX_BRAKE_S
            while not self._guard.is_at_rest and monotonic() < end_s:
                if self._is_ended.wait(CYCLE_S):
                    break
        self._is_ended.set()
        if self._thread.ident is not None:
            self._thread.join()
