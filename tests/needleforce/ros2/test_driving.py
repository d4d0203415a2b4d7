"""An arm that a velocity controller of ros2_control moves, simulated.

The same with the user's rclpy, between two contexts, where this Python has it.
"""

import json
import os
import threading
import time
from importlib.util import find_spec
from types import SimpleNamespace

import numpy as np
import pytest

import urdf
from needleforce.cli import main
from needleforce.devices import DeviceSettingError, LinkError
from needleforce.devices.guard import Guard
from needleforce.ros2 import arm as arm_file
from needleforce.ros2 import velocity_controller
from needleforce.ros2.arm import Ros2Arm
from needleforce.ros2.ros_modules import import_ros
from tests.needleforce.ros2.fake_ros import Graph, Message, fake_ros

ROBOT = urdf.load_lwr()
JOINTS = ROBOT.joint_names
NAME = "/forward_velocity_controller"
SPEED_rad_s = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7])


def joint_state():
    """A state of a joint_state_broadcaster."""
    sec, nanosec = divmod(time.monotonic_ns(), 10**9)
    return Message(
        header=SimpleNamespace(stamp=SimpleNamespace(sec=sec, nanosec=nanosec)),
        name=list(JOINTS),
        position=[0.0] * 7,
        velocity=[0.0] * 7,
        effort=[0.0] * 7,
    )


def parameters(joints=JOINTS[::-1], interface="velocity"):
    """What a controller says of itself."""
    values = {
        "joints": SimpleNamespace(string_array_value=list(joints)),
        "interface_name": SimpleNamespace(string_value=interface),
    }
    return lambda request: SimpleNamespace(values=[values[request.names[0]]])


@pytest.fixture
def graph(monkeypatch):
    """A controller, whose joints stand in reverse order, that listens."""
    graph = Graph()
    graph.services[f"{NAME}/get_parameters"] = parameters()
    graph.callbacks[f"{NAME}/commands"].append(lambda message: None)
    monkeypatch.setattr(arm_file, "import_ros", lambda: fake_ros(graph))
    return graph


def open_arm():
    return Ros2Arm("/joint_states", JOINTS, takes_commands=True, robot=ROBOT)


def heard_arm(graph):
    """An arm that was heard just now."""
    arm = open_arm()
    graph.put("/joint_states", joint_state())
    assert next(iter(arm)).accepts_commands
    return arm


def commands(graph):
    """What was sent, in the order of the arm's joints; shape (m, 7)."""
    sent = [message.data for message in graph.published[f"{NAME}/commands"]]
    return np.array(sent).reshape(-1, 7)[:, ::-1]


def wait_for_rest(graph):
    end_s = time.monotonic() + 10.0
    while not graph.published[f"{NAME}/commands"] or commands(graph)[-1].any():
        assert time.monotonic() < end_s
        time.sleep(0.01)


def test_a_velocity_goes_to_the_joints_of_the_controller_by_name(graph):
    with heard_arm(graph) as arm:
        end_s = time.monotonic() + 10.0
        while not (commands(graph)[-1:] == SPEED_rad_s).all(axis=-1).any():
            graph.put("/joint_states", joint_state())
            next(iter(arm))
            assert arm.send(SPEED_rad_s)
            assert time.monotonic() < end_s
            time.sleep(0.01)


def test_a_velocity_is_reached_and_left_within_the_limits(graph):
    with heard_arm(graph) as arm:
        arm.send(SPEED_rad_s)  # once: it holds for 50 ms
        wait_for_rest(graph)
    sent_rad_s = commands(graph)

    assert sent_rad_s.max() > 0.1
    assert sent_rad_s.min() == 0.0
    assert_within_limits(sent_rad_s)


def assert_within_limits(sent_rad_s):
    """10 rad/s2 and 5,000 rad/s3 in cycles of 2 ms."""
    changes_rad_s = np.diff(sent_rad_s, axis=0, prepend=np.zeros((2, 7)))

    assert np.abs(changes_rad_s).max() <= 0.02
    assert np.abs(np.diff(changes_rad_s, axis=0)).max() <= 0.02


def wait_until_sent(graph):
    """Wait until a velocity was sent."""
    end_s = time.monotonic() + 10.0
    while not graph.published[f"{NAME}/commands"]:
        assert time.monotonic() < end_s
        time.sleep(0.002)


