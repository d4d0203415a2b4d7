"""The node: joint states in; wrench, tip force, layers, events and diagnostics out."""

# pyright: reportMissingImports=false

import time
from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import WrenchStamped
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.task import Future
from rclpy.wait_for_message import wait_for_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, String
from std_srvs.srv import Trigger

from foundation.arrays import Array
from foundation.errors import NeedleforceError
from needleforce.insertion_events import session_events
from needleforce.ros2.errors import Ros2Error, require_ros
from needleforce.ros2.joint_samples import NS_PER_S, JointReader
from needleforce.ros2.parameters import declare_parameters
from needleforce.ros2.reports import (
    ERROR,
    OK,
    WARNING,
    NamedReport,
    format_value,
    layer_reports,
    plan_reports,
)
from needleforce.session import InsertionSession, SessionEstimate
from needleforce.tare_run import TareRun
from residual import SensorConfig, Status
from urdf import Robot

REPORT_PERIOD_S = 1.0
"""Time between two messages of diagnostics and layers [s]."""

SILENCE_STEP_S = 0.01
"""Time between two looks at whether joint states still come [s]."""

NOT_TARED = "not tared: move in free air, then call ~/tare"

MakeRobot = Callable[[Callable[[], str]], Robot]
"""Makes the arm; called with what waits for its description, and returns that."""


