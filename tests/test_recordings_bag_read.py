"""ROS 2 bags as robots record them: stamps, joints by name, topics of different rates."""

import numpy as np
import pytest
from bag_samples import (
    START_NS,
    STEP_NS,
    TYPES,
    data_file,
    insertion_rows,
    joint_state,
    mapped,
    number,
    text,
    wrench,
    write_bag,
)

from needleforce.recordings import (
    ColumnError,
    ColumnMapping,
    FileAccessError,
    FormatError,
    read_log,
    read_table,
    write_table,
)
from needleforce.recordings.bag_reader import bag_tables
from needleforce.recordings.log import LogStream
from needleforce.recordings.mapping import ChannelRequest


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "bag"


@pytest.mark.parametrize(
    ("storage", "compression"),
    [
        ("mcap", None),
        ("mcap", "STORAGE"),
        ("sqlite3", None),
        ("sqlite3", "MESSAGE"),
        ("sqlite3", "FILE"),
        ("mcap", "MESSAGE"),
    ],
)
def test_every_storage_gives_the_same_log(folder, storage, compression):
    write_bag(folder, insertion_rows(50), storage=storage, compression=compression)
    for path in (folder, data_file(folder)):
        log = read_log(path, required=["q", "tau"], optional=["dq"])
        assert log["q_rad"].shape == (50, 3)
        np.testing.assert_array_equal(log["q_rad"][:, 0], np.arange(50.0))
        np.testing.assert_array_equal(log["tau_Nm"], 2.0 * log["q_rad"])
        assert "dq_rad_s" not in log
        assert log.warnings == (
            "q: it reaches 49.2 in SI; if the file is in deg, say unit = 'deg', or --q COLUMN:deg",
        )


def test_source_stamps_are_kept_to_the_nanosecond(folder):
    log = read_log(write_bag(folder, insertion_rows(300)), required=["q"])
    found_ns = log.start_ns + np.rint(log.t_s * 1e9).astype(np.int64)
    assert found_ns.tolist() == [START_NS + k * STEP_NS for k in range(300)]


def test_the_clock_of_a_simulation_is_kept(folder):
    rows = [("/j", 0, joint_state(k * STEP_NS, "ab", [k, k])) for k in range(5, 9)]
    log = read_log(write_bag(folder, rows), required=["q"])
    assert log.start_ns == 0
    assert log.t_s.tolist() == [k * STEP_NS / 1e9 for k in range(5, 9)]


def test_a_stamp_that_was_never_set_is_replaced_by_the_recorders(folder):
    rows = [("/j", k * STEP_NS, joint_state(0, "ab", [k, k])) for k in range(1, 4)]
    log = read_log(write_bag(folder, rows), required=["q"])
    assert log.t_s.tolist() == [k * STEP_NS / 1e9 for k in range(1, 4)]
    assert log.warnings == (
        "/j: messages without a source time stamp; the recorder's was taken: 3",
    )


def test_joints_are_put_in_the_robots_order_by_name(folder):
    write_bag(folder, insertion_rows(4, names=("elbow", "gripper", "base")))
    log = read_log(folder, required=["q", "tau"], joints=["base", "elbow"])
    assert log["q_rad"][1].tolist() == [1.2, 1.0]
    assert log["tau_Nm"][1].tolist() == [2.4, 2.0]
    log = read_log(folder, ColumnMapping(joints=("gripper", "elbow")), joints=["base", "elbow"])
    assert log["q_rad"][1].tolist() == [1.1, 1.0]


def test_joints_under_other_names_keep_the_order_of_the_bag(folder):
    write_bag(folder, insertion_rows(4))
    log = read_log(folder, required=["q"], joints=["x", "y", "z"])
    assert log["q_rad"][0].tolist() == [0.0, 0.1, 0.2]
    assert "has the joints a, b, c, the robot x, y, z" in log.warnings[0]


def test_a_joint_of_the_mapping_that_is_not_there_is_refused(folder):
    write_bag(folder, insertion_rows(4))
    with pytest.raises(ColumnError, match="does not have: z; it has: a, b, c"):
        read_log(folder, ColumnMapping(joints=("a", "z")), required=["q"])


