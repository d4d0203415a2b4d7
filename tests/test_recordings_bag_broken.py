"""Broken bags yield what is readable and say what was lost; nothing else happens to them."""

import re
import shutil
import sqlite3
from contextlib import closing

import numpy as np
import pytest
from bag_samples import data_file, insertion_rows, write_bag
from hypothesis import given, settings
from hypothesis import strategies as st
from residual_command_log import insertion

from needleforce.recordings import FormatError, RecordingError, read_table, write_table
from needleforce.recordings.bag_storage import bag_files
from recordings.bag_storage.mcap_compression import decompressed
from needleforce.recordings.bag_storage import bag_messages
from needleforce.recordings.table import Labels
from residual.__main__ import main as estimate

COUNT = 6000
KINDS = {
    "mcap": ("mcap", None),
    "zstd": ("mcap", "STORAGE"),
    "sqlite3": ("sqlite3", None),
    "packed": ("sqlite3", "MESSAGE"),
}


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    """One bag of each kind, with several chunks or many pages: its file's bytes and name."""
    folder = tmp_path_factory.mktemp("bags")
    made = {}
    for kind, (storage, compression) in KINDS.items():
        bag = write_bag(
            folder / kind, insertion_rows(COUNT), storage=storage, compression=compression
        )
        made[kind] = (data_file(bag).name, data_file(bag).read_bytes())
    return made


def messages_in(path):
    faults = []
    found = [(m.topic.name, m.log_ns) for m in bag_messages(bag_files(path), faults)]
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
@given(kind=st.sampled_from(tuple(KINDS)), share=st.floats(0.0, 1.0))
def test_a_cut_bag_yields_what_came_before_the_cut(tmp_path_factory, bags, whole, kind, share):
    name, data = bags[kind]
    path = tmp_path_factory.mktemp("cut") / name
    path.write_bytes(data[: int(share * len(data))])
    try:
        found, faults = messages_in(path)
    except FormatError:
        # Not even the first hundred bytes are there, which say what the file is.
        is_header_left = path.stat().st_size >= 100
        assert not is_header_left
        return
    # A page of SQLite is filled from its end: the last one may lack messages in its middle.
    solid = max(len(found) - (100 if kind in ("sqlite3", "packed") else 0), 0)
    is_prefix = found[:solid] == whole[kind][:solid]
    is_part = set(found) <= set(whole[kind])
    is_told = bool(faults) or len(found) == len(whole[kind])
    assert is_prefix
    assert is_part
    assert is_told


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("share", [0.2, 0.5, 0.8, 0.95])
def test_nearly_all_that_lies_before_the_cut_is_read(tmp_path, bags, whole, kind, share):
    """What a chunk or a page at the cut still holds counts: no chunk is thrown away as a whole."""
    name, data = bags[kind]
    (tmp_path / name).write_bytes(data[: int(share * len(data))])
    found, faults = messages_in(tmp_path / name)
    # In a compressed chunk the last block of 128 KiB cannot be unpacked in part.
    slack = 0.15 if kind == "zstd" else 0.03
    assert len(found) >= (share - slack) * len(whole[kind])
    (fault,) = faults
    assert fault == f"{name} is cut short"


@pytest.mark.parametrize("kind", ["mcap", "sqlite3"])
def test_the_warning_counts_what_was_read_and_what_was_lost(tmp_path, kind):
    storage, _ = KINDS[kind]
    folder = write_bag(tmp_path / "bag", insertion_rows(2000), storage=storage)
    path = data_file(folder)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    warning = read_table(folder).warnings[0]
    told = re.fullmatch(
        rf"{path.name} is cut short: (\d+) messages from ([\d.]+) s to ([\d.]+) s \(([\d.]+) s\) "
        r"could be read, (\d+) of 4400 are lost",
        warning,
    )
    assert told, warning
    assert int(told[1]) + int(told[5]) == 4400
    assert float(told[2]) == pytest.approx(1_700_000_000.123, abs=1e-3)
    assert float(told[4]) == pytest.approx(int(told[1]) / 2200, abs=0.02)
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


