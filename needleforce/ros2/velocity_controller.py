"""The velocity controller of ros2_control that moves an arm.

It is an independent process, and holds the velocity that it was sent last for ever. So
a thread sends one in every cycle, and brakes to zero when no new one comes.
"""

import atexit
import math
import threading
from time import monotonic
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from foundation.arrays import Array
from needleforce.devices import DeviceSettingError, LinkError
from needleforce.recordings.joint_names import match_joints
from needleforce.ros2.ros_modules import RosModules

CONTROLLER = "/forward_velocity_controller"
"""As examples of ros2_control name it."""

CYCLE_S = 0.002
"""Of the commands."""

ACCELERATION_rad_s2 = 5.0
"""With which velocities are reached, and the arm brakes: that of commands to arms whose
own limits are not known."""

HOLD_S = 0.05
"""A velocity is held for so long without a new one; then the arm brakes. Five cycles of
ros2_control, which runs at 100 Hz unless told otherwise."""

MAX_ANSWER_S = 10.0
"""Time within which the controller answers."""

STEP_S = 0.1
"""Longest wait for its answer before the time is looked at."""

MAX_BRAKE_S = 2.0
"""An arm that moves at its highest speed has come to rest before."""


class VelocityController:
    """Sends velocities to a controller until it is stopped.

    The arm is braked where no velocity comes for `HOLD_S`, on `stop`, and at the end
    of the process, after an exception too. It is not where the process is killed
    (SIGKILL) or frozen: the arm then keeps its velocity, and needs a limit of its own.

    Args:
        ros: The modules of ROS 2.
        node: That publishes the commands.
        executor: That serves it.
        name: Of the controller's node.
        joint_names: The arm's joints, in its order.
        highest_rad_s: Their highest speeds, shape (n,).

    Raises:
        LinkError: The controller does not answer.
        DeviceSettingError: It is of other joints, or not of velocities.
    """

    def __init__(
        self,
        ros: RosModules,
        node: Any,
        executor: Any,
        name: str,
        joint_names: tuple[str, ...],
        highest_rad_s: Array,
    ) -> None:
        self._ros = ros
        self._name = name
        self._highest_rad_s = highest_rad_s
        self._order = self._find_order(node, executor, joint_names)
        self._sent_rad_s = np.zeros(len(joint_names))
        self._wanted_rad_s = np.zeros(len(joint_names))
        self._wanted_until_s = -math.inf
        self._lock = threading.Lock()
        self._is_ended = threading.Event()
        self._publisher = node.create_publisher(
            ros.standard.Float64MultiArray, f"{name}/commands", 1
        )
        self._thread = threading.Thread(target=self._run, daemon=True)
        # `stop` at the end of the process, too: threads that are daemons still run.
        atexit.register(self.stop)

    def _find_order(
        self, node: Any, executor: Any, joint_names: tuple[str, ...]
    ) -> list[int]:
        """Return where the controller's joints stand among the arm's."""
        service = self._ros.parameter_services.GetParameters
        client = node.create_client(service, f"{self._name}/get_parameters")
        if not client.wait_for_service(timeout_sec=MAX_ANSWER_S):
            raise LinkError(
                f"{self._name}: no controller of that name within {MAX_ANSWER_S:g} s",
                "Load and activate a velocity controller of ros2_control, or name "
                "yours as controller.",
            )

        def ask(parameter: str) -> Any:
            """Return the value of a parameter; None if it has none."""
            future = client.call_async(service.Request(names=[parameter]))
            begun_s = monotonic()
            while not future.done():
                executor.spin_once(timeout_sec=STEP_S)
                if monotonic() - begun_s > MAX_ANSWER_S:
                    raise LinkError(
                        f"{self._name} does not say its {parameter} within "
                        f"{MAX_ANSWER_S:g} s"
                    )
            values = future.result().values
            return values[0] if values else None

        interface = ask("interface_name")
        kind = "" if interface is None else interface.string_value
        if kind not in ("", "velocity"):
            raise DeviceSettingError(
                f"{self._name} commands {kind}; expected a controller of velocity"
            )
        value = ask("joints")
        joints = () if value is None else tuple(value.string_array_value)
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

    def command(self, velocity_rad_s: ArrayLike) -> bool:
        """Take the velocity of the coming cycles, shape (n,).

        Returns:
            False where it cannot be, or a joint is faster than it may be.
        """
        try:
            velocity = np.array(velocity_rad_s, dtype=float)
        except (TypeError, ValueError):
            return False
        if velocity.shape != self._highest_rad_s.shape:
            return False
        # Written so that NaN, which compares as false, is refused.
        if not (np.abs(velocity) <= self._highest_rad_s).all():
            return False
        if not self.is_heard:
            return False
        with self._lock:
            self._wanted_rad_s = velocity
            self._wanted_until_s = monotonic() + HOLD_S
        if self._thread.ident is None:
            self._thread.start()
        return True

    def advance(self, now_s: float) -> Array:
        """Return the velocity of the next cycle, shape (n,) [rad/s].

        Args:
            now_s: On the clock `time.monotonic`.
        """
        step_rad_s = ACCELERATION_rad_s2 * CYCLE_S
        with self._lock:
            is_wanted = now_s < self._wanted_until_s
            wanted_rad_s = is_wanted * self._wanted_rad_s
            change_rad_s = np.clip(
                wanted_rad_s - self._sent_rad_s, -step_rad_s, step_rad_s
            )
            self._sent_rad_s = self._sent_rad_s + change_rad_s
            return self._sent_rad_s

    def _run(self) -> None:
        """Send a velocity in every cycle, until the end; zero is the last."""
        due_s = monotonic()
        try:
            while not self._is_ended.wait(max(due_s - monotonic(), 0.0)):
                # Cycles that were missed are not made up for.
                due_s = max(due_s, monotonic() - CYCLE_S) + CYCLE_S
                self._send(self.advance(monotonic()))
        finally:
            self._is_ended.set()
            self._send(np.zeros(len(self._order)))

    def _send(self, velocity_rad_s: Array) -> None:
        """Publish a velocity, in the order of the controller's joints."""
        self._publisher.publish(
            self._ros.standard.Float64MultiArray(
                data=velocity_rad_s[self._order].tolist()
            )
        )

    def stop(self) -> None:
        """Brake the arm to rest, and send nothing more."""
        atexit.unregister(self.stop)
        if self._thread.ident is None:
            self._is_ended.set()
            return
        end_s = monotonic() + MAX_BRAKE_S
        with self._lock:
            self._wanted_until_s = -math.inf
        while self._sent_rad_s.any() and monotonic() < end_s:
            if self._is_ended.wait(CYCLE_S):
                break
        self._is_ended.set()
        self._thread.join()