def test_what_is_missing_is_reported_with_what_is_there(folder):
    write_bag(folder, insertion_rows(4))
    with pytest.raises(
        ColumnError, match=r"no column found for force .*Columns are: /joint_states"
    ):
        read_log(folder, required=["depth", "force"])
    with pytest.raises(ColumnError, match="no column '/log'"):
        read_log(folder, mapped(force="/log"), required=["force"])


def test_stamps_out_of_order_are_reported_and_kept(folder):
    rows = [("/j", k, joint_state(s, "ab", [s, s])) for k, s in enumerate([10, 30, 20, 40])]
    log = read_log(write_bag(folder, rows), required=["q"])
    assert log["q_rad"][:, 0].tolist() == [10.0, 30.0, 20.0, 40.0]
    assert "time: stamps running backward: 1" in log.warnings[1]


def test_a_bag_without_numbers_or_messages_is_refused(folder, tmp_path):
    with pytest.raises(FormatError, match=r"no topic with numbers: /log .*holds no numbers"):
        read_log(write_bag(folder, [("/log", 1, text("a"))]))
    with pytest.raises(FormatError, match="holds no messages"):
        read_log(write_bag(tmp_path / "empty", []))


def test_a_topic_is_read_by_the_definition_in_the_bag(tmp_path):
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    types = get_typestore(Stores.ROS2_HUMBLE)
    definition = "std_msgs/Header header\nfloat64[3] tau_j\ngeometry_msgs/Point tip\nint8 mode\n"
    types.register(get_types_from_msg(definition, "arm_msgs/msg/State"))
    stamp = types.types["builtin_interfaces/msg/Time"](0, 5)
    state = types.types["arm_msgs/msg/State"](
        types.types["std_msgs/msg/Header"](stamp, "base"),
        np.array([1.0, 2.0, 3.0]),
        types.types["geometry_msgs/msg/Point"](4.0, 5.0, 6.0),
        -7,
    )
    with Writer(tmp_path / "bag", version=8, storage_plugin=StoragePlugin.SQLITE3) as bag:
        connection = bag.add_connection("/arm", "arm_msgs/msg/State", typestore=types)
        bag.write(connection, 9, types.serialize_cdr(state, "arm_msgs/msg/State"))
    table = read_table(tmp_path / "bag")
    found = {name: values.tolist() for name, values in table.columns.items()}
    assert found == {
        "t_s": [5e-9],
        "/arm/tau_j": [[1.0, 2.0, 3.0]],
        "/arm/tip_xyz": [[4.0, 5.0, 6.0]],
        "/arm/mode": [-7.0],
    }


def test_a_bag_split_into_files_is_one_log(tmp_path):
    rows = list(insertion_rows(60))
    parts = [write_bag(tmp_path / f"part_{i}", rows[i * 44 : (i + 1) * 44]) for i in range(3)]
    whole = tmp_path / "whole"
    whole.mkdir()
    for i, part in enumerate(parts):
        data_file(part).rename(whole / f"whole_{9 + i}.mcap")
    log = read_log(whole, required=["q"])
    np.testing.assert_array_equal(log["q_rad"][:, 0], np.arange(60.0))
    assert "the bag has no metadata.yaml: its recorder did not finish it" in log.warnings


def test_what_is_no_bag_is_refused(tmp_path):
    for name in ("x.mcap", "x.db3"):
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


def test_an_sqlite_file_that_is_no_bag_is_refused(tmp_path):
    import sqlite3

    with sqlite3.connect(tmp_path / "x.db3") as connection:
        connection.execute("CREATE TABLE notes(a)")
    connection.close()
    with pytest.raises(FormatError, match="is not a bag: it has no tables messages and topics"):
        read_log(tmp_path / "x.db3")


