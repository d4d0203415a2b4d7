"""ROS 2 bags as robots record them, whole and broken: stamps, joints by name, topics
as columns."""

import numpy as np
import pytest
from rosbags.typesys import get_types_from_msg

from needleforce.recordings import (
    ColumnError,
    ColumnMapping,
    FormatError,
    read_log,
    read_table,
)
from tests.needleforce.recordings.bag_samples import (
    TYPES,
    data_file,
    header,
    insertion_rows,
    joint_state,
    mapped,
    message,
    number,
    without_chunks,
    write_bag,
)


def test_joints_are_ordered_by_the_robots_names(tmp_path):
    folder = write_bag(
        tmp_path / "bag", insertion_rows(4, names=("elbow", "gripper", "base"))
    )
    log = read_log(folder, required=["q", "tau"], joints=["base", "elbow"])

    assert log["q_rad"][1].tolist() == [1.2, 1.0]
    assert log["tau_Nm"][1].tolist() == [2.4, 2.0]

    log = read_log(
        folder, ColumnMapping(joints=("gripper", "elbow")), joints=["base", "elbow"]
    )

    assert log["q_rad"][1].tolist() == [1.1, 1.0]


def test_a_topic_is_read_by_its_own_definition(tmp_path):
    definition = (
        "std_msgs/Header header\nfloat64[3] tau_j\ngeometry_msgs/Point tip\nint8 mode\n"
    )
    TYPES.register(get_types_from_msg(definition, "arm_msgs/msg/State"))
    tip = message("geometry_msgs/msg/Point", 4.0, 5.0, 6.0)
    torques = np.array([1.0, 2.0, 3.0])
    state = message("arm_msgs/msg/State", header(5, "base"), torques, tip, -7)
    table = read_table(
        write_bag(tmp_path / "bag", [("/arm", 9, state)], storage="sqlite3")
    )
    columns = {name: values.tolist() for name, values in table.columns.items()}

    assert columns == {
        "t_s": [5e-9],
        "/arm/tau_j": [[1.0, 2.0, 3.0]],
        "/arm/tip_xyz": [[4.0, 5.0, 6.0]],
        "/arm/mode": [-7.0],
    }


@pytest.mark.slow
@pytest.mark.parametrize("is_split_by_topic", [False, True])
def test_a_bag_split_into_files_is_one_log(tmp_path, is_split_by_topic):
    rows = [
        row for row in insertion_rows(3000) if row[0] in ("/joint_states", "/ft/wrench")
    ]
    groups = (
        [rows[::2], rows[1::2]] if is_split_by_topic else [rows[:2000], rows[2000:]]
    )
    whole = tmp_path / "whole"
    whole.mkdir()
    for i, messages in enumerate(groups):
        data_file(write_bag(tmp_path / f"part_{i}", messages)).rename(
            whole / f"whole_{9 + i}.mcap"
        )

    log = read_log(
        whole, mapped(force="/ft/wrench/force_xyz[2]"), required=["q", "force"]
    )

    np.testing.assert_array_equal(log["q_rad"][:, 0], np.arange(3000.0))
    np.testing.assert_array_equal(log["force_N"], -np.arange(3000.0))


def test_joints_follow_names_and_missing_ones_are_nan(tmp_path):
    orders = ["ab", "ba", "a"]
    places = {"a": 1.0, "b": 2.0}
    rows = [
        ("/j", k, joint_state(k + 1, order, [places[name] for name in order]))
        for k, order in enumerate(orders)
    ]
    log = read_log(write_bag(tmp_path / "bag", rows), required=["q"])

    np.testing.assert_array_equal(log["q_rad"], [[1.0, 2.0], [1.0, 2.0], [1.0, np.nan]])


