"""Joint states to samples: by name, by stamp, complete or counted."""

from types import SimpleNamespace

import numpy as np
import pytest

from needleforce.ros2.joint_samples import JointReader

JOINTS = ("arm_joint_1", "arm_joint_2", "arm_joint_3")


def message(stamp_ms=0, names=JOINTS, **signals):
    """A joint state whose k-th joint has position k, velocity 10 k, effort 100 k."""
    number = np.array([int(name[-1]) for name in names], dtype=float)
    sec, milliseconds = divmod(stamp_ms, 1000)
    values = {"position": number, "velocity": 10.0 * number, "effort": 100.0 * number}
    stamp = SimpleNamespace(sec=sec, nanosec=10**6 * milliseconds)
    header = SimpleNamespace(stamp=stamp)
    return SimpleNamespace(header=header, name=list(names), **{**values, **signals})


@pytest.mark.parametrize(
    "names",
    [
        ("finger_9", "arm_joint_3", "arm_joint_1", "arm_joint_2"),
        [f"left_{name}" for name in JOINTS],
    ],
)
def test_joints_are_taken_by_name_in_any_order_with_any_prefix(names):
    reader = JointReader(JOINTS)
    sample = reader.read(message(5, names))

    assert reader.stamp_ns == 5 * 10**6
    assert sample.q_rad.tolist() == [1.0, 2.0, 3.0]
    assert sample.dq_rad_s.tolist() == [10.0, 20.0, 30.0]
    assert sample.tau_Nm.tolist() == [100.0, 200.0, 300.0]


def test_two_arms_on_a_topic_need_a_pattern():
    names = [f"{side}_{name}" for side in ("left", "right") for name in JOINTS]
    undecided = JointReader(JOINTS)

    assert undecided.read(message(0, names)) is None
    assert "joint_pattern" in undecided.problem
    assert JointReader(JOINTS, "right_*").read(message(0, names)) is not None


def test_a_gripper_is_passed_by_and_counted():
    reader = JointReader(JOINTS)
    gripper = message(0, ("finger_1", "finger_2"))

    assert reader.read(gripper) is None
    assert "finger_1" in reader.problem
    assert reader.read(message(1)) is not None
    assert reader.read(gripper) is None
    assert reader.problem == ""
    assert reader.counts == {"used": 1, "other_joints": 2}


def test_a_state_without_torque_is_left_out_with_a_reason():
    reader = JointReader(JOINTS)

    assert reader.read(message(effort=())) is None
    assert "efforts" in reader.problem
    assert reader.counts["without_effort"] == 1


def test_steps_are_those_of_the_stamps_and_late_states_are_left_out():
    reader = JointReader(JOINTS)
    samples = [reader.read(message(ms)) for ms in (10, 11, 11, 9, 14, 414, -5000)]
    steps_ms = [sample and round(1e3 * sample.dt_s) for sample in samples]

    # The last is of a clock that was set back: the session reports such a step.
    assert steps_ms == [0, 1, None, None, 3, 400, -5414]
    assert reader.counts["stale"] == 2
    assert reader.longest_gap_s == pytest.approx(0.4)


def test_stamps_that_stand_still_are_a_problem():
    reader = JointReader(JOINTS)
    for _ in range(3):
        reader.read(message(0))

    assert "do not advance" in reader.problem


def test_velocities_are_there_always_or_never():
    with_velocity = JointReader(JOINTS)
    without = JointReader(JOINTS)

    assert with_velocity.read(message(0)) is not None
    assert with_velocity.read(message(1, velocity=())) is None
    assert with_velocity.read(message(2, position=())) is None
    assert with_velocity.counts["malformed"] == 2
    assert without.read(message(0, velocity=())).dq_rad_s is None
    assert without.read(message(1)).dq_rad_s is None
