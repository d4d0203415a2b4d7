"""ROS 2 bags that are cut, damaged or stored in other ways."""

import shutil
import sqlite3
from contextlib import closing
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from needleforce.recordings import (
    FormatError,
    RecordingError,
    read_log,
    read_table,
    write_table,
)
from needleforce.recordings.bags.message_reader import read_messages
from needleforce.recordings.errors import MAX_BYTES
from needleforce.recordings.time_stamps import to_nanoseconds
from tests.needleforce.recordings.bag_samples import (
    START_NS,
    STEP_NS,
    TYPES,
    data_file,
    insertion_rows,
    joint_state,
    write_bag,
)

COUNT = 6000
KINDS = {
    "mcap": ("mcap", None),
    "zstd": ("mcap", "STORAGE"),
    "sqlite3": ("sqlite3", None),
}
MCAP = ("mcap", "zstd")


class ReadBag(NamedTuple):
    """Messages of a bag, each as topic and time of recording, and faults."""

    messages: list
    faults: list


class BagSample(NamedTuple):
    """A bag of one file: its name, its bytes, and its messages."""

    name: str
    data: bytes
    messages: list


def messages_in(path):
    faults = []
    messages = [
        (message.topic.name, message.log_ns)
        for message in read_messages(path, faults, MAX_BYTES)
    ]
    return ReadBag(messages, faults)


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    """One of each kind, of several chunks or pages."""
    folder = tmp_path_factory.mktemp("bags")
    samples = {}
    for kind, (storage, compression) in KINDS.items():
        rows = insertion_rows(COUNT)
        path = data_file(
            write_bag(folder / kind, rows, storage=storage, compression=compression)
        )
        bag = messages_in(path)
        assert bag.faults == []
        assert len(bag.messages) == 2 * COUNT + COUNT // 5
        samples[kind] = BagSample(path.name, path.read_bytes(), bag.messages)

    return samples


@pytest.mark.parametrize("kind", MCAP)
@pytest.mark.parametrize("fraction", [0.0002, 0.2, 0.5, 0.95])
def test_messages_before_the_cut_are_nearly_all_read(tmp_path, bags, kind, fraction):
    sample = bags[kind]
    path = tmp_path / sample.name
    path.write_bytes(sample.data[: int(fraction * len(sample.data))])
    bag = messages_in(path)
    # In a compressed chunk the last block of 128 KiB cannot be unpacked in part.
    slack = 0.15 if kind == "zstd" else 0.03

    assert len(bag.messages) >= (fraction - slack) * len(sample.messages)
    assert bag.faults == [f"{sample.name} is cut short"]


def test_unread_journal_of_a_killed_recorder_is_reported(tmp_path):
    folder = write_bag(tmp_path / "bag", insertion_rows(20), storage="sqlite3")
    writer = sqlite3.connect(data_file(folder))
    writer.execute("PRAGMA journal_mode=WAL")
    writer.execute(
        "INSERT INTO messages "
        "SELECT 1000, topic_id, timestamp, data FROM messages LIMIT 1"
    )
    writer.commit()
    shutil.copytree(folder, tmp_path / "killed")
    writer.close()
    bag = messages_in(tmp_path / "killed")

    assert len(bag.messages) == 44
    assert "bag.db3-wal that are not read" in bag.faults[0]
    assert "sqlite3 bag.db3 'PRAGMA wal_checkpoint'" in bag.faults[0]


@pytest.mark.slow
@settings(max_examples=30)
@given(
    kind=st.sampled_from(tuple(KINDS)),
    where=st.floats(0.0, 1.0, exclude_max=True),
    mask=st.integers(1, 255),
    width=st.integers(1, 200),
)
def test_damaged_bytes_are_read_or_cleanly_refused(
    tmp_path_factory, bags, kind, where, mask, width
):
    sample = bags[kind]
    data = sample.data
    start = int(where * len(data))
    damaged = bytes(byte ^ mask for byte in data[start : start + width])
    path = tmp_path_factory.mktemp("damaged") / sample.name
    path.write_bytes(data[:start] + damaged + data[start + width :])
    try:
        table = read_table(path)
    except RecordingError:
        return

    assert np.isfinite(table.columns["t_s"]).all()


def test_a_compression_that_is_not_known_is_refused(tmp_path, bags):
    sample = bags["zstd"]
    path = tmp_path / sample.name
    path.write_bytes(sample.data.replace(b"zstd", b"lzma", 1))

    with pytest.raises(
        FormatError, match="compressed with 'lzma'; zstd and lz4 can be read"
    ):
        read_table(path)


@pytest.mark.parametrize("kind", MCAP)
@pytest.mark.parametrize("fraction", [0.1, 0.4, 0.7, 0.9])
def test_a_byte_that_is_missing_is_noticed(tmp_path, bags, kind, fraction):
    sample = bags[kind]
    place = int(fraction * len(sample.data))
    path = tmp_path / sample.name
    path.write_bytes(sample.data[:place] + sample.data[place + 1 :])
    bag = messages_in(path)
    count = len(bag.messages)
    is_beginning = bag.messages == sample.messages[:count]

    assert is_beginning or count < len(sample.messages)
    assert f"{sample.name} is damaged at byte" in bag.faults[-1]


