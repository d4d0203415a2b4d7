"""Broken bags yield what is readable and report what was lost; nothing else happens to them."""

import re
import shutil
import sqlite3
from contextlib import closing

import numpy as np
import pytest
from bag_samples import STEP_NS, TYPES, data_file, insertion_rows, joint_state, write_bag
from hypothesis import given, settings
from hypothesis import strategies as st

from needleforce.recordings import FormatError, RecordingError, read_log, read_table, write_table
from needleforce.recordings.bag_storage import bag_files, bag_messages
from needleforce.recordings.errors import MAX_BYTES

COUNT = 6000
KINDS = {
    "mcap": ("mcap", None),
    "zstd": ("mcap", "STORAGE"),
    "sqlite3": ("sqlite3", None),
    "packed": ("sqlite3", "MESSAGE"),
}
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
    found = [(m.topic.name, m.log_ns) for m in bag_messages(bag_files(path), faults, MAX_BYTES)]
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


@settings(max_examples=30)
@given(kind=st.sampled_from(MCAP), share=st.floats(0.0, 1.0))
def test_a_cut_bag_yields_what_came_before_the_cut(tmp_path_factory, bags, whole, kind, share):
    name, data = bags[kind]
    path = tmp_path_factory.mktemp("cut") / name
    path.write_bytes(data[: int(share * len(data))])
    try:
        found, faults = messages_in(path)
    except FormatError:
        assert path.stat().st_size < 8
        return
    assert found == whole[kind][: len(found)]
    assert bool(faults) or len(found) == len(whole[kind])


@pytest.mark.parametrize("kind", MCAP)
@pytest.mark.parametrize("share", [0.2, 0.5, 0.8, 0.95])
def test_nearly_all_that_lies_before_the_cut_is_read(tmp_path, bags, whole, kind, share):
    """What a chunk at the cut still holds counts: no chunk is thrown away as a whole."""
    name, data = bags[kind]
    (tmp_path / name).write_bytes(data[: int(share * len(data))])
    found, faults = messages_in(tmp_path / name)
    # In a compressed chunk the last block of 128 KiB cannot be unpacked in part.
    slack = 0.15 if kind == "zstd" else 0.03
    assert len(found) >= (share - slack) * len(whole[kind])
    assert faults == [f"{name} is cut short"]


@pytest.mark.parametrize("kind", ["sqlite3", "packed"])
@pytest.mark.parametrize("share", [0.001, 0.3, 0.99])
def test_a_cut_sqlite_bag_is_refused_with_what_may_recover_it(tmp_path, bags, kind, share):
    name, data = bags[kind]
    (tmp_path / name).write_bytes(data[: int(share * len(data))])
    with pytest.raises(FormatError, match=rf"{name} is cut short; .*sqlite3 {name} \.recover"):
        read_table(tmp_path / name)


def test_the_warning_counts_what_was_read_and_what_was_lost(tmp_path):
    folder = write_bag(tmp_path / "bag", insertion_rows(2000))
    path = data_file(folder)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    warning = read_table(folder).warnings[0]
    reported = re.fullmatch(
        rf"{path.name} is cut short: (\d+) messages from ([\d.]+) s to ([\d.]+) s \(([\d.]+) s\) "
        r"could be read, (\d+) of 4400 are lost",
        warning,
    )
    assert reported, warning
    assert int(reported[1]) + int(reported[5]) == 4400
    assert float(reported[2]) == pytest.approx(1_700_000_000.123, abs=1e-3)
    assert float(reported[4]) == pytest.approx(int(reported[1]) / 2200, abs=0.02)
    shutil.copy(path, tmp_path / path.name)
    (alone,) = [w for w in read_table(tmp_path / path.name).warnings if "cut short" in w]
    assert alone.endswith("could be read, what came after, if anything, is lost")