def _kept(depth: int) -> QoSProfile:
    """Return the quality of a topic whose last messages late subscribers get."""
    return QoSProfile(depth=depth, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class NeedleNode(LifecycleNode):
    """A session fed by joint states.

    Every valid sample is answered by a wrench with its stamp, in the tool frame, at the
    needle's tip; while it is tared and usable, also by the force at the tip.

    Args:
        make_robot: Makes the arm.
        prepare: Called with the session once: lets it follow a plan.

    Attributes:
        failure: Why it could not be configured; None if it could.
        is_stopped: Whether it was shut down as a lifecycle node.

    Raises:
        Ros2ParameterError: A parameter is unknown or cannot be.
    """

    def __init__(
        self, make_robot: MakeRobot, prepare: Callable[[InsertionSession], None]
    ) -> None:
        super().__init__(
            "needleforce", automatically_declare_parameters_from_overrides=True
        )
        declare_parameters(self)
        self._make_robot = make_robot
        self._prepare = prepare
        self.is_stopped = False
        self.failure: NeedleforceError | None = None
        self._is_active = False

    def value(self, name: str) -> Any:
        """Return the value of a parameter."""
        return self.get_parameter(name).value

    # Transitions of its lifecycle

    def on_configure(self, state: Any) -> Any:
        """Find out what the arm is; make topics, services and the session."""
        self._own = self._list_entities()
        self.failure = None
        try:
            self._open(self._make_robot(self._wait_for_description))
        except NeedleforceError as error:
            self.failure = error
            self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: Any) -> Any:
        """Use joint states from now on."""
        self._is_active = True
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, state: Any) -> Any:
        """Pass joint states by from now on."""
        self._is_active = False
        return TransitionCallbackReturn.SUCCESS

    def on_cleanup(self, state: Any) -> Any:
        """Take topics and services back; the next configuration forgets the session."""
        for kind, entity in self._list_entities():
            if (kind, entity) not in self._own:
                getattr(self, f"destroy_{kind}")(entity)
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: Any) -> Any:
        """End the node; the arm is not commanded."""
        self.is_stopped = True
        return TransitionCallbackReturn.SUCCESS

    def _list_entities(self) -> list[tuple[str, Any]]:
        """Return what the node has now, each with its kind."""
        kinds = ("publisher", "subscription", "service", "timer")
        return [(kind, one) for kind in kinds for one in getattr(self, f"{kind}s")]

    def _wait_for_description(self) -> str:
        """Return the URDF that is published on `robot_description`, once it is.

        Who starts by itself waits for ever; a manager gets an answer.

        Raises:
            Ros2Error: A manager waits, and none came within 10 s.
        """
        topic = self.resolve_topic_name("robot_description")
        wait_s = 5.0 if self.value("autostart") else 10.0
        while rclpy.ok():
            has_come, message = wait_for_message(
                String, self, topic, qos_profile=_kept(1), time_to_wait=wait_s
            )
            if has_come and message.data:
                return message.data
            if not self.value("autostart"):
                break
            self.get_logger().warning(
                f"waiting for {topic}, as robot_state_publisher publishes it; "
                "--urdf FILE and --robot NAME describe the arm without it"
            )
        raise Ros2Error(
            f"{topic}: no description came in {wait_s:g} s",
            "Start robot_state_publisher, remap robot_description to its topic, or "
            "describe the arm with --urdf FILE or --robot NAME.",
        )

    # What it has while it is configured

    def _open(self, robot: Robot) -> None:
        """Make session, topics and services of an arm."""
        config = SensorConfig(
            gain_per_s=self.value("gain_per_s"),
            axes="tool",
            torque_is_gravity_compensated=self.value("gravity_compensated"),
        )
        self._axis = np.array(config.insertion_axis)
        self._message = WrenchStamped()  # one for all: to make one takes as long as
        # to publish it
        self._session = InsertionSession(robot, config)
        self._prepare(self._session)
        self._reader = JointReader(robot.joint_names, self.value("joint_pattern"))
        self._hardware = robot.model.name
        self._frame = self.value("frame_id") or robot.tool_frame
        self._tare = TareRun()
        self._estimate: SessionEstimate | None = None
        self._stamp_ns = 0
        self._delay_max_ns = 0
        self._heard_s = time.monotonic()
        self._is_silent = False
        self._advertise()
        self._subscribe()

    def _advertise(self) -> None:
        """Make the outputs, the services and the timers."""
        # Messages that wait for a slow subscriber: a second at 1 kHz.
        output_depth = 1000
        publisher = self.create_publisher
        self._wrench = publisher(WrenchStamped, "~/wrench", output_depth)
        self._tip = publisher(WrenchStamped, "~/tip_force", output_depth)
        self._depth = publisher(Float64, "~/depth_m", output_depth)
        self._events = publisher(DiagnosticArray, "~/events", _kept(100))
        self._layers = publisher(DiagnosticArray, "~/layers", _kept(1))
        self._diagnostics = publisher(DiagnosticArray, "/diagnostics", 10)
        # In a group of its own: samples must be processed while it waits for its end.
        own_group = ReentrantCallbackGroup()
        self.create_service(
            Trigger, "~/tare", self._serve_tare, callback_group=own_group
        )
        self.create_service(Trigger, "~/begin_insertion", self._serve_begin)
        self.create_timer(REPORT_PERIOD_S, self._publish_reports)
        self.create_timer(SILENCE_STEP_S, self._watch_silence)

    def _subscribe(self) -> None:
        """Subscribe to joint states, with external torques if they are used."""
        policy = ReliabilityPolicy
        reliability = policy.RELIABLE if self.value("reliable") else policy.BEST_EFFORT
        quality = QoSProfile(depth=self.value("queue_depth"), reliability=reliability)
        torque_topic = self.value("external_torque_topic")
        if not torque_topic:
            self._update = self._session.update
            self._subscription = self.create_subscription(
                JointState, "joint_states", self._take_joint_states, quality
            )
            return
        self._update = self._session.update_external_torque
        require_ros("message_filters")
        filters = import_module("message_filters")
        topics = [
            filters.Subscriber(self, JointState, topic, qos_profile=quality)
            for topic in ("joint_states", torque_topic)
        ]
        # So many states wait for a torque of their stamp.
        pairs = filters.TimeSynchronizer(topics, 200)
        pairs.registerCallback(self._take_with_torque)

    # Samples

    def _take_joint_states(self, message: Any) -> None:
        """Process a joint state, and those that wait behind it.

        What the executor does between two callbacks takes as long as an update.
        """
        self._take_joint_state(message)
        max_taken = 50  # before services and timers have their turn
        for _ in range(max_taken):
            with self._subscription.handle:
                taken = self._subscription.handle.take_message(JointState, False)
            if taken is None:
                return
            self._take_joint_state(taken[0])

    def _take_with_torque(self, message: Any, torque: Any) -> None:
        """Process a joint state with the external torques of its stamp."""
        torques_Nm = dict(zip(torque.name, torque.effort, strict=False))
        message.effort = [torques_Nm.get(name, np.nan) for name in message.name]
        self._take_joint_state(message)

    def _take_joint_state(self, message: Any) -> None:
        """Update the session with a joint state, and publish its estimate."""
        sample = self._reader.read(message)
        if sample is None or sample.tau_Nm is None:
            return
        self._is_silent = False
        self._heard_s = time.monotonic()
        if not self._is_active:
            return
        estimate = self._update(
            sample.q_rad, sample.dq_rad_s, sample.tau_Nm, sample.dt_s
        )
        self._estimate = estimate
        self._stamp_ns = self._reader.stamp_ns
        self._publish_forces(estimate)
        delay_ns = self._now_ns() - self._stamp_ns
        self._delay_max_ns = max(self._delay_max_ns, delay_ns)
        self._publish_events(estimate)
        if self._tare.after(self._session, estimate):
            self._end_tare()

    # Outputs

    def _publish_forces(self, estimate: SessionEstimate) -> None:
        """Publish the wrench of a valid sample, and the tip force of a usable one."""
        if estimate.status is Status.REJECTED:
            return
        self._wrench.publish(
            self._wrench_of(estimate.wrench.force, estimate.wrench.torque)
        )
        if not estimate.used_for_identification:
            return
        force_N = -estimate.identification.tip_force_N * self._axis
        self._tip.publish(self._wrench_of(force_N, np.zeros(3)))
        self._depth.publish(Float64(data=float(estimate.depth_m)))

    def _wrench_of(self, force_N: Array, torque_Nm: Array) -> Any:
        """Return a message of the latest sample's stamp at the tip."""
        message = self._message
        _fill_stamp(message, self._stamp_ns)
        message.header.frame_id = self._frame
        _fill_vector(message.wrench.force, force_N)
        _fill_vector(message.wrench.torque, torque_Nm)
        return message

    def _publish_events(self, estimate: SessionEstimate) -> None:
        """Publish what happened with this sample."""
        for event in session_events(estimate):
            report = NamedReport(
                event.kind,
                WARNING if event in estimate.plan_events else OK,
                event.text,
                {name: format_value(value) for name, value in event.values.items()},
            )
            self._publish_event(report)

    def _publish_event(self, report: NamedReport) -> None:
        """Publish an event, and its sentence as a log message."""
        self._publish_named(self._events, [report], self._stamp_ns)
        logger = self.get_logger()
        log = logger.info if report.level == OK else logger.warning
        log(report.message)

    def _publish_named(
        self, publisher: Any, reports: Sequence[NamedReport], stamp_ns: int
    ) -> None:
        """Publish reports as a `diagnostic_msgs/DiagnosticArray`."""
        message = DiagnosticArray()
        _fill_stamp(message, stamp_ns)
        message.status = [
            DiagnosticStatus(
                level=bytes([report.level]),  # a constant of type `byte`
                name=report.name,
                message=report.message,
                hardware_id=self._hardware,
                values=[
                    KeyValue(key=key, value=value)
                    for key, value in report.values.items()
                ],
            )
            for report in reports
        ]
        publisher.publish(message)

    # Diagnostics

    @property
    def _silent_s(self) -> float:
        """Time since the latest joint state [s]."""
        return time.monotonic() - self._heard_s

    def _watch_silence(self) -> None:
        """Report at once that joint states stay away; the timer calls it."""
        has_come = self._reader.counts["used"] > 0
        is_late = self._silent_s > self.value("silence_s")
        if self._is_silent or not (has_come and is_late):
            return
        self._is_silent = True
        self.get_logger().error(f"joint states silent {self._silent_s:.1f} s")
        self._publish_reports()

    def _publish_reports(self) -> None:
        """Publish diagnostics and layers; the timer calls it."""
        name = self.get_fully_qualified_name().lstrip("/")
        health = NamedReport(name, *self._judge(), self._list_values())
        reports = [health, *plan_reports(name, self._estimate)]
        self._publish_named(self._diagnostics, reports, self._now_ns())
        layers = layer_reports(self._session.layers)
        self._publish_named(self._layers, layers, self._stamp_ns)

    def _judge(self) -> tuple[int, str]:
        """Return what keeps the node from estimating, or makes estimates worse."""
        if self._reader.problem:
            return ERROR, self._reader.problem
        if self._silent_s > self.value("silence_s"):
            return ERROR, f"silent {self._silent_s:.1f} s"
        if self._tare.is_running:
            return WARNING, "a tare is under way"
        if not self._session.tared:
            return WARNING, NOT_TARED
        estimate = self._estimate
        if estimate is None or not estimate.warnings:
            return OK, "ok"
        return WARNING, f"{estimate.warnings}: {estimate.wrench.message}"

    def _list_values(self) -> dict[str, str]:
        """Return counts and the latest numbers by name."""
        values: dict[str, float | str] = {
            "used": 0,
            **self._reader.counts,
            "rejected": self._session.rejected,
            "longest_gap_s": max(self._reader.longest_gap_s, self._silent_s),
            "delay_max_s": self._delay_max_ns / NS_PER_S,
            "estimator_lag_s": self._session.lag_s,
            "tared": self._session.tared,
        }
        self._delay_max_ns = 0
        estimate = self._estimate
        if estimate is not None:
            values |= {
                "depth_m": estimate.depth_m,
                "layer": estimate.identification.layer,
                "axial_std_N": estimate.wrench.axial_std,
                "status": str(estimate.status),
                "warnings": str(estimate.warnings or "none"),
            }
        return {name: format_value(value) for name, value in values.items()}

    def _now_ns(self) -> int:
        """Return the time on the node's clock, simulated where it is [ns]."""
        return self.get_clock().now().nanoseconds

    # Services

    async def _serve_tare(self, _request: Any, response: Any) -> Any:
        """Tare beside the samples that follow; answer when it has ended."""
        if self._tare.is_running:
            return _fill_answer(response, "a tare is under way already")
        # A second tare is of motion that is recorded from now on.
        recording_s = self.value("tare_recording_s") if self._session.tared else 0.0
        self._tare.start(self._session, recording_s=recording_s)
        if not self._tare.is_running:
            return _fill_answer(response, self._tare_refusal)
        self._tare_end = Future()
        return _fill_answer(response, await self._tare_end, "tared")

    def _end_tare(self) -> None:
        """Publish how the tare has ended, and let the service that waits answer."""
        report = NamedReport("tared", OK, "tared", {})
        if refusal := self._tare_refusal:
            report = NamedReport("tare_refused", WARNING, refusal, {})
        self._publish_event(report)
        self._tare_end.set_result(refusal)

    @property
    def _tare_refusal(self) -> str:
        """Why the latest tare was refused; empty if it was not."""
        error = self._tare.refusal
        return "" if error is None else f"{error}; {error.advice}"

    def _serve_begin(self, _request: Any, response: Any) -> Any:
        """Count depth from here and forget the layers."""
        if self._tare.is_running:
            return _fill_answer(response, "a tare is under way: wait for its answer")
        if not self._session.tared:
            return _fill_answer(response, NOT_TARED)
        self._session.begin_insertion()
        self._publish_event(
            NamedReport("insertion_begun", OK, "an insertion begins here", {})
        )
        return _fill_answer(response, "", "depth counts from here")