def test_a_missing_file_of_a_bag_is_told(tmp_path):
    folder = write_bag(tmp_path / "bag", insertion_rows(100))
    shutil.copy(folder / "bag.mcap", folder / "bag_1.mcap")
    text = (folder / "metadata.yaml").read_text()
    listed = "relative_file_paths:\n  - bag.mcap"
    (folder / "metadata.yaml").write_text(text.replace(listed, f"{listed}\n  - bag_2.mcap"))
    table = read_table(folder)
    assert table.warnings[0] == "files of the bag that are missing: bag_2.mcap"
    assert table.columns["t_s"].size == 100


def test_messages_that_a_killed_recorder_left_beside_the_file_are_read(tmp_path):
    import sqlite3

    folder = write_bag(tmp_path / "bag", insertion_rows(20), storage="sqlite3")
    path = data_file(folder)
    writer = sqlite3.connect(path)
    writer.execute("PRAGMA journal_mode=WAL")
    writer.execute(
        "INSERT INTO messages SELECT 1000, topic_id, timestamp, data FROM messages LIMIT 1"
    )
    writer.commit()
    killed = tmp_path / "killed"
    shutil.copytree(folder, killed)
    writer.close()
    found, faults = messages_in(killed)
    assert len(found) == 45
    assert faults == []


@settings(max_examples=30)
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
def test_the_command_goes_on_with_what_is_left(tmp_path, lwr, capsys, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    columns = {n: v for n, v in insertion(lwr).items() if n != "tau_ext_Nm"}
    write_table(name, columns, labels=Labels(joint_names=lwr.joint_names))
    path = data_file(name) if name.endswith("db3") else tmp_path / name
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 3 // 4])
    shutil.move(path, tmp_path / f"cut{path.suffix}")
    assert estimate([f"cut{path.suffix}", "--no-tare", "-o", "forces.npz"]) == 0
    (told,) = capsys.readouterr().err.splitlines()
    assert told.startswith(f"warning: cut{path.suffix} is cut short: ")
    assert 2000 < np.load("forces.npz")["t_s"].size < 4000


@pytest.mark.parametrize("name", ["x.mcap", "x.db3"])
def test_an_empty_file_is_refused(tmp_path, name):
    (tmp_path / name).write_bytes(b"")
    with pytest.raises(FormatError, match=f"{name} is empty"):
        read_table(tmp_path / name)


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_a_cut_chunk_is_unpacked_as_far_as_it_goes(compression):
    data = np.random.default_rng(0).integers(0, 50, 1_000_000).astype(np.uint8).tobytes()
    if compression == "zstd":
        from recordings.bag_storage.mcap_compression import zstd_library

        packed = zstd_library().compress(data)
    else:
        import lz4.frame

        packed = lz4.frame.compress(data)
    assert decompressed(packed, compression) == (data, True)
    for share in (0.3, 0.9):
        part, is_sound = decompressed(packed[: int(share * len(packed))], compression)
        assert not is_sound
        assert data.startswith(part)
        assert len(part) > (share - 0.2) * len(data)


def test_another_compression_is_refused():
    with pytest.raises(FormatError, match="compressed with 'snappy'; zstd and lz4 can be read"):
        decompressed(b"", "snappy")


def test_a_damaged_first_chunk_costs_that_chunk_only(tmp_path, bags):
    """The types and topics stand in the first chunk; they are known from the end of the file."""
    name, data = bags["mcap"]
    start = data.index(b"string frame_id")
    (tmp_path / name).write_bytes(data[:start] + b"\xff" * 3000 + data[start + 3000 :])
    found, faults = messages_in(tmp_path / name)
    assert {topic for topic, _ in found} == {"/joint_states", "/ft/wrench", "/depth_mm", "/log"}
    assert len(found) > COUNT // 2
    assert faults


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ("UPDATE messages SET data = 'text' WHERE id = 3", "has 1 messages whose time stamp or"),
        ("UPDATE messages SET timestamp = 'text' WHERE id < 3", "has 2 messages whose time stamp"),
        ("UPDATE topics SET name = x'00ff' WHERE id = 1", "has a topic, number 1, whose name"),
    ],
)
def test_values_of_another_type_in_an_sqlite_bag_are_left_out_and_told(tmp_path, change, told):
    path = data_file(write_bag(tmp_path / "bag", insertion_rows(40), storage="sqlite3"))
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute(change)
    table = read_table(path)
    assert told in " ".join(table.warnings)
    assert len(table.columns["t_s"]) > 3
