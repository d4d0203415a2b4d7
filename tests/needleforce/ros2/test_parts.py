"""What the node does without ROS: conversion, counts, parameters, tare, reports."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest

from needleforce import InsertionSession
from needleforce.insertion_events import session_events
from needleforce.ros2 import MissingRosError, Ros2ParameterError
from needleforce.ros2.joint_samples import JointMessage, JointReader, TorquePairing
from needleforce.ros2.message_loss import DelayMeter, LossCounter
from needleforce.ros2.messages import read_joint_state
from needleforce.ros2.parameters import PARAMETERS, settings_from_values
from needleforce.ros2.reports import NodeHealth, layer_reports
from needleforce.ros2.ros_modules import import_ros
from tests.insertion_run import insert, short_run

JOINTS = ("arm_joint_1", "arm_joint_2", "arm_joint_3")
MS_NS = 10**6


def message(stamp_ms=0, names=JOINTS, **signals):
    """A joint state whose k-th joint has position k, velocity 10 k, effort 100 k."""
    number = np.array([int(name[-1]) for name in names], dtype=float)
    values = {"position": number, "velocity": 10.0 * number, "effort": 100.0 * number}
    return JointMessage(stamp_ms * MS_NS, tuple(names), **{**values, **signals})


def test_joints_are_taken_by_name_in_whatever_order_they_come():
    reader = JointReader(JOINTS)
    names = ("finger_9", "arm_joint_3", "arm_joint_1", "arm_joint_2")
    sample = reader.read(message(5, names))

    assert sample is not None
    assert sample.q_rad.tolist() == [1.0, 2.0, 3.0]
    assert sample.dq_rad_s.tolist() == [10.0, 20.0, 30.0]
    assert sample.effort_Nm.tolist() == [100.0, 200.0, 300.0]


def test_joints_of_another_prefix_are_the_arm_s():
    reader = JointReader(JOINTS)
    sample = reader.read(message(0, [f"left_{name}" for name in JOINTS]))

    assert sample is not None
    assert sample.q_rad.tolist() == [1.0, 2.0, 3.0]


def test_two_arms_on_a_topic_need_a_pattern():
    names = [f"{side}_{name}" for side in ("left", "right") for name in JOINTS]
    undecided = JointReader(JOINTS)

    assert undecided.read(message(0, names)) is None
    assert "joint_pattern" in undecided.problem
    assert JointReader(JOINTS, "right_*").read(message(0, names)) is not None


def test_a_gripper_is_passed_by_and_counted():
    reader = JointReader(JOINTS)

    assert reader.read(message(0, ("finger_1", "finger_2"))) is None
    assert "finger_1, finger_2; expected all of arm_joint_1" in reader.problem
    assert reader.read(message(1)) is not None
    assert reader.read(message(2, ("finger_1", "finger_2"))) is None
    assert reader.problem == ""
    assert str(reader.counts) == "1 used, 2 other joints"


def test_a_state_without_torque_is_refused_with_a_reason():
    reader = JointReader(JOINTS)

    assert reader.read(message(effort=())) is None
    assert "0 efforts of 3 joints" in reader.problem
    assert reader.counts.without_effort == 1


def test_steps_are_those_of_the_stamps_and_late_states_are_left_out():
    reader = JointReader(JOINTS)
    steps_ms = [
        sample and round(1e3 * sample.dt_s)
        for sample in map(reader.read, map(message, (10, 11, 11, 9, 14, -5000)))
    ]

    # The last is of a clock that was set back: the session reports such a step.
    assert steps_ms == [0, 1, None, None, 3, -5014]
    assert reader.counts.stale == 2
    assert reader.longest_gap_s == pytest.approx(0.003)


def test_stamps_that_stand_still_are_a_problem():
    reader = JointReader(JOINTS)
    for _ in range(3):
        reader.read(message(0))

    assert reader.problem == "stamps of joint states do not advance"


def test_velocities_are_there_always_or_never():
    with_velocity = JointReader(JOINTS)
    without = JointReader(JOINTS)

    assert with_velocity.read(message(0)) is not None
    assert with_velocity.read(message(1, velocity=())) is None
    assert with_velocity.counts.malformed == 1
    assert without.read(message(0, velocity=())).dq_rad_s is None
    assert without.read(message(1)).dq_rad_s is None


def test_an_external_torque_is_joined_by_its_stamp():
    reader = JointReader(JOINTS, needs_effort=False)
    pairing = TorquePairing(JOINTS, reader.counts)
    joined = []
    for stamp_ms in (0, 1, 2):
        state = reader.read(message(stamp_ms, effort=()))
        joined.append(pairing.add_sample(state))
    torque = message(1, JOINTS[::-1], position=(), velocity=())
    joined.append(pairing.add_torque(torque))
    joined.append(pairing.add_torque(torque._replace(stamp_ns=3 * MS_NS)))
    joined.append(pairing.add_sample(reader.read(message(3, effort=()))))

    assert [sample is not None for sample in joined] == [0, 0, 0, 1, 0, 1]
    assert joined[3].effort_Nm.tolist() == [100.0, 200.0, 300.0]
    assert joined[5].dt_s == pytest.approx(0.002)
    assert reader.counts.unmatched == 2


def test_a_lost_message_is_counted_by_publisher():
    loss = LossCounter()
    for publisher, number in (("a", 7), ("b", 1), ("a", 8), ("a", 11), ("b", 2)):
        loss.count(publisher, number)

    assert str(loss) == "5 received, 2 lost (28.57 %)"


def test_loss_is_unknown_where_messages_have_no_number():
    loss = LossCounter()
    loss.count(None, None)

    assert "not counted" in str(loss)


def test_the_largest_delay_is_reported_once():
    delay = DelayMeter()
    delay.add(3 * MS_NS)
    delay.add(MS_NS)

    assert delay.take_max_s() == pytest.approx(0.003)
    assert delay.take_max_s() == 0.0


def test_parameters_have_defaults_and_take_whole_numbers_for_real_ones():
    settings = settings_from_values({"silence_s": 2})

    assert settings.silence_s == 2.0
    assert isinstance(settings.silence_s, float)
    assert settings.queue_depth == 1000
    assert all(parameter.description.endswith(".") for parameter in PARAMETERS)


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"gain_per": 7.0}, "there is no parameter gain_per; did you mean gain_per_s"),
        ({"gain_per_s": 0.0}, "gain_per_s is 0.0; expected a number from 1 to 500"),
        ({"gain_per_s": float("nan")}, "gain_per_s is nan"),
        ({"queue_depth": 2.5}, "a float; expected a whole number"),
        ({"queue_depth": True}, "a bool; expected a whole number"),
        ({"gravity_compensated": 1}, "expected true or false"),
        ({"frame_id": 3}, "expected a text"),
        ({"reliability": "best"}, "expected best_effort or reliable"),
    ],
)
def test_a_parameter_that_cannot_be_is_refused_with_a_sentence(values, text):
    with pytest.raises(Ros2ParameterError, match=text):
        settings_from_values(values)


def health(session, reader, estimate, **changes):
    values = {
        "silent_s": 0.0,
        "silence_limit_s": 0.5,
        "delay_max_s": 0.001,
        "lost_before": 0,
        "is_taring": False,
    }
    return NodeHealth(
        session=session,
        reader=reader,
        estimate=estimate,
        **{"loss": LossCounter(), **values, **changes},
    ).report("needleforce")


@pytest.mark.slow
def test_layers_and_events_have_names_and_units():
    session = InsertionSession(short_run().robot)
    estimates = insert(session)
    events = [event for estimate in estimates for event in session_events(estimate)]
    [layer] = layer_reports(session.layers)

    assert [event.kind for event in events] == ["rupture", "layer", "layer"]
    assert events[0].text.startswith("rupture of layer 1 at ")
    assert events[0].values["depth_m"] == pytest.approx(0.03, abs=0.01)
    assert layer.name == "layer 1"
    assert float(layer.values["stiffness_N_per_m"]) > 0.0
    assert layer.values["is_final"] == "true"

    reader = JointReader(JOINTS)
    reader.read(message(0))
    loss = LossCounter()
    loss.count("arm", 1)
    loss.count("arm", 4)
    fine = health(session, reader, estimates[-1])
    silent = health(session, reader, estimates[-1], silent_s=2.0)
    lossy = health(session, reader, estimates[-1], loss=loss)
    unheard = health(session, JointReader(JOINTS), None)

    assert (fine.level, fine.message) == (0, "ok")
    assert (silent.level, silent.message) == (2, "no joint state for 2.0 s")
    assert lossy.level == 1
    assert lossy.values["lost"] == "2"
    assert unheard.message.startswith("no joint state has come")


def test_a_message_of_ros_becomes_plain_numbers():
    stamp = SimpleNamespace(sec=3, nanosec=7)
    state = SimpleNamespace(
        header=SimpleNamespace(stamp=stamp),
        name=["a"],
        position=[1.0],
        velocity=[],
        effort=[2.0],
    )

    assert read_joint_state(state) == (3_000_000_007, ("a",), [1.0], [], [2.0])


def test_a_missing_ros_is_an_error_that_says_what_to_do(monkeypatch):
    monkeypatch.setitem(sys.modules, "rclpy", None)

    with pytest.raises(MissingRosError, match="cannot import ROS 2") as caught:
        import_ros()

    assert "setup file" in caught.value.advice
