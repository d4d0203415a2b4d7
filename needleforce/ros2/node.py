"""The node: joint states in; wrench, tip force, layers, events and diagnostics out."""

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from needleforce.insertion_events import session_events
from needleforce.ros2.errors import Ros2ParameterError
from needleforce.ros2.joint_samples import (
    JointReader,
    JointSample,
    TorquePairing,
)
from needleforce.ros2.message_loss import (
    DelayMeter,
    LossCounter,
    identify_sender,
)
from needleforce.ros2.messages import (
    fill_stamp,
    fill_vector,
    read_joint_state,
    read_lbr_state,
    report_array,
)
from needleforce.ros2.named_report import OK, WARNING, NamedReport, format_value
from needleforce.ros2.parameters import (
    PARAMETERS,
    NodeParameter,
    NodeSettings,
    settings_from_values,
)
from needleforce.ros2.reports import (
    EVENT_NUMBERS,
    NodeHealth,
    layer_reports,
    plan_reports,
)
from needleforce.ros2.ros_modules import RosModules, import_lbr_state
from needleforce.ros2.tip_frame import place_tip, tip_transforms
from needleforce.ros2.warming import warm_up
from needleforce.session import InsertionSession, SessionEstimate
from needleforce.tare_run import TareRun
from residual import SensorConfig, Status
from urdf import Robot

MAX_TAKEN = 50
"""Joint states that are taken before services and timers have their turn."""

LBR_JOINTS = 7

REPORT_PERIOD_S = 1.0
"""Time between two messages of diagnostics and layers [s]."""

SILENCE_STEP_S = 0.01
"""Time between two looks at whether joint states still come [s]."""

ROS_OWN_PREFIXES = ("qos_overrides.",)
ROS_OWN_PARAMETERS = ("use_sim_time", "start_type_description_service")
"""Parameters that every node has."""