@pytest.mark.parametrize("place", [0, 1, 30])
def test_a_damaged_message_costs_that_message_only(tmp_path, place):
    rows = [("/j", k, joint_state(k * STEP_NS + 1, "ab", [k, k])) for k in range(60)]
    path = write_bag(tmp_path / "bag", rows)
    data = bytes(TYPES.serialize_cdr(rows[place][2], "sensor_msgs/msg/JointState"))
    file = data_file(path)

    assert file.read_bytes().count(data) == 1

    file.write_bytes(
        file.read_bytes().replace(data, data[:20] + b"\xff" * (len(data) - 20))
    )
    log = read_log(path, required=["q"])

    assert len(log) == 59
    assert "/j: messages that do not fit their type, left out: 1" in log.warnings


@pytest.mark.parametrize(("storage", "compression"), KINDS.values())
def test_every_storage_and_folder_name_gives_one_log(tmp_path, storage, compression):
    folder = tmp_path / "it's x"
    write_bag(folder, insertion_rows(50), storage=storage, compression=compression)
    for path in (folder, data_file(folder)):
        log = read_log(path, required=["q", "tau"], optional=["dq"])
        np.testing.assert_array_equal(log["q_rad"][:, 0], np.arange(50.0))
        np.testing.assert_array_equal(log["tau_Nm"], 2.0 * log["q_rad"])
        assert "dq_rad_s" not in log
        stamps_ns = to_nanoseconds(log.t_s, log.start_ns).tolist()
        assert stamps_ns == [START_NS + k * STEP_NS for k in range(50)]  # the source's


def test_compressed_bags_are_refused_with_advice(tmp_path):
    rows = list(insertion_rows(5))
    write_bag(tmp_path / "m", rows, storage="sqlite3", compression="MESSAGE")

    with pytest.raises(
        FormatError, match=r"(?s)is compressed message by message.*ros2 bag convert"
    ):
        read_log(tmp_path / "m")

    write_bag(tmp_path / "f.db3", rows, storage="sqlite3", compression="FILE")

    with pytest.raises(
        FormatError, match=r"(?s)without .mcap, .db3 or .bag files.*zstd -d"
    ):
        read_log(tmp_path / "f.db3")


@pytest.mark.parametrize("is_set", [False, True])
def test_small_stamps_stay_and_unset_ones_are_replaced(tmp_path, is_set):
    rows = [
        ("/j", k * STEP_NS, joint_state(k * STEP_NS * is_set, "ab", [k, k]))
        for k in (1, 2, 3)
    ]
    log = read_log(write_bag(tmp_path / "bag", rows), required=["q"])

    assert log.start_ns == 0
    assert log.t_s.tolist() == [k * STEP_NS / 1e9 for k in (1, 2, 3)]

    note = "/j: messages without a source time stamp; the recorder's was taken: 3"

    assert log.warnings == () if is_set else (note,)


@pytest.mark.parametrize(
    "names", [("", "", ""), ("a", "a", "a"), ("a", "", "b"), "abc"]
)
def test_joints_without_identifying_names_keep_their_places(tmp_path, names):
    rows = [
        ("/j", k, joint_state(k + 1, names, [k, 2 * k, 3 * k])) for k in range(1, 5)
    ]
    log = read_log(
        write_bag(tmp_path / "bag", rows), required=["q"], joints=["x", "y", "z"]
    )

    np.testing.assert_array_equal(
        log["q_rad"], [[k, 2 * k, 3 * k] for k in range(1, 5)]
    )

    words = "has the joints a, b, c, the robot x, y, z"

    assert [words in warning for warning in log.warnings] == [True] * (names == "abc")


@pytest.mark.parametrize("fraction", [0.001, 0.3, 0.99])
def test_a_cut_sqlite_bag_error_advises_recovery(tmp_path, bags, fraction):
    name, data, _ = bags["sqlite3"]
    (tmp_path / name).write_bytes(data[: int(fraction * len(data))])

    with pytest.raises(
        FormatError, match=rf"(?s){name} is cut short or .*sqlite3 FILE \.recover"
    ):
        read_table(tmp_path / name)


@pytest.mark.parametrize(
    "change",
    [
        "UPDATE messages SET data = 'text' WHERE id = 3",
        "UPDATE messages SET timestamp = 'text' WHERE id < 3",
        "DROP TABLE messages",
        # A view could run any query, and without end.
        "DROP TABLE messages; "
        "CREATE VIEW messages AS WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL "
        "SELECT i FROM n) SELECT i id, 1 topic_id, 1 timestamp, x'00' data FROM n",
    ],
)
def test_an_sqlite_bag_of_other_content_is_refused(tmp_path, change):
    path = data_file(write_bag(tmp_path / "bag", insertion_rows(40), storage="sqlite3"))
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.executescript(change)

    with pytest.raises(
        FormatError, match=r"(?s)damaged .*\.recover|no tables messages and topics"
    ):
        read_table(path)


def test_a_chunk_with_wrong_checksum_is_omitted(tmp_path):
    path = tmp_path / "x.mcap"
    q_rad = np.random.default_rng(0).normal(size=(5000, 7))
    write_table(path, {"t_s": np.arange(5000) / 1000, "q_rad": q_rad})
    whole = len(read_log(path))
    data = bytearray(path.read_bytes())
    data[len(data) * 6 // 10] ^= 1
    path.write_bytes(data)
    log = read_log(path)

    assert 0 < len(log) < whole
    assert (
        "x.mcap has a chunk whose checksum is wrong, which was left out"
        in log.warnings[0]
    )
