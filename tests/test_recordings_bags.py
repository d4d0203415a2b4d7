"""ROS 2 bags as robots record them, whole and broken: stamps, joints by name, topics as columns."""

import re
import shutil
import sqlite3
import sys
from contextlib import closing

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
    message,
    number,
    text,
    wrench,
    write_bag,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from needleforce.recordings import (
    ColumnError,
    ColumnMapping,
    FileAccessError,
    FormatError,
    RecordingError,
    read_log,
    read_table,
    write_table,
)
from needleforce.recordings.bag_messages import BagTopic, bag_messages
from needleforce.recordings.bag_reader import bag_tables
from needleforce.recordings.bag_types import TopicDecoder
from needleforce.recordings.errors import MAX_BYTES
from needleforce.recordings.log import LogStream
from needleforce.recordings.mapping import ChannelRequest


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "bag"


def test_source_stamps_are_kept_to_the_nanosecond(folder):
    log = read_log(write_bag(folder, insertion_rows(300)), required=["q"])
    found_ns = log.start_ns + np.rint(log.t_s * 1e9).astype(np.int64)
    assert found_ns.tolist() == [START_NS + k * STEP_NS for k in range(300)]


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


def test_a_bag_without_numbers_or_messages_is_refused(folder, tmp_path):
    with pytest.raises(FormatError, match=r"no topic with numbers: /log .*holds no numbers"):
        read_log(write_bag(folder, [("/log", 1, text("a"))]))
    with pytest.raises(FormatError, match="holds no messages"):
        read_log(write_bag(tmp_path / "empty", []))


def test_a_topic_is_read_by_the_definition_in_the_bag(tmp_path):
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import get_types_from_msg

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


JOINT_STATE = "sensor_msgs/msg/JointState"


def made(content, **options):
    return bytes(TYPES.serialize_cdr(content, content.__msgtype__, **options))


def decoded(content, topic="/x", **options):
    decoder = TopicDecoder(BagTopic(topic, content.__msgtype__, "cdr"))
    return decoder.decode(made(content, **options))


@given(data=st.binary(min_size=0, max_size=200))
def test_noise_is_refused_or_gives_numbers(data):
    try:
        found = TopicDecoder(BagTopic("/j", JOINT_STATE, "cdr")).decode(b"\0\1\0\0" + data)
    except FormatError:
        return
    assert all(len(values) for values in found.values.values())


def test_columns_are_called_by_topic_and_field():
    for topic, content, names in (
        ("/ft", wrench(1, (1, 2, 3)), ["/ft/force_xyz", "/ft/torque_xyz"]),
        ("/d", message("std_msgs/msg/Float64", 1.0), ["/d"]),
        ("/p", message("geometry_msgs/msg/Pose2D", 1.0, 2.0, 3.0), ["/p/xy", "/p/theta"]),
        ("/v", message("geometry_msgs/msg/Vector3", 1.0, 2.0, 3.0), ["/v/xyz"]),
    ):
        assert list(decoded(content, topic).values) == names


COUNT = 6000
KINDS = {"mcap": ("mcap", None), "zstd": ("mcap", "STORAGE"), "sqlite3": ("sqlite3", None)}
MCAP = ("mcap", "zstd")


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    """One bag of each kind, with several chunks or many pages: its file's bytes and name."""
    folder = tmp_path_factory.mktemp("bags")
    made = {}
    for kind, (storage, compression) in KINDS.items():
        rows = insertion_rows(COUNT)
        bag = write_bag(folder / kind, rows, storage=storage, compression=compression)
        made[kind] = (data_file(bag).name, data_file(bag).read_bytes())
    return made


def messages_in(path):
    faults = []
    found = [(m.topic.name, m.log_ns) for m in bag_messages(path, faults, MAX_BYTES)]
    return found, faults


@pytest.fixture(scope="module")
def whole(bags, tmp_path_factory):
    """What an intact bag holds, in order."""
    folder = tmp_path_factory.mktemp("whole")
    found = {}
    for kind, (name, data) in bags.items():
        (folder / name).write_bytes(data)
        found[kind], faults = messages_in(folder / name)
        assert faults == []
        assert len(found[kind]) == 2 * COUNT + COUNT // 5
    return found


@pytest.mark.parametrize("kind", MCAP)
@pytest.mark.parametrize("share", [0.0002, 0.2, 0.5, 0.95])
def test_nearly_all_that_lies_before_the_cut_is_read(tmp_path, bags, whole, kind, share):
    """What a chunk at the cut still holds counts: no chunk is thrown away as a whole."""
    name, data = bags[kind]
    (tmp_path / name).write_bytes(data[: int(share * len(data))])
    found, faults = messages_in(tmp_path / name)
    # In a compressed chunk the last block of 128 KiB cannot be unpacked in part.
    slack = 0.15 if kind == "zstd" else 0.03
    assert len(found) >= (share - slack) * len(whole[kind])
    assert faults == [f"{name} is cut short"]