def _fill_answer(response: Any, refusal: str, message: str = "") -> Any:
    """Write into the response of a service why it is refused, or what was done."""
    response.success = not refusal
    response.message = refusal or message
    return response


def _fill_stamp(message: Any, stamp_ns: int) -> None:
    """Write the time stamp of a message's header."""
    message.header.stamp.sec = stamp_ns // NS_PER_S
    message.header.stamp.nanosec = stamp_ns % NS_PER_S


def _fill_vector(vector: Any, values: Array) -> None:
    """Write the components x, y and z of a message."""
    vector.x = float(values[0])
    vector.y = float(values[1])
    vector.z = float(values[2])


def run_node(
    arguments: Sequence[str],
    make_robot: MakeRobot,
    prepare: Callable[[InsertionSession], None] = lambda session: None,
) -> None:
    """Run the node until Ctrl-C, SIGTERM or its transition `shutdown`.

    Args:
        arguments: Of ROS 2, such as ``--ros-args -p queue_depth:=100``.
        make_robot: Makes the arm.
        prepare: Called with the session once: lets it follow a plan.

    Raises:
        Ros2ParameterError: A parameter is unknown or cannot be.
    """
    rclpy.init(args=list(arguments))
    try:
        _spin(NeedleNode(make_robot, prepare))
    finally:
        rclpy.try_shutdown()


def _spin(node: NeedleNode) -> None:
    """Serve the node until it is stopped or shut down."""
    try:
        if node.value("autostart"):
            node.trigger_configure()
            if node.failure is not None:
                raise node.failure
            node.trigger_activate()
            node.get_logger().info("ready")
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        while not node.is_stopped:
            executor.spin_once()
        # The answer to who shut it down is on its way.
        executor.spin_once(timeout_sec=REPORT_PERIOD_S)
    except (KeyboardInterrupt, ExternalShutdownException):
        return
    except RuntimeError:  # a signal ends the context in the midst of an update
        if rclpy.ok():
            raise
