"""What the node publishes and answers, without rclpy."""

import json
import sys
import time
from importlib import import_module

import numpy as np
import pytest

import urdf
from needleforce import InsertionSession
from needleforce.cli import main
from needleforce.insertion_events import session_events
from needleforce.ros2 import MissingRosError, Ros2ParameterError, require_ros
from needleforce.ros2.reports import EVENT_NUMBERS, layer_reports
from needleforce.ros2.tip_frame import place_tip
from tests.insertion_run import insert, short_run
from tests.needleforce.ros2.fake_ros import Graph, Message, installed_ros
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


def stamped(at_s, **fields):
    """A message with a stamp."""
    sec, nanosec = divmod(round(1e9 * at_s), 10**9)
    return Message(header=Message(stamp=Message(sec=sec, nanosec=nanosec)), **fields)


def state(at_s, names=JOINTS):
    """A joint state of an arm at rest."""
    zeros = [0.0] * len(names)
    position = [0.1] * len(names)
    return stamped(
        at_s, name=list(names), position=position, velocity=zeros, effort=zeros
    )


@pytest.fixture
def updates(monkeypatch):
    """Arguments of every update of a session."""
    given = []

    def watch(name):
        original = getattr(InsertionSession, name)

        def update(self, *arguments):
            given.append((name, *arguments))
            return original(self, *arguments)

        monkeypatch.setattr(InsertionSession, name, update)

    watch("update")
    watch("update_external_torque")
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


@pytest.mark.parametrize(
    "parameters",
    [
        {"queue_deph": 4},
        {"reliability": "maybe"},
        {"external_torque_topic": "/a", "lbr_state_topic": "/b"},
    ],
)
def test_parameters_that_cannot_be_are_refused_by_name(graph, parameters):
    with pytest.raises(Ros2ParameterError, match=next(iter(parameters))):
        start(graph, **parameters)


# LBRState of lbr_fri_ros2_stack


def lbr_state(stamp_ns):
    """As lbr_fri_idl has it: arrays of seven, and the controller's time."""
    return Message(
        time_stamp_sec=stamp_ns // 10**9,
        time_stamp_nano_sec=stamp_ns % 10**9,
        measured_joint_position=np.arange(7.0),
        measured_torque=np.full(7, 50.0),
        external_torque=10.0 + np.arange(7.0),
    )


def test_the_node_takes_positions_and_external_torques_of_an_lbr(graph, updates):
    start(graph, lbr_state_topic="/lbr/state")
    graph.put("/lbr/state", lbr_state(1_000_000_002), lbr_state(1_005_000_002))
    graph.deliver()
    name, q_rad, dq_rad_s, torque_Nm, _ = updates[0]

    assert name == "update_external_torque"
    assert [round(given[-1], 6) for given in updates] == [0.0, 0.005]
    assert q_rad.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    assert dq_rad_s is None
    assert torque_Nm.tolist() == [10.0, 11.0, 12.0, 13.0, 14.0, 15.0, 16.0]
    # The stamp is of the node's clock, which TF knows, not of the controller's.
    assert graph.published["/needleforce/wrench"][-1].header.stamp.sec == 7
    assert not graph.callbacks["/joint_states"]


def test_an_lbr_has_seven_joints(graph):
    with pytest.raises(Ros2ParameterError, match="6"):
        start(graph, urdf.load_example("ur5e"), lbr_state_topic="/lbr/state")


# Frame of the tip


def test_the_tip_is_broadcast_from_the_flange_of_the_description(graph):
    start(graph, urdf.load_lwr(payload=urdf.NeedleTool()))
    [message] = graph.published["/tf_static"]
    [transform] = message.transforms
    move = transform.transform

    assert "/tf_static" in graph.kept
    assert transform.header.frame_id == "flange"
    assert transform.child_frame_id == "needle_tip"
    assert transform.header.stamp.sec == 7
    tip_m = urdf.NeedleTool().tip_in_flange_m[2]
    assert (move.translation.x, move.translation.y) == (0.0, 0.0)
    assert move.translation.z == pytest.approx(tip_m)
    assert (move.rotation.z, move.rotation.w) == (0.0, 1.0)


@pytest.mark.parametrize("broadcasts", [True, False])
def test_the_tip_is_not_broadcast_where_tf_has_it(graph, broadcasts):
    robot = urdf.load_lwr(payload=None if broadcasts else urdf.NeedleTool())
    start(graph, robot, broadcast_tip=broadcasts)

    assert not graph.published["/tf_static"]


def test_a_tip_of_a_joint_is_on_the_link_that_the_joint_moves():
    robot = urdf.load_urdf(
        LWR, tool_frame="lwr_joint_7", tool_placement=(0.0, 0.02, 0.1)
    )
    tip = place_tip(robot, "tool")

    assert tip.parent == "lwr_link_7"
    assert tip.placement.translation.tolist() == pytest.approx([0.0, 0.02, 0.1])


# Events, layers, services


@pytest.mark.slow
def test_an_insertion_is_events_numbers_and_layers(graph):
    session = InsertionSession(short_run().robot)
    estimates = insert(session)
    events = [event for estimate in estimates for event in session_events(estimate)]
    [layer] = layer_reports(session.layers)

    assert [event.kind for event in events] == ["rupture", "layer", "layer"]
    for event in events:
        assert set(event.values) == set(EVENT_NUMBERS[event.kind])
    assert layer.name == "layer 1"
    assert float(layer.values["stiffness_N_per_m"]) > 0.0
    assert layer.values["is_final"] == "true"

    node = start(graph)
    event = next(one for one in estimates if one.identification.rupture is not None)
    node._publish_events(event)  # its samples pass through the real node in test_in_ros
    [message] = graph.published["/needleforce/events"]
    [number] = graph.published["/needleforce/rupture/depth_m"]
    values = {pair.key: pair.value for pair in message.status[0].values}
    assert message.status[0].name == "rupture"
    assert number.data == pytest.approx(float(values["depth_m"]))
    assert "/needleforce/rupture/depth_m" in graph.kept


def test_an_insertion_begins_only_after_a_tare(graph):
    start(graph)
    answer = graph.services["~/begin_insertion"](None, Message())

    assert answer.success is False
    assert "~/tare" in answer.message


def test_shutting_the_node_down_ends_it(graph):
    node = start(graph)
    assert not node.is_stopped
    node.on_shutdown(None)

    assert node.is_stopped


def test_a_missing_ros_is_an_error_that_names_it(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "rclpy", None)

    with pytest.raises(MissingRosError, match="rclpy"):
        require_ros()
    assert main(["ros2", "--robot", "lwr"]) == 2
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