def test_a_bag_that_was_not_finished_is_read_without_metadata(tmp_path):
    folder = write_bag(tmp_path / "bag", insertion_rows(100))
    (folder / "metadata.yaml").unlink()
    table = read_table(folder)
    assert table.columns["t_s"].size == 100
    assert "the bag has no metadata.yaml" in table.warnings[0]
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information: [")
    assert "metadata.yaml is damaged and was left aside" in read_table(folder).warnings


def test_a_missing_file_of_a_bag_is_reported(tmp_path):
    folder = write_bag(tmp_path / "bag", insertion_rows(100))
    shutil.copy(folder / "bag.mcap", folder / "bag_1.mcap")
    text = (folder / "metadata.yaml").read_text()
    listed = "relative_file_paths:\n  - bag.mcap"
    (folder / "metadata.yaml").write_text(text.replace(listed, f"{listed}\n  - bag_2.mcap"))
    table = read_table(folder)
    assert table.warnings[0] == "files of the bag that are missing: bag_2.mcap"
    assert table.columns["t_s"].size == 100


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


@pytest.mark.parametrize("name", ["x.mcap", "x.db3"])
def test_an_empty_file_is_refused(tmp_path, name):
    (tmp_path / name).write_bytes(b"")
    with pytest.raises(FormatError, match=f"{name} is empty"):
        read_table(tmp_path / name)


def test_a_compression_that_is_not_known_is_refused(tmp_path, bags):
    name, data = bags["zstd"]
    (tmp_path / name).write_bytes(data.replace(b"zstd", b"lzma", 1))
    with pytest.raises(FormatError, match="compressed with 'lzma'; zstd and lz4 can be read"):
        read_table(tmp_path / name)


def test_a_damaged_first_chunk_costs_that_chunk_only(tmp_path, bags):
    """The types and topics stand in the first chunk; they are known from the end of the file."""
    name, data = bags["mcap"]
    start = data.index(b"string frame_id")
    (tmp_path / name).write_bytes(data[:start] + b"\xff" * 3000 + data[start + 3000 :])
    found, faults = messages_in(tmp_path / name)
    assert {topic for topic, _ in found} == {"/joint_states", "/ft/wrench", "/depth_mm", "/log"}
    assert len(found) > COUNT // 2
    assert faults


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


@pytest.mark.parametrize("suffix", ["mcap", "parquet"])
def test_no_bit_that_flips_in_a_file_of_ours_changes_a_number_unnoticed(tmp_path, suffix):
    rng = np.random.default_rng(0)
    path = tmp_path / f"log.{suffix}"
    t_s = np.arange(400) / 1000
    write_table(path, {"t_s": t_s, "force_N": rng.normal(size=400)})
    data, right = path.read_bytes(), read_log(path)["force_N"]
    unnoticed = 0
    for place in rng.integers(0, 8 * len(data), 100).tolist():
        damaged = bytearray(data)
        damaged[place // 8] ^= 1 << place % 8
        path.write_bytes(damaged)
        try:
            log = read_log(path)
        except RecordingError:
            continue
        is_right = np.array_equal(log["force_N"], right) and np.array_equal(log.t_s, t_s)
        unnoticed += not (is_right or log.warnings)
    assert unnoticed == 0


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


@pytest.mark.parametrize("names", [("", "", ""), ("a", "a", "a"), ("a", "", "b")])
def test_joints_whose_names_identify_none_keep_their_places(tmp_path, names):
    rows = [("/j", k, joint_state(k + 1, names, [k, 2 * k, 3 * k])) for k in range(1, 5)]
    log = read_log(write_bag(tmp_path / "bag", rows), required=["q"], joints=["x", "y", "z"])
    np.testing.assert_array_equal(log["q_rad"], [[k, 2 * k, 3 * k] for k in range(1, 5)])


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ("UPDATE messages SET data = 'text' WHERE id = 3", "has 1 messages whose time stamp or"),
        ("UPDATE messages SET timestamp = 'text' WHERE id < 3", "has 2 messages whose time stamp"),
        ("UPDATE topics SET name = x'00ff' WHERE id = 1", "has a topic, number 1, whose name"),
    ],
)
def test_values_of_another_type_in_an_sqlite_bag_are_left_out_and_reported(tmp_path, change, fault):
    path = data_file(write_bag(tmp_path / "bag", insertion_rows(40), storage="sqlite3"))
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute(change)
    table = read_table(path)
    assert fault in " ".join(table.warnings)
    assert len(table.columns["t_s"]) > 3


@pytest.mark.parametrize("size", [1 << 29, 1 << 40, (1 << 64) - 1])
def test_a_record_of_a_size_that_cannot_be_costs_what_follows_only(tmp_path, bags, size):
    name, data = bags["mcap"]
    at = 8
    for _ in ("header", "first chunk"):
        at += 9 + int.from_bytes(data[at + 1 : at + 9], "little")
    record = b"\x05" + size.to_bytes(8, "little")
    (tmp_path / name).write_bytes(data[:at] + record + data[at:])
    found, faults = messages_in(tmp_path / name)
    assert len(found) > 1000
    assert faults == [f"{name} is damaged at byte {at}; what follows cannot be read"]