def test_messages_that_a_killed_recorder_left_beside_the_file_are_reported(tmp_path):
    folder = write_bag(tmp_path / "bag", insertion_rows(20), storage="sqlite3")
    writer = sqlite3.connect(data_file(folder))
    writer.execute("PRAGMA journal_mode=WAL")
    writer.execute(
        "INSERT INTO messages SELECT 1000, topic_id, timestamp, data FROM messages LIMIT 1"
    )
    writer.commit()
    shutil.copytree(folder, tmp_path / "killed")
    writer.close()
    found, faults = messages_in(tmp_path / "killed")
    assert len(found) == 44
    assert "bag.db3-wal that are not read" in faults[0]
    assert "sqlite3 bag.db3 'PRAGMA wal_checkpoint'" in faults[0]


@settings(max_examples=60)
@given(
    kind=st.sampled_from(tuple(KINDS)),
    where=st.floats(0.0, 1.0, exclude_max=True),
    mask=st.integers(1, 255),
    width=st.integers(1, 200),
)
def test_damaged_bytes_end_in_a_table_or_in_one_of_our_errors(
    tmp_path_factory, bags, kind, where, mask, width
):
    name, data = bags[kind]
    start = int(where * len(data))
    damaged = bytes(byte ^ mask for byte in data[start : start + width])
    path = tmp_path_factory.mktemp("damaged") / name
    path.write_bytes(data[:start] + damaged + data[start + width :])
    try:
        table = read_table(path)
    except RecordingError:
        return
    assert np.isfinite(table.columns["t_s"]).all()


def test_a_compression_that_is_not_known_is_refused(tmp_path, bags):
    name, data = bags["zstd"]
    (tmp_path / name).write_bytes(data.replace(b"zstd", b"lzma", 1))
    with pytest.raises(FormatError, match="compressed with 'lzma'; zstd and lz4 can be read"):
        read_table(tmp_path / name)


@pytest.mark.parametrize("kind", MCAP)
@pytest.mark.parametrize("share", [0.1, 0.4, 0.7, 0.9])
def test_a_byte_that_is_missing_is_noticed(tmp_path, bags, whole, kind, share):
    """After it, any bytes stand where a record should begin; none of them is the regular end."""
    name, data = bags[kind]
    at = int(share * len(data))
    (tmp_path / name).write_bytes(data[:at] + data[at + 1 :])
    found, faults = messages_in(tmp_path / name)
    assert found == whole[kind][: len(found)] or len(found) < len(whole[kind])
    assert f"{name} is damaged at byte" in faults[-1]


@pytest.mark.parametrize("place", [0, 1, 30])
def test_a_damaged_message_costs_that_message_only(tmp_path, place):
    rows = [("/j", k, joint_state(k * STEP_NS + 1, "ab", [k, k])) for k in range(60)]
    path = write_bag(tmp_path / "bag", rows)
    data = bytes(TYPES.serialize_cdr(rows[place][2], "sensor_msgs/msg/JointState"))
    file = data_file(path)
    assert file.read_bytes().count(data) == 1
    file.write_bytes(file.read_bytes().replace(data, data[:20] + b"\xff" * (len(data) - 20)))
    log = read_log(path, required=["q"])
    assert len(log) == 59
    assert "/j: messages that do not fit their type, left out: 1" in log.warnings


@pytest.mark.parametrize(
    ("storage", "compression"), [("mcap", None), ("mcap", "STORAGE"), ("sqlite3", None)]
)
@pytest.mark.parametrize("place", ["bag", "run#1", "ü x", "it's"])
def test_every_storage_gives_the_same_log_in_a_folder_of_any_name(
    tmp_path, storage, compression, place
):
    write_bag(tmp_path / "made", insertion_rows(50), storage=storage, compression=compression)
    folder = (tmp_path / "made").rename(tmp_path / place)
    if storage == "sqlite3" and "#" in place:
        with pytest.raises(FileAccessError, match=r"needs a path without \?, # and %"):
            read_log(folder)
        return
    for path in (folder, data_file(folder)):
        log = read_log(path, required=["q", "tau"], optional=["dq"])
        np.testing.assert_array_equal(log["q_rad"][:, 0], np.arange(50.0))
        np.testing.assert_array_equal(log["tau_Nm"], 2.0 * log["q_rad"])
        assert "dq_rad_s" not in log
        assert log.warnings == (
            "q: it reaches 49.2 in SI; if the file is in deg, say unit = 'deg', or --q COLUMN:deg",
        )


