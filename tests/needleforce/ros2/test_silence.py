"""An arm that falls silent is said at once, and the first step after it is true."""

import time

import numpy as np
import pytest

from needleforce import InsertionSession
from needleforce.devices import LinkError
from needleforce.ros2 import arm as arm_file
from needleforce.ros2 import node as node_file
from needleforce.ros2.arm import Ros2Arm
from needleforce.ros2.parameters import settings_from_values
from tests.insertion_run import short_run
from tests.needleforce.ros2.fake_ros import Graph, Message, Node, fake_ros


def state(at_s, names):
    """A joint state of an arm at rest."""
    sec, nanosec = divmod(round(1e9 * at_s), 10**9)
    message = Message(name=list(names), position=[0.1] * 7, velocity=[0.0] * 7)
    message.effort = [0.0] * 7
    message.header = Message(stamp=Message(sec=sec, nanosec=nanosec))
    return message


def values_of(status):
    return {pair.key: pair.value for pair in status.values}


def test_the_node_reports_silence_within_a_tenth_of_a_second(monkeypatch):
    monkeypatch.setattr(node_file, "warm_up", lambda robot, config: None)
    steps_s = []

    def update(self, q, dq, torque, dt_s):
        steps_s.append(round(dt_s, 6))
        return original(self, q, dq, torque, dt_s)

    original = InsertionSession.update
    monkeypatch.setattr(InsertionSession, "update", update)
    robot = short_run().robot
    graph = Graph()
    timers = {}
    node = Node(graph)
    node.create_timer = lambda period_s, call: timers.setdefault(period_s, call)
    settings = settings_from_values({})
    needle_node = node_file.NeedleNode(fake_ros(graph), node, robot, settings)
    needle_node._subscription.handle.take_message.return_value = None
    watch = timers[min(timers)]

    graph.put("/joint_states", state(1.0, robot.joint_names))
    graph.deliver()
    watch()
    assert not graph.published["/diagnostics"]

    heard_s = time.monotonic()
    while not graph.published["/diagnostics"]:
        assert time.monotonic() < heard_s + 10.0
        # A gripper on the same topic is not the arm.
        graph.put("/joint_states", Message(name=["finger"], position=[0.0]))
        graph.deliver()
        watch()
        time.sleep(min(timers))
    # Of the period of the timer and the limit, not of this machine.
    assert settings.silence_s + min(timers) < 0.1
    status = graph.published["/diagnostics"][-1].status[0]
    assert status.level == bytes([2])
    assert "silent" in status.message
    assert float(values_of(status)["longest_gap_s"]) >= settings.silence_s

    graph.put("/joint_states", state(1.4, robot.joint_names))
    graph.deliver()
    watch()
    assert len(graph.published["/diagnostics"]) == 1
    assert steps_s == [0.0, 0.4]


def test_an_arm_that_falls_silent_is_lost_with_an_error(monkeypatch):
    graph = Graph()
    names = short_run().robot.joint_names
    monkeypatch.setattr(arm_file, "import_ros", lambda: fake_ros(graph))
    monkeypatch.setattr(arm_file, "MAX_SILENCE_S", 0.2)
    with Ros2Arm("/joint_states", names) as arm:
        graph.put("/joint_states", state(1.0, names), state(1.4, names))
        readings = iter(arm)
        assert [next(readings).dt_s for _ in range(2)] == pytest.approx([0.0, 0.4])
        with pytest.raises(LinkError, match="silent"):
            next(readings)
        assert arm.report.outages == 1
        assert arm.report.longest_gap_s == pytest.approx(0.4)
        assert np.isfinite(arm.report.longest_gap_s)


def test_silence_counts_in_the_longest_gap(monkeypatch):
    graph = Graph()
    names = short_run().robot.joint_names
    monkeypatch.setattr(arm_file, "import_ros", lambda: fake_ros(graph))
    monkeypatch.setattr(arm_file, "MAX_SILENCE_S", 0.2)
    with Ros2Arm("/joint_states", names) as arm:
        graph.put("/joint_states", state(1.0, names))
        with pytest.raises(LinkError):
            list(arm)
        assert arm.report.longest_gap_s >= 0.2