def test_the_arm_is_braked_to_rest_at_the_end(graph, monkeypatch):
    monkeypatch.setattr(velocity_controller, "MAX_BRAKE_S", 60.0)  # of a busy machine
    with heard_arm(graph) as arm:
        arm.send(SPEED_rad_s)
        wait_until_sent(graph)
    sent_rad_s = commands(graph)

    assert not sent_rad_s[-1].any()
    assert_within_limits(sent_rad_s)
    assert not arm.send(SPEED_rad_s)


def test_the_arm_is_braked_to_rest_where_a_program_fails(graph):
    def run():
        with heard_arm(graph) as arm:
            arm.send(SPEED_rad_s)
            wait_until_sent(graph)
            raise KeyError

    with pytest.raises(KeyError):
        run()

    assert not commands(graph)[-1].any()


def test_zero_is_the_last_where_sending_fails(graph, monkeypatch):
    arm = heard_arm(graph)
    arm.send(SPEED_rad_s)
    wait_until_sent(graph)
    monkeypatch.setattr(threading, "excepthook", lambda failure: None)
    monkeypatch.setattr(Guard, "advance", lambda self, place_rad: 1 / 0)
    wait_for_rest(graph)

    assert not arm.send(SPEED_rad_s)
    arm.close()


@pytest.mark.parametrize(
    "velocity",
    [np.full(7, np.nan), np.zeros(6), "fast", np.r_[np.zeros(6), 100.0]],
)
def test_a_velocity_that_cannot_be_is_not_sent(graph, velocity):
    arm = heard_arm(graph)

    assert not arm.send(velocity)
    arm.close()
    assert not graph.published[f"{NAME}/commands"]


def test_an_arm_that_is_not_heard_takes_no_velocity(graph, monkeypatch):
    arm = open_arm()
    assert not arm.send(SPEED_rad_s)
    graph.put("/joint_states", joint_state())
    next(iter(arm))
    time.sleep(0.15)

    assert not arm.send(SPEED_rad_s)
    assert "no joint state" in arm.refusal

    graph.put("/joint_states", joint_state())
    next(iter(arm))

    assert not arm.send(SPEED_rad_s)
    assert "after an interruption" in arm.refusal
    assert arm.send(0.05 * SPEED_rad_s)
    arm.close()


def test_an_arm_that_is_listened_to_takes_no_velocity(graph):
    arm = Ros2Arm("/joint_states", JOINTS)
    graph.put("/joint_states", joint_state())

    assert not next(iter(arm)).accepts_commands
    assert not arm.send(SPEED_rad_s)
    arm.close()


@pytest.mark.parametrize(
    ("answer", "text"),
    [
        (parameters(interface="position"), "commands position; expected a controller"),
        (parameters(JOINTS[:6]), "lwr_joint_1, .*; expected those of the arm"),
        (parameters(["a"] * 7), "moves a, a, "),
    ],
)
def test_a_controller_of_something_else_is_refused(graph, answer, text):
    graph.services[f"{NAME}/get_parameters"] = answer

    with pytest.raises(DeviceSettingError, match=text):
        open_arm()


def test_a_controller_that_is_not_there_is_named(graph):
    graph.services.clear()

    with pytest.raises(LinkError, match=NAME) as info:
        open_arm()
    assert "activate" in info.value.advice


def test_the_limits_are_those_of_the_model_or_of_an_arm_by_name(graph):
    with open_arm() as arm:
        assert arm.limits.joints.speed_rad_s.max() <= 0.5
    with Ros2Arm("/joint_states", JOINTS, robot=ROBOT, preset="fr3") as arm:
        assert arm.limits.rates.cycle_s == 1e-3  # of an FR3
    for preset, words in (("fr4", "expected one of fr3"), ("ur5e", "of 6 joints")):
        with pytest.raises(DeviceSettingError, match=words):
            Ros2Arm("/joint_states", JOINTS, robot=ROBOT, preset=preset)