class NeedleNode:
    """A session fed by joint states.

    Every valid sample is answered by a wrench with its stamp, in the tool frame, at the
    needle's tip; while it is tared and usable, also by the force at the tip.

    Args:
        ros: The modules of ROS 2.
        node: The node that has the topics, services and timer.
        robot: The arm.
        settings: Values of the node's parameters.
        prepare: Called with the session once: lets it follow a plan.

    Attributes:
        is_stopped: Whether the service `~/stop` was called.
        is_active: Whether joint states are used; else they are passed by.
        loss: Counts of messages on their way.
    """

    def __init__(
        self,
        ros: RosModules,
        node: Any,
        robot: Robot,
        settings: NodeSettings,
        prepare: Callable[[InsertionSession], None] = lambda session: None,
    ) -> None:
        config = SensorConfig(
            gain_per_s=settings.gain_per_s,
            axes="tool",
            torque_is_gravity_compensated=settings.gravity_compensated,
        )
        lbr_topic = settings.lbr_state_topic
        if lbr_topic and robot.nv != LBR_JOINTS:
            raise Ros2ParameterError(
                f"lbr_state_topic is {lbr_topic}, of an arm with {LBR_JOINTS} joints, "
                f"and the robot's description has {robot.nv}; expected the "
                "description of the LBR, with other joints locked (--lock-others)"
            )
        warm_up(robot, config)
        self.is_stopped = False
        self.is_active = True
        self.loss = LossCounter()
        self._ros = ros
        self._node = node
        self._logger = node.get_logger()
        self._settings = settings
        self._hardware = robot.model.name
        self._session = InsertionSession(robot, config)
        prepare(self._session)
        self._axis = np.array(config.insertion_axis)
        self._needs_pairing = bool(settings.external_torque_topic)
        self._is_external = self._needs_pairing or bool(lbr_topic)
        self._read_message = read_joint_state
        if lbr_topic:
            self._read_message = partial(read_lbr_state, joints=robot.joint_names)
        self._reader = JointReader(
            robot.joint_names,
            "" if lbr_topic else settings.joint_pattern,
            needs_effort=not self._needs_pairing,
        )
        self._pairing = TorquePairing(robot.joint_names, self._reader.counts)
        self._tare = TareRun()
        self._tare_end: Any = None
        self._delay = DelayMeter()
        self._estimate: SessionEstimate | None = None
        self._stamp_ns = 0
        self._heard_s = time.monotonic()
        self._is_silent = False
        self._lost_before = 0
        self._frame = settings.frame_id or robot.tool_frame
        self._advertise()
        if settings.broadcast_tip:
            self._broadcast_tip(robot)
        self._subscribe()

    def _advertise(self) -> None:
        """Make the outputs and the services."""
        ros = self._ros
        node = self._node
        # Messages of an output that wait for a slow subscriber: a second at 1 kHz.
        output_depth = 1000
        reliable = ros.qos.QoSProfile(depth=output_depth)
        # Events that a subscriber gets who comes later.
        event_depth = 100
        kept = ros.qos.QoSProfile(
            depth=event_depth, durability=ros.qos.DurabilityPolicy.TRANSIENT_LOCAL
        )
        latest = ros.qos.QoSProfile(
            depth=1, durability=ros.qos.DurabilityPolicy.TRANSIENT_LOCAL
        )
        wrench_type = ros.geometry.WrenchStamped
        array_type = ros.diagnostic.DiagnosticArray
        self._wrench = node.create_publisher(wrench_type, "~/wrench", reliable)
        self._tip = node.create_publisher(wrench_type, "~/tip_force", reliable)
        self._events = node.create_publisher(array_type, "~/events", kept)
        self._layers = node.create_publisher(array_type, "~/layers", latest)
        self._diagnostics = node.create_publisher(array_type, "/diagnostics", 10)
        number_type = ros.standard.Float64
        self._depth = node.create_publisher(number_type, "~/depth_m", reliable)
        self._numbers = {
            (kind, name): node.create_publisher(number_type, f"~/{kind}/{name}", kept)
            for kind, names in EVENT_NUMBERS.items()
            for name in names
        }
        self._wrench_message = wrench_type()
        self._wrench_message.header.frame_id = self._frame
        self._tip_message = wrench_type()
        self._tip_message.header.frame_id = self._frame
        trigger = ros.services.Trigger
        # In a group of its own: samples must be processed while it waits for its end.
        own_group = ros.callback_groups.ReentrantCallbackGroup()
        node.create_service(
            trigger, "~/tare", self._serve_tare, callback_group=own_group
        )
        node.create_service(trigger, "~/begin_insertion", self._serve_begin)
        node.create_service(trigger, "~/stop", self._serve_stop)
        node.create_timer(REPORT_PERIOD_S, self._publish_reports)
        node.create_timer(SILENCE_STEP_S, self._watch_silence)
        node.add_on_set_parameters_callback(self._check_changes)

    def _broadcast_tip(self, robot: Robot) -> None:
        """Publish where the tip is, unless the arm's description has it as a link."""
        tip = place_tip(robot, self._frame)
        if tip is None:
            return
        if self._ros.transforms is None:
            self._logger.warning(
                f"the frame {self._frame} is not broadcast: tf2_msgs is not installed"
            )
            return
        latest = self._ros.qos.QoSProfile(
            depth=1, durability=self._ros.qos.DurabilityPolicy.TRANSIENT_LOCAL
        )
        publisher = self._node.create_publisher(
            self._ros.transforms.TFMessage, "/tf_static", latest
        )
        publisher.publish(tip_transforms(self._ros, tip, self._frame, self._now_ns()))

    def _subscribe(self) -> None:
        """Subscribe to joint states, and to external torques if they are used."""
        ros = self._ros
        policy = ros.qos.ReliabilityPolicy
        quality = ros.qos.QoSProfile(
            depth=self._settings.queue_depth,
            reliability=policy.BEST_EFFORT
            if self._settings.reliability == "best_effort"
            else policy.RELIABLE,
        )
        state_type = ros.sensor.JointState
        lbr_topic = self._settings.lbr_state_topic
        self._subscription = self._node.create_subscription(
            import_lbr_state() if lbr_topic else state_type,
            lbr_topic or "joint_states",
            self._take_joint_states,
            quality,
        )
        if self._needs_pairing:
            self._node.create_subscription(
                state_type,
                self._settings.external_torque_topic,
                self._take_torque,
                quality,
            )

    def _take_joint_states(self, message: Any, info: Any) -> None:
        """Process a joint state, and those that wait behind it.

        What the executor does between two callbacks takes as long as an update.
        """
        self._take_joint_state(message, info)
        subscription = self._subscription
        for _ in range(MAX_TAKEN):
            with subscription.handle:
                taken = subscription.handle.take_message(subscription.msg_type, False)
            if taken is None:
                return
            self._take_joint_state(*taken)

    def _take_joint_state(self, message: Any, info: Any) -> None:
        """Process a joint state, and publish what it gives."""
        self.loss.count(*identify_sender(info))
        sample = self._reader.read(self._read_message(message))
        if sample is not None:
            self._note_heard()
        if sample is not None and self._needs_pairing:
            sample = self._pairing.add_sample(sample)
        if sample is not None:
            self._process(sample)

    def _take_torque(self, message: Any) -> None:
        """Process an external torque, with the sample of its stamp."""
        sample = self._pairing.add_torque(read_joint_state(message))
        if sample is not None:
            self._process(sample)

    def _process(self, sample: JointSample) -> None:
        """Update the session with a sample, and publish its estimate."""
        torque_Nm = sample.effort_Nm
        if torque_Nm is None or not self.is_active:
            return
        update = self._session.update
        if self._is_external:
            update = self._session.update_external_torque
        estimate = update(sample.q_rad, sample.dq_rad_s, torque_Nm, sample.dt_s)
        self._estimate = estimate
        self._stamp_ns = sample.stamp_ns
        if self._settings.lbr_state_topic:
            # Its stamp is of the controller's clock, which TF does not know.
            self._stamp_ns = self._now_ns()
        self._publish_forces(estimate)
        self._delay.add(self._now_ns() - self._stamp_ns)
        self._publish_events(estimate)
        if self._tare.after(self._session, estimate):
            self._end_tare()

    def _publish_forces(self, estimate: SessionEstimate) -> None:
        """Publish the wrench of a valid sample, and the tip force of a usable one."""
        if estimate.status is Status.REJECTED:
            return
        message = self._wrench_message
        fill_stamp(message, self._stamp_ns)
        fill_vector(message.wrench.force, estimate.wrench.force)
        fill_vector(message.wrench.torque, estimate.wrench.torque)
        self._wrench.publish(message)
        if not estimate.used_for_identification:
            return
        message = self._tip_message
        fill_stamp(message, self._stamp_ns)
        force_N = -estimate.identification.tip_force_N * self._axis
        fill_vector(message.wrench.force, force_N)
        self._tip.publish(message)
        self._depth.publish(self._ros.standard.Float64(data=estimate.depth_m))

    def _publish_events(self, estimate: SessionEstimate) -> None:
        """Publish what happened with this sample, and the layers with it."""
        has_layer_events = estimate.identification.has_events
        if not (has_layer_events or estimate.plan_events):
            return
        for event in session_events(estimate):
            values = {name: format_value(v) for name, v in event.values.items()}
            level = WARNING if event in estimate.plan_events else OK
            self._publish_event(NamedReport(event.kind, level, event.text, values))
            for name, value in event.values.items():
                number = self._ros.standard.Float64(data=float(value))
                self._numbers[event.kind, name].publish(number)
        if has_layer_events:
            self._publish_layers()

    def _publish_event(self, report: NamedReport) -> None:
        """Publish an event, and its sentence as a log message."""
        self._events.publish(
            report_array(self._ros, [report], self._stamp_ns, self._hardware)
        )
        if report.level == OK:
            self._logger.info(report.message)
        else:
            self._logger.warning(report.message)

    def _publish_layers(self) -> None:
        """Publish the layers traversed so far."""
        reports = layer_reports(self._session.layers)
        self._layers.publish(
            report_array(self._ros, reports, self._stamp_ns, self._hardware)
        )

    def _publish_reports(self) -> None:
        """Publish diagnostics and layers; the timer calls it."""
        health = NodeHealth(
            session=self._session,
            reader=self._reader,
            loss=self.loss,
            estimate=self._estimate,
            silent_s=self._silent_s,
            silence_limit_s=self._settings.silence_s,
            delay_max_s=self._delay.take_max_s(),
            lost_before=self._lost_before,
            is_taring=self._tare.is_running,
        )
        self._lost_before = self.loss.lost
        name = self._node.get_fully_qualified_name().lstrip("/")
        reports = [health.report(name), *plan_reports(name, self._estimate)]
        self._diagnostics.publish(
            report_array(self._ros, reports, self._now_ns(), self._hardware)
        )
        self._publish_layers()

    def _note_heard(self) -> None:
        """Note that the arm was heard now."""
        if self._is_silent:
            self._is_silent = False
            self._logger.warning(f"joint states again after {self._silent_s:.1f} s")
        self._heard_s = time.monotonic()

    @property
    def _silent_s(self) -> float:
        """Time since the latest joint state [s]."""
        return time.monotonic() - self._heard_s

    def _watch_silence(self) -> None:
        """Report at once that joint states stay away; the timer calls it."""
        has_come = self._reader.counts.used > 0
        is_late = self._silent_s > self._settings.silence_s
        if self._is_silent or not (has_come and is_late):
            return
        self._is_silent = True
        self._logger.error(f"joint states silent {self._silent_s:.1f} s")
        self._publish_reports()

    def _now_ns(self) -> int:
        """Return the time on the node's clock, simulated where it is [ns]."""
        return self._node.get_clock().now().nanoseconds

    async def _serve_tare(self, _request: Any, response: Any) -> Any:
        """Tare beside the samples that follow; answer when it has ended."""
        if self._tare.is_running:
            return _fill_answer(response, "a tare is under way already")
        # A second tare is of motion that is recorded from now on.
        recording_s = self._settings.tare_recording_s if self._session.tared else 0.0
        self._tare.start(self._session, recording_s=recording_s)
        if not self._tare.is_running:
            return _fill_answer(response, self._tare_refusal)
        self._tare_end = self._ros.task.Future()
        return _fill_answer(response, await self._tare_end, "tared")

    def _end_tare(self) -> None:
        """Publish how the tare has ended, and let the service that waits answer."""
        refusal = self._tare_refusal
        kind = "tare_refused" if refusal else "tared"
        level = WARNING if refusal else OK
        self._publish_event(NamedReport(kind, level, refusal or "tared", {}))
        self._tare_end.set_result(refusal)

    @property
    def _tare_refusal(self) -> str:
        """Why the latest tare was refused; empty if it was not."""
        error = self._tare.refusal
        return "" if error is None else f"{error}; {error.advice}"

    def _serve_begin(self, _request: Any, response: Any) -> Any:
        """Count depth from here and forget the layers."""
        if self._tare.is_running:
            refusal = "a tare is under way: wait for its answer"
        elif not self._session.tared:
            refusal = "not tared: move in free air, then call ~/tare"
        else:
            refusal = ""
            self._session.begin_insertion()
            self._publish_event(
                NamedReport("insertion_begun", OK, "an insertion begins here", {})
            )
        return _fill_answer(response, refusal, "depth counts from here")

    def _serve_stop(self, _request: Any, response: Any) -> Any:
        """End the node; the arm is not commanded."""
        self._publish_reports()
        self.is_stopped = True
        return _fill_answer(response, "", self.describe())

    def _check_changes(self, changes: Sequence[Any]) -> Any:
        """Take changed parameters, or refuse all of them with a sentence."""
        result = self._ros.interfaces.SetParametersResult
        known = {parameter.name: parameter for parameter in PARAMETERS}
        for change in changes:
            if change.name not in known:
                continue
            problem = known[change.name].check(change.value)
            if problem:
                return result(successful=False, reason=problem)
        names = [parameter.name for parameter in PARAMETERS]
        values = {name: getattr(self._settings, name) for name in names}
        values |= {
            change.name: change.value for change in changes if change.name in values
        }
        self._settings = settings_from_values(values)
        return result(successful=True)

    def describe(self) -> str:
        """Return what has come, in one line."""
        return (
            f"{self.loss}; {self._reader.counts}; {self._session.rejected} rejected by "
            f"the session; layers traversed: {len(self._session.layers)}"
        )


