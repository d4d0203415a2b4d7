"""Tests of text that was exported from ROS topics and from loggers of arms."""

import numpy as np
import pytest

from needleforce.recordings import ColumnError, ColumnMapping, read_log

JOINTS = ("base", "elbow")
"""In the robot's order; ROS writes them in the order of the alphabet, or none."""

ROWS = 10


FIELDS = ("position", "velocity", "effort")


def row_values(row):
    """Position of elbow and base, then their velocity, then their effort."""
    return [number + row for number in (0.1, 0.2, 1.1, 1.2, 2.1, 2.2)]


def write(path, header, row_of):
    """Write a text file: a header, and a row for each number."""
    lines = [header, *(row_of(row) for row in range(ROWS))]
    path.write_text("\n".join(lines) + "\n")
    return path


def write_export(path, names, *texts):
    """Write a row for each number: its time, texts of the joints, all values."""
    return write(
        path,
        ",".join(names),
        lambda row: ",".join(map(str, [0.01 * row, *texts, *row_values(row)])),
    )


def by_path(path):
    names = [
        f"/joint_states/{joint}/{field}"
        for field in FIELDS
        for joint in ("elbow", "base")
    ]
    return write_export(path, ["__time", *names])


def by_numbered_names(path):
    names = [f"field.{field}{i}" for field in FIELDS for i in (0, 1)]
    names = ["t", "field.name0", "field.name1", *names]
    return write_export(path, names, "elbow", "base")


def by_list_of_names(path):
    names = [f"{field}_{i}" for field in FIELDS for i in (0, 1)]
    return write_export(path, ["Time", "name", *names], "\"['elbow', 'base']\"")


@pytest.mark.parametrize("export", [by_path, by_numbered_names, by_list_of_names])
def test_joints_are_put_into_the_robots_order_by_their_names(tmp_path, export):
    path = export(tmp_path / "export.csv")
    log = read_log(path, required=["q", "dq", "tau"], joints=JOINTS)

    row = np.arange(ROWS)
    np.testing.assert_allclose(log["q_rad"], np.stack([0.2 + row, 0.1 + row], axis=1))
    np.testing.assert_allclose(log["dq_rad_s"][:, 0], 1.2 + row)
    np.testing.assert_allclose(log["tau_Nm"][:, 1], 2.1 + row)
    assert log.warnings == ()


def test_list_of_names_that_fits_no_family_is_not_used(tmp_path):
    names = [f"{field}_{i}" for field in ("position", "effort") for i in range(3)]
    path = write(
        tmp_path / "export.csv",
        ",".join(["Time", "name", *names]),
        lambda row: f"{0.01 * row},\"['elbow', 'base']\",1,2,3,4,5,6",
    )
    log = read_log(path, required=["q", "tau"], joints=("a", "b", "c"))

    assert log["q_rad"][0].tolist() == [1.0, 2.0, 3.0]
    assert len(log.warnings) == 1
    assert "'name'" in log.warnings[0]


@pytest.mark.parametrize(
    ("position", "torque", "in_radians"),
    [
        ("J{} Position (deg)", "J{} Torque (Nm)", False),
        ("joint_{}_position", "joint_{}_torque", True),
        ("A{} pos [rad]", "A{} torque [Nm]", True),
        ("state.q[{}]", "state.tau_J[{}]", True),
        ("MeasuredJointPosition{}", "MeasuredTorque{}", True),
    ],
)
def test_number_of_a_joint_stands_in_front_or_behind_a_path_with_dots(
    tmp_path, position, torque, in_radians
):
    names = [name.format(i) for name in (position, torque) for i in (1, 2)]
    path = write(
        tmp_path / "log.csv",
        ",".join(["time [s]", *names]),
        lambda row: f"{0.01 * row},{0.001 * row},{0.002 * row},3,4",
    )
    log = read_log(path, required=["q", "tau"])

    factor = 1.0 if in_radians else np.pi / 180.0
    expected = factor * np.array([0.001, 0.002])
    np.testing.assert_allclose(log["q_rad"][1], expected)
    assert log["tau_Nm"][0].tolist() == [3.0, 4.0]


def test_pattern_of_joints_is_refused_where_none_has_a_name(tmp_path):
    path = write(tmp_path / "log.csv", "t,q1,q2", lambda row: f"{0.01 * row},0,0")
    mapping = ColumnMapping(joints=("left_*",))
    with pytest.raises(ColumnError, match=r"'left_\*' chooses joints by name"):
        read_log(path, mapping, required=["q"], joints=JOINTS)