def test_messages_that_are_no_ros_messages_are_reported(tmp_path):
    from needleforce.recordings.bag_storage import MAGIC

    def record(opcode, *parts):
        body = b"".join(parts)
        return bytes([opcode]) + len(body).to_bytes(8, "little") + body

    def string(value):
        return len(value).to_bytes(4, "little") + value

    path = tmp_path / "x.mcap"
    channel = (b"\1\0", b"\0\0", string(b"/json"), string(b"json"), b"\0\0\0\0")
    path.write_bytes(
        MAGIC
        + record(1, string(b""), string(b""))
        + record(4, *channel)
        + record(5, b"\1\0", bytes(20), b"{}")
        + record(0x0F, bytes(4))
    )
    with pytest.raises(FormatError, match="is encoded as 'json'; ROS 2 has 'cdr'"):
        read_log(path)


def test_without_rosbags_the_error_says_what_to_install(folder, monkeypatch):
    import sys

    write_bag(folder, insertion_rows(4))
    monkeypatch.setitem(sys.modules, "rosbags.typesys", None)
    with pytest.raises(FileAccessError, match=r"pip install 'needleforce\[recordings\]'"):
        read_log(folder)


def test_a_wrench_is_three_and_three_numbers(folder):
    write_bag(folder, [("/ft", 1, wrench(1, (1, 2, 3), (4, 5, 6)))])
    columns = read_table(folder).columns
    assert columns["/ft/force_xyz"].tolist() == [[1.0, 2.0, 3.0]]
    assert columns["/ft/torque_xyz"].tolist() == [[4.0, 5.0, 6.0]]


def test_names_decide_when_their_order_changes_and_missing_joints_are_nan(folder):
    orders = ["ab", "ba", "a"]
    places = {"a": 1.0, "b": 2.0}
    rows = [
        ("/j", k, joint_state(k + 1, order, [places[name] for name in order]))
        for k, order in enumerate(orders)
    ]
    log = read_log(write_bag(folder, rows), required=["q"])
    np.testing.assert_array_equal(log["q_rad"], [[1.0, 2.0], [1.0, 2.0], [1.0, np.nan]])
    assert "/j: messages that lack joints: 1" in log.warnings


def test_messages_of_a_gripper_on_the_same_topic_are_left_out(folder):
    rows = []
    for k in range(1, 6):
        rows.append(("/j", k, joint_state(10 * k, "ab", [k, k])))
        rows.append(("/j", k, joint_state(10 * k + 5, ["finger"], [0.5])))
    log = read_log(write_bag(folder, rows), required=["q"], joints=["a", "b"])
    np.testing.assert_array_equal(log["q_rad"][:, 0], np.arange(1.0, 6.0))
    assert "/j: messages without any of the joints, left out: 5" in log.warnings


def test_slower_topics_are_interpolated_to_the_stamps_of_the_fastest(folder):
    rows = [("/force", k, number(k)) for k in range(0, 1000, 10)]
    rows += [("/depth", k, number(2.0 * k)) for k in range(0, 1000, 100)]
    log = read_log(write_bag(folder, sorted(rows, key=lambda row: row[1])))
    np.testing.assert_allclose(log["depth_m"][:91], 20.0 * np.arange(91))
    assert np.isnan(log["depth_m"][91:]).all()
    assert "rows are the messages of /force" in log.warnings[0]
    assert "/depth" in log.warnings[0]


def test_the_mapping_may_choose_the_clock(folder):
    write_bag(folder, insertion_rows(40))
    mapping = ColumnMapping(
        reference_topic="/depth_mm", channels=mapped(force="/ft/wrench/force_xyz[2]").channels
    )
    log = read_log(folder, mapping, required=["depth", "force"])
    np.testing.assert_allclose(log["force_N"], [-0.0, -10.0, -20.0, -30.0], atol=2e-3)
    with pytest.raises(ColumnError, match="'/none' is no topic that can be read; topics are"):
        read_log(folder, ColumnMapping(reference_topic="/none"), required=["depth"])


def test_nothing_is_interpolated_across_a_gap(folder):
    rows = [("/force", k * 10_000_000, number(1.0)) for k in range(200)]
    rows += [("/depth", k * 10_000_000, number(0.0)) for k in (*range(50), *range(150, 200))]
    log = read_log(write_bag(folder, sorted(rows, key=lambda row: row[1])))
    assert np.isnan(log["depth_m"][50:150]).all()
    assert np.isfinite(log["depth_m"][:50]).all()


