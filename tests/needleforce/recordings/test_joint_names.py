"""Joints and columns are matched with the robot's up to a common prefix or suffix."""

import numpy as np
import pytest

from needleforce.recordings import ColumnError, read_log, write_table
from needleforce.recordings.joint_names import match_joints
from needleforce.recordings.mapping import ColumnMapping
from tests.needleforce.recordings.bag_samples import (
    START_NS,
    STEP_NS,
    joint_state,
    write_bag,
)

ROWS = 30
PANDA = [f"panda_joint{i}" for i in range(1, 4)]
UR = ["shoulder_pan_joint", "elbow_joint", "wrist_1_joint"]
Q_RAD = np.arange(ROWS)[:, None] * 0.01 + np.arange(3)


@pytest.mark.parametrize(
    ("joints", "names"),
    [
        (PANDA, "left_panda_joint{}"),
        (PANDA, "panda_1/joint{}"),
        (PANDA, "joint{}_position"),
        (PANDA, "fr3_joint{}"),
        (PANDA, "joint_{}"),
        (UR, "ur5e_{}"),
        (["lwr_joint_1", "lwr_joint_2", "lwr_joint_3"], "arm.joint{}"),
    ],
)
def test_names_match_up_to_prefix_and_suffix(joints, names):
    marks = joints if joints is UR else (1, 2, 3)
    found = [names.format(mark) for mark in marks]
    (match,) = match_joints(["finger_joint", *found[::-1]], joints)

    assert list(match.names) == found


@pytest.mark.parametrize("found", [["a1", "a2", "a3"], PANDA[:2], ["joint10"] * 3, []])
def test_other_names_match_nothing(found):
    assert match_joints(found, PANDA) == []


def bag_of(folder, *arms):
    """Write a bag whose arms have equal joint states, with a finger between."""
    names = [f"{arm}{name}" for arm in arms for name in PANDA]
    rows = []
    for k in range(ROWS):
        stamp_ns = START_NS + k * STEP_NS
        q = [i + value for i in range(len(arms)) for value in Q_RAD[k]]
        state = joint_state(stamp_ns, [*names, "finger"], [*q, 9.0], (), [*q, 9.0])
        rows.append(("/joint_states", stamp_ns, state))

    return write_bag(folder, rows)


def test_prefixed_joints_of_a_bag_are_matched_and_said_once(tmp_path):
    path = bag_of(tmp_path / "bag", "left_")
    log = read_log(path, required=["q", "tau"], joints=PANDA)

    np.testing.assert_allclose(log["q_rad"], Q_RAD)
    (warning,) = log.warnings
    assert "left_panda_joint1, ... (left_*) were taken for the robot's" in warning


def test_two_arms_are_refused_until_one_is_chosen(tmp_path):
    bag = bag_of(tmp_path / "bag", "left_", "right_")
    table = tmp_path / "log.npz"
    columns = {
        f"{arm}{name}.{quantity}": i + Q_RAD[:, k]
        for i, arm in enumerate(("left_", "right_"))
        for k, name in enumerate(PANDA)
        for quantity in ("position", "effort")
    }
    write_table(table, {"t_s": 0.01 * np.arange(ROWS), **columns})
    for path in (bag, table):
        with pytest.raises(ColumnError, match=r"left_\*.* and right_\*") as refused:
            read_log(path, required=["q", "tau"], joints=PANDA)
        assert "such as `('left_*',)`" in refused.value.advice

        mapping = ColumnMapping(joints="right_*")
        log = read_log(path, mapping, required=["q", "tau"], joints=PANDA)
        np.testing.assert_allclose(log["q_rad"], 1.0 + Q_RAD)


@pytest.mark.parametrize(
    "name",
    ["panda_{}_{}", "/joint_states/panda_{}/{}", "{}_{}", "{1}_panda_{0}"],
)
def test_columns_named_after_joints_are_found(tmp_path, name):
    path = tmp_path / "log.npz"
    columns = {
        name.format(f"joint{k + 1}", quantity): factor * Q_RAD[:, k]
        for k in range(3)
        for quantity, factor in (("position", 1), ("effort", 2), ("desired_effort", 3))
    }
    write_table(path, {"t_s": 0.01 * np.arange(ROWS), **columns})
    log = read_log(path, required=["q", "tau"], joints=PANDA)

    np.testing.assert_allclose(log["tau_Nm"], 2.0 * Q_RAD)
    notes = [text for text in log.warnings if "by the names of the joints: q" in text]

    assert len(notes) == (name != "{}_{}")  # a number in front is a usual name