def test_gripper_messages_on_the_same_topic_are_ignored(tmp_path):
    rows = []
    for k in range(1, 6):
        rows.append(("/j", k, joint_state(10 * k, "ab", [k, k])))
        rows.append(("/j", k, joint_state(10 * k + 5, ["finger"], [0.5])))

    log = read_log(write_bag(tmp_path / "bag", rows), required=["q"], joints=["a", "b"])

    np.testing.assert_array_equal(log["q_rad"][:, 0], np.arange(1.0, 6.0))


def test_slower_topics_are_interpolated_to_the_fastest(tmp_path):
    rows = [("/force_mN", k, number(k)) for k in range(0, 1000, 10)]
    rows += [("/depth_mm", k, number(2.0 * k)) for k in range(0, 1000, 100)]
    log = read_log(write_bag(tmp_path / "bag", sorted(rows, key=lambda row: row[1])))

    np.testing.assert_allclose(log["depth_m"][:91], 0.02 * np.arange(91))
    assert np.isnan(log["depth_m"][91:]).all()


def test_the_mapping_may_choose_the_clock(tmp_path):
    folder = write_bag(tmp_path / "bag", insertion_rows(40))
    mapping = ColumnMapping(
        reference_topic="/depth_mm",
        channels=mapped(force="/ft/wrench/force_xyz[2]").channels,
    )
    log = read_log(folder, mapping, required=["depth", "force"])

    np.testing.assert_allclose(log["force_N"], [-0.0, -10.0, -20.0, -30.0], atol=2e-3)


def test_robot_or_mapping_chooses_among_fitting_topics(tmp_path):
    rows = [
        (topic, k, joint_state(k, names, [k, factor * k], [k, k], [factor * k, k]))
        for k in range(1, 4)
        for topic, names, factor in (("/arm", "ab", 2.0), ("/hand", "xy", 3.0))
    ]
    folder = write_bag(tmp_path / "bag", rows)
    asked = {"required": ["q", "tau"], "optional": ["dq"]}

    assert read_log(folder, joints=["b", "a"], **asked)["q_rad"][:, 0].tolist() == [
        2.0,
        4.0,
        6.0,
    ]

    several = r"several columns would fit \(/arm/position, /hand/position\)"
    for joints in ([], ["a", "x"]):
        with pytest.raises(ColumnError, match=several):
            read_log(folder, joints=joints, **asked)

    # A channel that is mapped decides for those that are not.
    log = read_log(folder, mapped(q="/hand/position"), **asked)

    assert log["tau_Nm"][:, 0].tolist() == [3.0, 6.0, 9.0]
    assert "dq_rad_s" in log


@pytest.mark.slow
@pytest.mark.parametrize(("compression", "part"), [(None, 0.9), ("STORAGE", 0.5)])
def test_a_bag_that_is_cut_is_read_up_to_there(tmp_path, compression, part):
    folder = write_bag(tmp_path / "bag", insertion_rows(6000), compression=compression)
    data = data_file(folder).read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: int(part * len(data))])
    whole = read_table(folder).columns["/joint_states/position"]
    table = read_table(cut)
    position = table.columns["/joint_states/position"]

    # A chunk that is not whole is lost: of 1 MiB, as this writer makes them.
    assert 3000 < len(position) < 6000
    np.testing.assert_array_equal(position, whole[: len(position)])
    assert table.warnings[0] == "cut.mcap is cut short; it was read up to there"


def test_messages_without_chunks_and_footer_are_all_read(tmp_path):
    folder = write_bag(tmp_path / "bag", insertion_rows(20))
    path = tmp_path / "bare.mcap"
    path.write_bytes(without_chunks(folder))
    whole = read_table(folder)
    table = read_table(path)

    assert list(table.columns) == list(whole.columns)
    for name, values in whole.columns.items():
        np.testing.assert_array_equal(table.columns[name], values)


def test_a_cut_bag_without_a_message_is_refused(tmp_path):
    folder = write_bag(tmp_path / "bag", insertion_rows(20))
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data_file(folder).read_bytes()[:40])

    with pytest.raises(FormatError, match="holds no topic with numbers"):
        read_table(cut)
