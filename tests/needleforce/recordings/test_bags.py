"""ROS 2 bags as robots record them, whole and broken: stamps, joints by name, topics
as columns."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import get_types_from_msg

from needleforce.recordings import (
    ColumnError,
    ColumnMapping,
    FileAccessError,
    FormatError,
    read_log,
    read_table,
)
from needleforce.recordings.bags.message_types import TopicDecoder
from needleforce.recordings.bags.messages import BagTopic
from tests.needleforce.recordings.bag_samples import (
    TYPES,
    data_file,
    header,
    insertion_rows,
    joint_state,
    mapped,
    message,
    number,
    text,
    wrench,
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


def test_a_bag_without_numbers_or_messages_is_refused(tmp_path):
    with pytest.raises(
        FormatError, match=r"no topic with numbers: /log .*holds no numbers"
    ):
        read_log(write_bag(tmp_path / "bag", [("/log", 1, text("a"))]))

    with pytest.raises(FormatError, match="holds no messages"):
        read_log(write_bag(tmp_path / "empty", []))


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


def test_what_is_no_bag_is_refused(tmp_path):
    for name in ("x.mcap", "x.db3"):
        (tmp_path / name).write_bytes(b"")
        with pytest.raises(FormatError, match=f"{name} is empty"):
            read_table(tmp_path / name)

        (tmp_path / name).write_text("no bag")
        with pytest.raises(FormatError, match="does not begin as one"):
            read_log(tmp_path / name)

        with pytest.raises(FileAccessError, match="cannot read"):
            read_log(tmp_path / f"no_{name}")

    (tmp_path / "folder").mkdir()

    with pytest.raises(FileAccessError, match="no known suffix"):
        read_log(tmp_path / "folder")

    (tmp_path / "folder.db3").mkdir()

    with pytest.raises(FormatError, match="is a folder without"):
        read_log(tmp_path / "folder.db3")


def test_joints_follow_names_and_missing_ones_are_nan(tmp_path):
    orders = ["ab", "ba", "a"]
    places = {"a": 1.0, "b": 2.0}
    rows = [
        ("/j", k, joint_state(k + 1, order, [places[name] for name in order]))
        for k, order in enumerate(orders)
    ]
    log = read_log(write_bag(tmp_path / "bag", rows), required=["q"])

    np.testing.assert_array_equal(log["q_rad"], [[1.0, 2.0], [1.0, 2.0], [1.0, np.nan]])
    assert "/j: messages that lack joints: 1" in log.warnings


def test_gripper_messages_on_the_same_topic_are_ignored(tmp_path):
    rows = []
    for k in range(1, 6):
        rows.append(("/j", k, joint_state(10 * k, "ab", [k, k])))
        rows.append(("/j", k, joint_state(10 * k + 5, ["finger"], [0.5])))

    log = read_log(write_bag(tmp_path / "bag", rows), required=["q"], joints=["a", "b"])

    np.testing.assert_array_equal(log["q_rad"][:, 0], np.arange(1.0, 6.0))
    assert "/j: messages without any of the joints, left out: 5" in log.warnings


def test_slower_topics_are_interpolated_to_the_fastest(tmp_path):
    rows = [("/force_mN", k, number(k)) for k in range(0, 1000, 10)]
    rows += [("/depth_mm", k, number(2.0 * k)) for k in range(0, 1000, 100)]
    log = read_log(write_bag(tmp_path / "bag", sorted(rows, key=lambda row: row[1])))

    np.testing.assert_allclose(log["depth_m"][:91], 0.02 * np.arange(91))
    assert np.isnan(log["depth_m"][91:]).all()
    assert "rows are the messages of /force" in log.warnings[0]
    assert "/depth" in log.warnings[0]


def test_the_mapping_may_choose_the_clock(tmp_path):
    folder = write_bag(tmp_path / "bag", insertion_rows(40))
    mapping = ColumnMapping(
        reference_topic="/depth_mm",
        channels=mapped(force="/ft/wrench/force_xyz[2]").channels,
    )
    log = read_log(folder, mapping, required=["depth", "force"])

    np.testing.assert_allclose(log["force_N"], [-0.0, -10.0, -20.0, -30.0], atol=2e-3)
    with pytest.raises(
        ColumnError, match="'/none' is no topic that can be read; topics are"
    ):
        read_log(folder, ColumnMapping(reference_topic="/none"), required=["depth"])


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
@given(data=st.binary(min_size=0, max_size=200))
def test_noise_is_refused_or_gives_numbers(data):
    decoder = TopicDecoder(BagTopic("/j", "sensor_msgs/msg/JointState", "cdr"))
    try:
        content = decoder.decode(b"\0\1\0\0" + data)
    except FormatError:
        return

    assert all(len(values) for values in content.values.values())


def test_columns_are_called_by_topic_and_field():
    for topic, content, names in (
        ("/ft", wrench(1, (1, 2, 3)), ["/ft/force_xyz", "/ft/torque_xyz"]),
        ("/d", message("std_msgs/msg/Float64", 1.0), ["/d"]),
        (
            "/p",
            message("geometry_msgs/msg/Pose2D", 1.0, 2.0, 3.0),
            ["/p/x", "/p/y", "/p/theta"],
        ),
        ("/v", message("geometry_msgs/msg/Vector3", 1.0, 2.0, 3.0), ["/v/xyz"]),
    ):
        kind = content.__msgtype__
        decoder = TopicDecoder(BagTopic(topic, kind, "cdr"))
        assert (
            list(decoder.decode(bytes(TYPES.serialize_cdr(content, kind))).values)
            == names
        )