def _fill_answer(response: Any, refusal: str, message: str = "") -> Any:
    """Write into the response of a service why it is refused, or what was done."""
    response.success = not refusal
    response.message = refusal or message
    return response


def declare_parameters(ros: RosModules, node: Any) -> NodeSettings:
    """Declare the node's parameters; return their values.

    Args:
        ros: The modules of ROS 2.
        node: Whose parameters that were given are declared already, whatever they are.

    Raises:
        Ros2ParameterError: One is unknown or cannot be.
    """
    given = {
        name: parameter.value
        for name, parameter in node.get_parameters_by_prefix("").items()
        if name not in ROS_OWN_PARAMETERS and not name.startswith(ROS_OWN_PREFIXES)
    }
    settings = settings_from_values(given)
    for parameter in PARAMETERS:
        if parameter.name in given:
            node.undeclare_parameter(parameter.name)
        node.declare_parameter(
            parameter.name,
            getattr(settings, parameter.name),
            _descriptor(ros, parameter),
            ignore_override=True,
        )
    return settings


def _descriptor(ros: RosModules, parameter: NodeParameter) -> Any:
    """Return description and range of a parameter as tools show them."""
    interfaces = ros.interfaces
    descriptor = interfaces.ParameterDescriptor(
        description=parameter.description,
        read_only=parameter.is_read_only,
        additional_constraints=" or ".join(parameter.choices),
    )
    limits = parameter.range
    if limits is None:
        return descriptor
    if isinstance(parameter.default, int):
        descriptor.integer_range = [
            interfaces.IntegerRange(
                from_value=int(limits.minimum), to_value=int(limits.maximum), step=1
            )
        ]
    else:
        descriptor.floating_point_range = [
            interfaces.FloatingPointRange(
                from_value=limits.minimum, to_value=limits.maximum
            )
        ]
    return descriptor
