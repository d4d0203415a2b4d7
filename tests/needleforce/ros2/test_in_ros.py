"""What the node and a ROS user's other nodes tell each other, without rclpy."""

from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest

import urdf
from needleforce import InsertionSession
from needleforce.cli.robot import robot_from_text
from needleforce.cli.shared_options import RobotOptions
from needleforce.insertion_events import session_events
from needleforce.ros2 import MissingRosError, Ros2ParameterError
from needleforce.ros2 import node as node_file
from needleforce.ros2.errors import MissingDescriptionError
from needleforce.ros2.messages import read_lbr_state
from needleforce.ros2.parameters import settings_from_values
from needleforce.ros2.reports import EVENT_NUMBERS
from needleforce.ros2.robot_description import wait_for_description
from needleforce.ros2.ros_modules import import_lbr_state
from needleforce.ros2.tip_frame import place_tip
from tests.insertion_run import insert, short_run
from tests.needleforce.ros2.fake_ros import Graph, Message, Node, fake_ros


@pytest.fixture
def graph():
    """Where nothing was said yet."""
    return Graph()


@pytest.fixture
def start_node(graph, monkeypatch):
    """Starts the node with settings, and some robot, in the graph."""
    monkeypatch.setattr(node_file, "warm_up", lambda robot, config: None)

    def start(robot=None, **settings):
        return node_file.NeedleNode(
            fake_ros(graph),
            Node(graph),
            robot or short_run().robot,
            settings_from_values(settings),
        )

    return start


# Description of the arm


def lwr_text():
    return open(urdf.example_robot_path("lwr4plus"), encoding="utf-8").read()


def test_a_description_that_was_published_before_is_taken(graph):
    graph.put("/robot_description", Message(data=""), Message(data=lwr_text()))
    text = wait_for_description(fake_ros(graph), Node(graph))
    robot = robot_from_text(text, "robot_description", RobotOptions())

    assert robot.nv == 7
    assert not graph.callbacks["/robot_description"]


def test_a_description_that_does_not_come_is_an_error_with_its_topic(graph):
    with pytest.raises(MissingDescriptionError, match="/robot_description: no") as info:
        wait_for_description(fake_ros(graph), Node(graph), max_s=0.0)

    assert "robot_state_publisher" in info.value.advice


def test_who_waits_long_for_a_description_is_told_so(graph, monkeypatch):
    monkeypatch.setattr("needleforce.ros2.robot_description.REMINDER_S", 0.0)
    with pytest.raises(MissingDescriptionError):
        wait_for_description(fake_ros(graph), Node(graph), max_s=0.01)

    assert "waiting for /robot_description" in graph.warnings[0]


def test_a_description_that_is_none_is_refused_by_its_name():
    with pytest.raises(urdf.UrdfFileError, match="robot_description"):
        robot_from_text("<robot", "robot_description", RobotOptions())


# Frame of the tip


def test_the_tip_is_broadcast_from_the_flange_of_the_description(graph, start_node):
    start_node(urdf.load_lwr(payload=urdf.NeedleTool()))
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


def test_a_tip_that_is_a_link_is_in_tf_already(graph, start_node):
    robot = urdf.load_lwr()
    start_node(robot)

    assert not graph.published["/tf_static"]
    assert place_tip(robot, "flange") is None


def test_a_frame_of_another_name_is_broadcast_where_the_tool_frame_is():
    tip = place_tip(urdf.load_lwr(), "my_needle")

    assert tip is not None
    assert tip.parent == "flange"
    assert tip.placement.isApprox(pin.SE3.Identity())


def test_a_tip_of_a_joint_is_on_the_link_that_the_joint_moves():
    robot = urdf.load_urdf(
        urdf.example_robot_path("lwr4plus"),
        tool_frame="lwr_joint_7",
        tool_placement=(0.0, 0.02, 0.1),
    )
    tip = place_tip(robot, "tool")

    assert tip is not None
    assert tip.parent == "lwr_link_7"
    assert tip.placement.translation.tolist() == pytest.approx([0.0, 0.02, 0.1])


def test_the_tip_is_not_broadcast_where_a_user_does_that(graph, start_node):
    start_node(urdf.load_lwr(payload=urdf.NeedleTool()), broadcast_tip=False)

    assert not graph.published["/tf_static"]


# Numbers of events


def test_each_number_of_an_event_has_a_topic_before_the_event(graph, start_node):
    start_node()

    assert "/needleforce/rupture/depth_m" in graph.published
    assert "/needleforce/layer/stiffness_N_per_m" in graph.kept


@pytest.mark.slow
def test_events_have_the_numbers_that_have_topics():
    session = InsertionSession(short_run().robot)
    kinds = set()
    for estimate in insert(session):
        for event in session_events(estimate):
            kinds.add(event.kind)
            assert set(event.values) == set(EVENT_NUMBERS[event.kind])

    assert kinds == {"rupture", "layer"}


# LBRState of lbr_fri_ros2_stack


def lbr_state(stamp_ns=1_000_000_002):
    """As lbr_fri_idl has it: arrays of seven, and the controller's time."""
    return SimpleNamespace(
        time_stamp_sec=stamp_ns // 10**9,
        time_stamp_nano_sec=stamp_ns % 10**9,
        measured_joint_position=np.arange(7.0),
        measured_torque=np.full(7, 50.0),
        external_torque=10.0 + np.arange(7.0),
    )


def test_the_state_of_an_lbr_gives_positions_and_external_torques():
    joints = tuple(f"lbr_A{k}" for k in range(1, 8))
    message = read_lbr_state(lbr_state(), joints)

    assert message.stamp_ns == 1_000_000_002
    assert message.names == joints
    assert list(message.position) == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    assert list(message.effort) == [10.0, 11.0, 12.0, 13.0, 14.0, 15.0, 16.0]
    assert len(message.velocity) == 0


def test_the_node_takes_external_torques_of_an_lbr(graph, start_node, monkeypatch):
    monkeypatch.setattr(node_file, "import_lbr_state", lambda: Message)
    taken = []

    def update(self, q, dq, torque, dt_s):
        taken.append((q.tolist(), dq, torque.tolist(), round(dt_s, 6)))
        return original(self, q, dq, torque, dt_s)

    original = InsertionSession.update_external_torque
    monkeypatch.setattr(InsertionSession, "update_external_torque", update)
    node = start_node(lbr_state_topic="/lbr/state")
    node._subscription.handle.take_message.return_value = None
    graph.put("/lbr/state", lbr_state(), lbr_state(1_005_000_002))
    graph.deliver()

    assert [each[3] for each in taken] == [0.0, 0.005]
    assert taken[0][0] == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    assert taken[0][1] is None
    assert taken[0][2] == [10.0, 11.0, 12.0, 13.0, 14.0, 15.0, 16.0]
    # The stamp is of the node's clock, which TF knows, not of the controller's.
    assert graph.published["/needleforce/wrench"][-1].header.stamp.sec == 7
    assert not graph.callbacks["/joint_states"]


def test_an_lbr_has_seven_joints(start_node):
    robot = urdf.load_example("ur5e")
    with pytest.raises(Ros2ParameterError, match="description has 6"):
        start_node(robot, lbr_state_topic="/lbr/state")


def test_two_sources_of_external_torques_are_refused():
    both = {"external_torque_topic": "/a", "lbr_state_topic": "/b"}
    with pytest.raises(Ros2ParameterError, match="expected one of them"):
        settings_from_values(both)


def test_a_missing_message_of_the_lbr_is_said():
    with pytest.raises(MissingRosError, match="workspace of lbr_fri_ros2_stack"):
        import_lbr_state()