def test_several_topics_that_would_fit_must_be_chosen_from(folder):
    rows = [(topic, k, joint_state(k, "ab", [k, k])) for k in range(1, 4) for topic in ("/l", "/r")]
    write_bag(folder, rows)
    with pytest.raises(
        ColumnError, match=r"several columns would fit \(/l/position, /r/position\)"
    ):
        read_log(folder, required=["q"])
    assert len(read_log(folder, mapped(q="/r/position"), required=["q"])) == 3


def test_of_several_topics_the_one_with_the_joints_of_the_robot_is_read(folder):
    rows = [
        (topic, k, joint_state(k, names, [k, factor * k], [k, k], [k, k]))
        for k in range(1, 4)
        for topic, names, factor in (("/arm", "ab", 2.0), ("/hand", "xy", 3.0))
    ]
    write_bag(folder, rows)
    asked = {"required": ["q", "tau"], "optional": ["dq"]}
    log = read_log(folder, joints=["b", "a"], **asked)
    assert log["q_rad"][:, 0].tolist() == [2.0, 4.0, 6.0]
    assert len(
        list(LogStream(bag_tables(folder, 2, ChannelRequest(joints=("a", "b"), **asked)), **asked))
    )
    with pytest.raises(ColumnError, match="several columns would fit"):
        read_log(folder, joints=["a", "x"], **asked)


def test_a_channel_that_is_mapped_decides_for_those_that_are_not(folder):
    rows = [
        (topic, k, joint_state(k, "ab", [k, k], [k, k], [factor * k, k]))
        for k in range(1, 4)
        for topic, factor in (("/l", 2.0), ("/r", 3.0))
    ]
    write_bag(folder, rows)
    log = read_log(folder, mapped(q="/r/position"), required=["q", "tau"], optional=["dq"])
    assert log["tau_Nm"][:, 0].tolist() == [3.0, 6.0, 9.0]
    assert "dq_rad_s" in log


def test_messages_of_another_length_are_reported(folder):
    array = TYPES.types["std_msgs/msg/Float64MultiArray"]
    layout = TYPES.types["std_msgs/msg/MultiArrayLayout"]([], 0)
    rows = [("/tau", k, array(layout, np.arange(float(n)))) for k, n in enumerate([2, 2, 3, 2])]
    log = read_log(write_bag(folder, rows), required=["tau"])
    np.testing.assert_array_equal(np.isfinite(log["tau_Nm"][:, 0]), [True, True, False, True])
    assert "/tau: messages with another number of values of /tau: 1" in log.warnings


@pytest.mark.parametrize("rows", [1, 7, 64, 1000])
def test_chunks_are_the_bag_in_pieces(folder, rows):
    write_bag(folder, insertion_rows(333))
    wanted = ChannelRequest(mapping=mapped(depth="/depth_mm", force="/ft/wrench/force_xyz[2]"))
    whole = next(bag_tables(folder, None, wanted))
    chunks = list(bag_tables(folder, rows, wanted))
    for name, values in whole.columns.items():
        joined = np.concatenate([chunk.columns[name] for chunk in chunks])
        np.testing.assert_array_equal(joined, values)
    assert [w for chunk in chunks for w in chunk.warnings] == list(whole.warnings)
    assert max(chunk.columns["t_s"].size for chunk in chunks) <= rows


@pytest.mark.parametrize("place", ["run#1", "a?b", "50%20", "ü x", "it's"])
@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_bag_may_stand_in_a_folder_of_any_name(tmp_path, place, storage):
    path = data_file(write_bag(tmp_path / "bag", insertion_rows(20), storage=storage))
    other = tmp_path / place / f"LOG{path.suffix.upper()}"
    other.parent.mkdir()
    path.rename(other)
    assert len(read_log(other, required=["q"])) == 20
    if place in ("run#1", "a?b", "50%20"):
        with pytest.raises(FileAccessError, match=r"needs a path without \?, # and %"):
            write_table(tmp_path / place / "x.db3", {"t_s": [0.0]})
