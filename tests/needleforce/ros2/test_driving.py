"""An arm that a velocity controller of ros2_control moves, without rclpy."""

import sys
import threading
import time
from importlib import import_module
from types import SimpleNamespace

import numpy as np
import pytest

import urdf
from needleforce.devices import DeviceSettingError, LinkError
from needleforce.devices.guard import Guard
from tests.needleforce.ros2.fake_ros import Graph, installed_ros, joint_state_of

ROBOT = urdf.load_lwr()
JOINTS = ROBOT.joint_names
NAME = "/forward_velocity_controller"
SPEED_rad_s = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7])


def joint_state(at_s=None):
    """A state of a joint_state_broadcaster, by default of now."""
    return joint_state_of(JOINTS, time.monotonic() if at_s is None else at_s)


def parameters(joints=JOINTS[::-1], interface="velocity"):
    """What a controller says of itself."""
    values = {
        "joints": SimpleNamespace(string_array_value=list(joints)),
        "interface_name": SimpleNamespace(string_value=interface),
    }
    return lambda names: [values[names[0]]]


@pytest.fixture
def graph():
    """A controller, whose joints stand in reverse order, that listens."""
    with installed_ros(Graph()) as graph:
        graph.services[NAME] = parameters()
        graph.callbacks[f"{NAME}/commands"].append(lambda message: None)
        yield graph


def open_arm(joints=JOINTS, **options):
    """An arm that is commanded, unless options say otherwise."""
    options = {"takes_commands": True, "robot": ROBOT} | options
    arm_type = import_module("needleforce.ros2.arm").Ros2Arm
    return arm_type("/joint_states", joints, **options)


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


def wait_until(is_so):
    """Wait until something is so, for at most 10 s."""
    end_s = time.monotonic() + 10.0
    while not is_so():
        assert time.monotonic() < end_s
        time.sleep(0.002)


def wait_until_sent(graph):
    wait_until(lambda: len(commands(graph)))


def wait_for_rest(graph):
    wait_until_sent(graph)
    wait_until(lambda: not commands(graph)[-1].any())


def test_a_velocity_goes_to_the_joints_of_the_controller_by_name(graph):
    with heard_arm(graph) as arm:

        def has_reached():
            graph.put("/joint_states", joint_state())
            next(iter(arm))
            assert arm.send(SPEED_rad_s)
            return (commands(graph)[-1:] == SPEED_rad_s).all(axis=1).any()

        wait_until(has_reached)


@pytest.mark.parametrize("is_closed", [False, True])
def test_a_velocity_is_reached_and_left_within_the_limits(graph, is_closed):
    """10 rad/s2 and 5,000 rad/s3 in cycles of 2 ms; also of an arm that is closed."""
    with heard_arm(graph) as arm:
        arm.send(SPEED_rad_s)  # once: it holds for 50 ms
        wait_until_sent(graph)
        if not is_closed:
            wait_for_rest(graph)
    sent_rad_s = commands(graph)
    changes_rad_s = np.diff(sent_rad_s, axis=0, prepend=np.zeros((2, 7)))

    assert is_closed or sent_rad_s.max() > 0.1
    assert sent_rad_s.min() == 0.0
    assert not sent_rad_s[-1].any()
    assert np.abs(changes_rad_s).max() <= 0.02
    assert np.abs(np.diff(changes_rad_s, axis=0)).max() <= 0.02
    assert not arm.send(SPEED_rad_s)


def test_zero_is_the_last_where_sending_fails(graph, monkeypatch):
    arm = heard_arm(graph)
    arm.send(SPEED_rad_s)
    wait_until_sent(graph)
    monkeypatch.setattr(threading, "excepthook", lambda failure: None)
    monkeypatch.setattr(Guard, "advance", lambda self, place_rad: 1 / 0)
    wait_for_rest(graph)

    assert not arm.send(SPEED_rad_s)
    arm.close()


def test_an_arm_that_is_not_heard_takes_no_velocity(graph):
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
    arm = open_arm(takes_commands=False)
    graph.put("/joint_states", joint_state())

    assert not next(iter(arm)).accepts_commands
    assert not arm.send(SPEED_rad_s)
    arm.close()


LISTENING = {"takes_commands": False}


@pytest.mark.parametrize(
    ("answer", "options", "error", "text"),
    [
        (parameters(interface="position"), {}, DeviceSettingError, "position"),
        (parameters(JOINTS[:6]), {}, DeviceSettingError, "lwr_joint_1"),
        (parameters(["a"] * 7), {}, DeviceSettingError, "moves a, a"),
        (None, {}, LinkError, NAME),  # it is not there
        (parameters(), {"robot": None}, DeviceSettingError, "robot"),
        (parameters(), LISTENING | {"preset": "fr4"}, DeviceSettingError, "fr3"),
        (parameters(), LISTENING | {"preset": "ur5e"}, DeviceSettingError, "6 joints"),
    ],
)
def test_an_arm_that_cannot_be_driven_is_refused(graph, answer, options, error, text):
    graph.services[NAME] = answer

    with pytest.raises(error, match=text):
        open_arm(**options)


def test_the_limits_are_those_of_the_model_or_of_an_arm_by_name(graph):
    with open_arm() as arm:
        assert arm.limits.joints.speed_rad_s.max() <= 0.5
    with open_arm(takes_commands=False, preset="fr3") as arm:
        assert arm.limits.cycle_s == 1e-3  # of an FR3


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


def test_an_arm_that_falls_silent_is_lost_with_an_error(graph, monkeypatch):
    with open_arm(takes_commands=False) as arm:
        monkeypatch.setattr(sys.modules[type(arm).__module__], "MAX_SILENCE_S", 0.2)
        graph.put("/joint_states", joint_state(1.0), joint_state(2.0))
        readings = iter(arm)
        assert [next(readings).dt_s for _ in range(2)] == [0.0, 1.0]
        with pytest.raises(LinkError, match="silent"):
            next(readings)
        assert arm.report.outages >= 1
        assert arm.report.longest_gap_s >= 1.0