def test_bags_compressed_by_file_or_message_are_refused_with_what_to_do(tmp_path):
    rows = list(insertion_rows(5))
    write_bag(tmp_path / "m", rows, storage="sqlite3", compression="MESSAGE")
    with pytest.raises(FormatError, match=r"is compressed message by message; .*ros2 bag convert"):
        read_log(tmp_path / "m")
    write_bag(tmp_path / "f.db3", rows, storage="sqlite3", compression="FILE")
    with pytest.raises(FormatError, match=r"\.zstd must be unpacked: zstd -d"):
        read_log(tmp_path / "f.db3")


@pytest.mark.parametrize("is_set", [False, True])
def test_small_stamps_are_kept_and_those_never_set_are_the_recorders(folder, is_set):
    rows = [("/j", k * STEP_NS, joint_state(k * STEP_NS * is_set, "ab", [k, k])) for k in (1, 2, 3)]
    log = read_log(write_bag(folder, rows), required=["q"])
    assert log.start_ns == 0
    assert log.t_s.tolist() == [k * STEP_NS / 1e9 for k in (1, 2, 3)]
    note = "/j: messages without a source time stamp; the recorder's was taken: 3"
    assert log.warnings == () if is_set else (note,)


@pytest.mark.parametrize("names", [("", "", ""), ("a", "a", "a"), ("a", "", "b")])
def test_joints_whose_names_identify_none_keep_their_places(folder, names):
    rows = [("/j", k, joint_state(k + 1, names, [k, 2 * k, 3 * k])) for k in range(1, 5)]
    log = read_log(write_bag(folder, rows), required=["q"], joints=["x", "y", "z"])
    np.testing.assert_array_equal(log["q_rad"], [[k, 2 * k, 3 * k] for k in range(1, 5)])


@pytest.mark.parametrize("rows", [1, 64, 1000])
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


def test_the_warning_counts_what_was_read(tmp_path):
    path = data_file(write_bag(tmp_path / "bag", insertion_rows(2000)))
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    reported = re.fullmatch(
        rf"{path.name} is cut short: (\d+) messages from ([\d.]+) s to ([\d.]+) s "
        r"could be read, what came after, if anything, is lost",
        read_table(path).warnings[0],
    )
    assert reported
    assert float(reported[2]) == pytest.approx(1_700_000_000.123, abs=1e-3)
    span_s = float(reported[3]) - float(reported[2])
    assert span_s == pytest.approx(int(reported[1]) / 2200, abs=0.02)


@pytest.mark.parametrize("share", [0.001, 0.3, 0.99])
def test_a_cut_sqlite_bag_is_refused_with_what_may_recover_it(tmp_path, bags, share):
    name, data = bags["sqlite3"]
    (tmp_path / name).write_bytes(data[: int(share * len(data))])
    with pytest.raises(FormatError, match=rf"{name} is cut short or .*sqlite3 {name} \.recover"):
        read_table(tmp_path / name)


@pytest.mark.parametrize(
    "change",
    [
        "UPDATE messages SET data = 'text' WHERE id = 3",
        "UPDATE messages SET timestamp = 'text' WHERE id < 3",
        "UPDATE topics SET name = x'00ff' WHERE id = 1",
        "DROP TABLE messages",
    ],
)
def test_values_of_another_type_in_an_sqlite_bag_are_refused(tmp_path, change):
    path = data_file(write_bag(tmp_path / "bag", insertion_rows(40), storage="sqlite3"))
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute(change)
    with pytest.raises(FormatError, match=r"damaged .*\.recover|no tables messages and topics"):
        read_table(path)


def test_a_chunk_whose_checksum_is_wrong_is_left_out(tmp_path):
    path = tmp_path / "x.mcap"
    force_N = np.random.default_rng(0).normal(size=50_000)
    write_table(path, {"t_s": np.arange(50_000) / 1000, "force_N": force_N})
    whole, data = len(read_log(path)), bytearray(path.read_bytes())
    data[len(data) * 6 // 10] ^= 1
    path.write_bytes(data)
    log = read_log(path)
    assert 0 < len(log) < whole
    assert "x.mcap has a chunk whose checksum is wrong, which was left out" in log.warnings[0]


def test_without_rosbags_the_error_says_what_to_install(folder, monkeypatch):
    write_bag(folder, insertion_rows(4))
    monkeypatch.setitem(sys.modules, "rosbags.typesys", None)
    with pytest.raises(FileAccessError, match=r"pip install 'needleforce\[recordings\]'"):
        read_log(folder)