def test_a_controller_that_goes_ends_the_motion(graph):
    """When it is back the arm begins from rest, slowly."""
    arm = heard_arm(graph)
    arm.send(SPEED_rad_s)
    wait_until_sent(graph)
    listeners = list(graph.callbacks[f"{NAME}/commands"])
    graph.callbacks[f"{NAME}/commands"].clear()
    wait_for_rest(graph)

    assert not arm.send(SPEED_rad_s)
    assert "does not listen" in arm.refusal

    graph.callbacks[f"{NAME}/commands"] += listeners

    assert not arm.send(SPEED_rad_s)
    assert arm.send(0.05 * SPEED_rad_s)
    arm.close()


def test_an_arm_without_a_model_is_not_driven(graph):
    with pytest.raises(DeviceSettingError, match="takes_commands without robot"):
        Ros2Arm("/joint_states", JOINTS, takes_commands=True)


class SimulatedController:
    """A node that integrates the velocity that came last, for ever, at 100 Hz."""

    def __init__(self, ros):
        self.ros = ros
        self.context = ros.rclpy.Context()
        self.context.init(args=[])
        node = ros.rclpy.create_node(NAME[1:], context=self.context)
        node.declare_parameter("joints", list(JOINTS[::-1]))
        node.declare_parameter("interface_name", "velocity")
        self.node = node
        self.q_rad = np.zeros(7)
        self.velocities = [np.zeros(7)]
        kind = ros.standard.Float64MultiArray
        node.create_subscription(kind, "~/commands", self.take, 10)
        self.states = node.create_publisher(ros.sensor.JointState, "joint_states", 10)
        node.create_timer(0.01, self.step)
        self.executor = ros.executors.SingleThreadedExecutor(context=self.context)
        self.executor.add_node(node)
        self.thread = threading.Thread(target=self.executor.spin, daemon=True)
        self.thread.start()

    def take(self, message):
        self.velocities.append(np.array(message.data)[::-1])

    def step(self):
        self.q_rad = self.q_rad + 0.01 * self.velocities[-1]
        message = self.ros.sensor.JointState(name=list(JOINTS))
        now_ns = self.node.get_clock().now().nanoseconds
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(now_ns, 10**9)
        message.position = self.q_rad.tolist()
        message.velocity = self.velocities[-1].tolist()
        message.effort = [0.0] * 7
        self.states.publish(message)

    def close(self):
        self.executor.shutdown()
        self.context.try_shutdown()
        self.thread.join()


@pytest.mark.slow
@pytest.mark.skipif(find_spec("rclpy") is None, reason="no rclpy: source a ROS 2")
def test_the_delay_of_an_arm_of_ros_2_is_measured(monkeypatch, capsys):
    monkeypatch.setenv("ROS_DOMAIN_ID", str(50 + os.getpid() % 150))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    controller = SimulatedController(import_ros())
    try:
        command = ["lag", "ros2:/joint_states", "--robot", "lwr", "--yes", "--json"]
        # On a busy machine states stay away for 0.1 s, and a command is refused.
        assert any(main(command) == 0 for _ in range(3))
    finally:
        controller.close()
    result = json.loads(capsys.readouterr().out)

    # States come every 10 ms, and the controller moves after the one that it sends; how
    # much later depends on what else the machine does.
    assert result["cycle_ms"] == pytest.approx(10.0, abs=0.5)
    for joint in result["joints"]:
        assert joint["delay_ms"] > 5.0
        assert joint["followed"] == pytest.approx(1.0, abs=0.2)
    assert not controller.velocities[-1].any()


@pytest.mark.slow
@pytest.mark.skipif(find_spec("rclpy") is None, reason="no rclpy: source a ROS 2")
def test_an_arm_moves_and_stops_through_ros_2(monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", str(50 + os.getpid() % 150))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    controller = SimulatedController(import_ros())
    # A second with commands, three without.
    positions_rad = []
    with open_arm() as arm:
        for number, reading in enumerate(arm):
            positions_rad.append(reading.q_rad)
            if number < 100:
                arm.send(SPEED_rad_s)
            if number == 400:
                break
    time.sleep(0.5)
    last_rad_s = controller.velocities[-1]
    controller.close()
    moved_rad = positions_rad[-1] - positions_rad[0]

    assert not last_rad_s.any()
    assert np.ptp(positions_rad[-20:], axis=0).max() == 0.0
    # A second, less the time until the first was taken.
    assert (moved_rad > 0.5 * SPEED_rad_s).all()
    assert np.allclose(moved_rad / moved_rad[0], SPEED_rad_s / 0.1, rtol=0.2)
