"""What the node publishes and answers, without rclpy."""

import json
import sys
import time
from importlib import import_module
from types import SimpleNamespace

import pytest

import urdf
from needleforce import InsertionSession
from needleforce.cli import main
from needleforce.ros2 import MissingRosError, Ros2ParameterError, require_ros
from tests.insertion_run import short_run
from tests.needleforce.ros2.fake_ros import (
    Graph,
    Message,
    installed_ros,
    joint_state_of,
)
from tests.needleforce.ros2.layouts import (
    FOLDER,
    RVIZ_TYPES,
    foxglove_topics,
    read_yaml,
    rviz_topics,
)

JOINTS = short_run().robot.joint_names
LWR = urdf.example_robot_path("lwr4plus")


@pytest.fixture
def graph():
    """A ROS in which nothing was said yet."""
    with installed_ros(Graph()) as graph:
        yield graph


def start(graph, robot=None, **parameters):
    """A node that was configured and activated."""
    graph.parameters |= parameters
    node_type = import_module("needleforce.ros2.node").NeedleNode
    node = node_type(lambda wait: robot or short_run().robot, lambda session: None)
    node.on_configure(None)
    node.on_activate(None)
    if node.failure is not None:
        raise node.failure
    return node


def state(at_s, names=JOINTS):
    return joint_state_of(names, at_s)


@pytest.fixture
def updates(monkeypatch):
    """Arguments of every update of a session."""
    given = []
    original = InsertionSession.update

    def update(self, *arguments):
        given.append(arguments)
        return original(self, *arguments)

    monkeypatch.setattr(InsertionSession, "update", update)
    return given


# Samples and silence


def health(graph):
    """Level, sentence and values of the latest diagnostics."""
    status = graph.published["/diagnostics"][-1].status[0]
    return status.level[0], status.message, {v.key: v.value for v in status.values}


def test_silence_of_the_arm_is_reported_within_a_tenth_of_a_second(graph, updates):
    node = start(graph)
    step_s = min(graph.timers)
    watch = graph.timers[step_s]
    time.sleep(2.0 * node.value("silence_s"))
    watch()
    assert not graph.published["/diagnostics"]  # it has not come yet

    graph.put("/joint_states", state(1.0))
    graph.deliver()
    watch()
    assert not graph.published["/diagnostics"]

    end_s = time.monotonic() + 10.0
    while not graph.published["/diagnostics"]:
        assert time.monotonic() < end_s
        graph.put("/joint_states", state(1.1, ["finger"]))  # is not the arm
        graph.deliver()
        watch()
        time.sleep(step_s)
    # Of the limit and the period of the timer, not of this machine.
    assert node.value("silence_s") + step_s < 0.1
    level, message, values = health(graph)
    assert (level, "silent" in message) == (2, True)
    assert float(values["longest_gap_s"]) >= node.value("silence_s")
    assert values["other_joints"] != "0"

    graph.put("/joint_states", state(1.4))
    graph.deliver()
    watch()
    assert len(graph.published["/diagnostics"]) == 1
    assert [round(given[-1], 6) for given in updates] == [0.0, 0.4]
    max(graph.timers.items())[1]()
    level, message, values = health(graph)
    assert (level, "not tared" in message) == (1, True)
    assert float(values["longest_gap_s"]) == pytest.approx(0.4)
    assert values["used"] == "2"


def test_a_node_that_is_not_active_passes_joint_states_by(graph, updates):
    node = start(graph)
    node.on_deactivate(None)
    graph.put("/joint_states", state(1.0))
    graph.deliver()

    assert not updates

    node.on_activate(None)
    graph.put("/joint_states", state(1.001))
    graph.deliver()

    assert len(updates) == 1
    [wrench] = graph.published["/needleforce/wrench"]
    assert wrench.header.frame_id == short_run().robot.tool_frame
    assert (wrench.header.stamp.sec, wrench.header.stamp.nanosec) == (1, 10**6)


def test_external_torques_are_joined_by_name(graph, monkeypatch):
    joined = []
    synchronizer = SimpleNamespace(registerCallback=joined.append)
    filters = SimpleNamespace(
        Subscriber=lambda *_, **__: None, TimeSynchronizer=lambda *_: synchronizer
    )
    monkeypatch.setitem(sys.modules, "message_filters", filters)
    given = []
    monkeypatch.setattr(
        InsertionSession,
        "update_external_torque",
        lambda self, *arguments: given.append(arguments) or self.update(*arguments),
    )
    start(graph, external_torque_topic="/torques")
    efforts_Nm = [10.0, 11.0, 12.0, 13.0, 14.0, 15.0, 16.0]
    torque = Message(name=list(JOINTS[::-1]), effort=efforts_Nm[::-1])
    joined[0](state(1.0), torque)

    assert given[0][2].tolist() == efforts_Nm


def test_an_arm_that_never_came_is_an_error_in_the_diagnostics(graph):
    start(graph)
    max(graph.timers.items())[1]()

    assert health(graph)[:2] == (2, "no joint state has come")


def test_what_the_arm_is_comes_from_the_topic_of_its_description(graph):
    with open(LWR, encoding="utf-8") as file:
        graph.put("/robot_description", Message(data=file.read()))
    node_type = import_module("needleforce.ros2.node").NeedleNode
    texts = []

    def make_robot(wait):
        texts.append(wait())
        return short_run().robot

    assert node_type(make_robot, lambda session: None).on_configure(None).name == (
        "SUCCESS"
    )
    assert "<robot" in texts[0]


def test_a_manager_gets_an_answer_where_no_description_comes(graph):
    graph.parameters["autostart"] = False
    node_type = import_module("needleforce.ros2.node").NeedleNode
    node = node_type(lambda wait: wait(), lambda session: None)

    assert node.on_configure(None).name == "FAILURE"
    assert "/robot_description" in str(node.failure)
    assert "robot_state_publisher" in node.failure.advice


def test_a_parameter_that_does_not_exist_is_refused(graph):
    with pytest.raises(Ros2ParameterError, match="queue_deph"):
        start(graph, queue_deph=4)


# Events, layers, services


def test_an_insertion_begins_only_after_a_tare(graph):
    start(graph)
    answer = graph.services["~/begin_insertion"](None, Message())

    assert answer.success is False
    assert "~/tare" in answer.message


def test_a_missing_ros_is_an_error_that_names_it(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "rclpy", None)

    with pytest.raises(MissingRosError, match="rclpy"):
        require_ros()
    for command in (["ros2"], ["live", "ros2:/joint_states"]):
        assert main([*command, "--robot", "lwr"]) == 2
        assert "rclpy" in capsys.readouterr().err


# Files of examples/ros2


@pytest.mark.parametrize("name", ["foxglove.json", "needleforce.rviz"])
def test_layouts_show_topics_of_the_node_by_their_types(graph, name):
    start(graph, urdf.load_lwr(payload=urdf.NeedleTool()))
    types = graph.kinds | {"/rosout": "Log", "/robot_description": "String"}
    if name.endswith("json"):
        topics = foxglove_topics(json.loads((FOLDER / name).read_bytes()))
    else:
        topics = rviz_topics(read_yaml(name))

    assert {"/needleforce/wrench", "/needleforce/tip_force"} <= set(topics)
    for topic, use in topics.items():
        assert types.get(topic) == RVIZ_TYPES[use], topic


def test_the_parameters_of_the_launch_file_are_the_defaults_of_the_node(graph):
    parameters = import_module("needleforce.ros2.parameters").PARAMETERS
    given = read_yaml("parameters.yaml")["needleforce"]["ros__parameters"]

    assert given == {name: default for name, (default, _) in parameters.items()}
