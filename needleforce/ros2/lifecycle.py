"""The node as a lifecycle node: configured, active, inactive, and its process."""

from collections.abc import Callable, Sequence
from typing import Any

from foundation.errors import NeedleforceError
from needleforce.ros2.node import REPORT_PERIOD_S, NeedleNode, declare_parameters
from needleforce.ros2.parameters import NodeSettings
from needleforce.ros2.robot_description import wait_for_description
from needleforce.ros2.ros_modules import RosModules, import_ros
from needleforce.session import InsertionSession
from urdf import Robot

Prepare = Callable[[InsertionSession], None]


class NodeStates:
    """What the node does in each of its transitions.

    Args:
        ros: The modules of ROS 2.
        node: A lifecycle node.
        settings: Values of its parameters.
        make_robot: Makes the arm; called with what waits for its `robot_description`,
            and returns that.
        prepare: Called with the session once: lets it follow a plan.

    Attributes:
        needle_node: What the node does; None while it is not configured.
        failure: Why it could not be configured; None if it could.
    """

    def __init__(
        self,
        ros: RosModules,
        node: Any,
        settings: NodeSettings,
        make_robot: Callable[[Callable[[], str]], Robot],
        prepare: Prepare,
    ) -> None:
        self._ros = ros
        self._node = node
        self._settings = settings
        self._make_robot = make_robot
        self._prepare = prepare
        self.needle_node: NeedleNode | None = None
        self.failure: NeedleforceError | None = None

    def configure(self) -> bool:
        """Find out what the arm is; make topics, services and the session."""
        self._own = set(self._entities())
        try:
            robot = self._make_robot(self._wait_for_description)
            self.needle_node = NeedleNode(
                self._ros, self._node, robot, self._settings, self._prepare
            )
        except NeedleforceError as error:
            self.failure = error
            self._node.get_logger().error(str(error))
            return False
        self.failure = None
        return self.activate(False)

    def activate(self, is_active: bool = True) -> bool:
        """Use joint states from now on, or pass them by."""
        if self.needle_node is not None:
            self.needle_node.is_active = is_active
        return True

    def clean_up(self) -> bool:
        """Forget the session; take topics and services back."""
        self.needle_node = None
        for destroy, entity in self._entities():
            if (destroy, entity) not in self._own:
                getattr(self._node, destroy)(entity)
        return True

    def _entities(self) -> list[tuple[str, Any]]:
        """Return what the node has now, each with the method that destroys it."""
        kinds = ("publisher", "subscription", "service", "timer")
        return [
            (f"destroy_{kind}", entity)
            for kind in kinds
            for entity in getattr(self._node, f"{kind}s")
        ]

    def _wait_for_description(self) -> str:
        """Return the arm's description; a node of its own listens meanwhile.

        Who starts by itself waits for ever; a manager gets an answer.
        """
        if self._settings.autostart:
            return wait_for_description(self._ros, self._node)
        node = self._ros.rclpy.create_node("needleforce_description")
        try:
            return wait_for_description(self._ros, node, max_s=10.0)
        finally:
            node.destroy_node()


def run_node(
    arguments: Sequence[str],
    make_robot: Callable[[Callable[[], str]], Robot],
    say: Callable[[str], None],
    prepare: Prepare = lambda session: None,
) -> None:
    """Run the node until Ctrl-C, SIGTERM or its service `~/stop`.

    Args:
        arguments: Of ROS 2, such as ``--ros-args -p queue_depth:=100``.
        make_robot: Makes the arm; called with what waits for its `robot_description`,
            and returns that.
        say: Takes one line of text.
        prepare: Called with the session once: lets it follow a plan.

    Raises:
        MissingRosError: This Python cannot import ROS 2.
        Ros2ParameterError: A parameter is unknown or cannot be.
    """
    ros = import_ros()
    ros.rclpy.init(args=list(arguments))
    try:
        results = ros.lifecycle.TransitionCallbackReturn

        def answer(is_done: bool) -> Any:
            return results.SUCCESS if is_done else results.FAILURE

        class Node(ros.lifecycle.LifecycleNode):
            """Passes its transitions on."""

            states: NodeStates

            def on_configure(self, state: Any) -> Any:
                return answer(self.states.configure())

            def on_activate(self, state: Any) -> Any:
                return answer(self.states.activate())

            def on_deactivate(self, state: Any) -> Any:
                return answer(self.states.activate(False))

            def on_cleanup(self, state: Any) -> Any:
                return answer(self.states.clean_up())

        node = Node("needleforce", automatically_declare_parameters_from_overrides=True)
        settings = declare_parameters(ros, node)
        states = NodeStates(ros, node, settings, make_robot, prepare)
        node.states = states
        try:
            _spin(ros, node, states, settings)
        finally:
            if states.needle_node is not None:
                say(states.needle_node.describe())
    finally:
        ros.rclpy.try_shutdown()


def _spin(
    ros: RosModules, node: Any, states: NodeStates, settings: NodeSettings
) -> None:
    """Serve the node until it is stopped or shut down."""
    try:
        if settings.autostart:
            node.trigger_configure()
            if states.failure is not None:
                raise states.failure
            node.trigger_activate()
        executor = ros.executors.SingleThreadedExecutor()
        executor.add_node(node)
        if settings.autostart:
            node.get_logger().info("ready")
        while not (states.needle_node and states.needle_node.is_stopped):
            executor.spin_once()
    except (KeyboardInterrupt, ros.executors.ExternalShutdownException):
        return
    except RuntimeError:  # a signal ends the context in the midst of an update
        if ros.rclpy.ok():
            raise
        return
    # The answer of the service is on its way.
    executor.spin_once(timeout_sec=REPORT_PERIOD_S)
