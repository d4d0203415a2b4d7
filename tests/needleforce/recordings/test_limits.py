"""Hostile and damaged files end in one of our errors, soon and within bounded
memory."""

import gzip
import time
import tomllib
import tracemalloc
from contextlib import contextmanager

import lz4.frame
import numpy as np
import pyarrow as pa
import pyarrow.compute
import pyarrow.parquet as pq
import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Chunk, DataEnd, Message, Schema

from needleforce.recordings import (
    FileAccessError,
    FollowOptions,
    FormatError,
    load_mapping,
    read_log,
    read_table,
    stream_tables,
    write_table,
)
from needleforce.recordings.bags.mcap_file import MAGIC
from needleforce.recordings.csv_file import csv_tables
from needleforce.recordings.errors import MAX_BYTES
from needleforce.recordings.mapping_suggestion import suggest_mapping
from tests.needleforce.recordings.bag_samples import number, write_bag

SMALL = 8 << 20  # bytes
BOMB = 64 << 20


@contextmanager
def bounded(peak=6 * SMALL, seconds=10.0):
    """What runs inside takes little memory and time."""
    start_s = time.monotonic()
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < peak
    finally:
        tracemalloc.stop()

    assert time.monotonic() - start_s < seconds


def mcap_file(path, *records):
    builder = RecordBuilder()
    for record in (*records, DataEnd(0)):
        record.write(builder)

    path.write_bytes(MAGIC + builder.end())
    return path


PACKERS = {"zstd": zstandard.compress, "lz4": lz4.frame.compress}


@pytest.mark.parametrize("compression", PACKERS)
@pytest.mark.parametrize("declared", [BOMB, 100])
def test_a_chunk_unpacking_beyond_the_limit_is_refused(tmp_path, compression, declared):
    zeros = dict.fromkeys(
        ("message_start_time", "message_end_time", "uncompressed_crc"), 0
    )
    packed = {"data": PACKERS[compression](bytes(BOMB)), "compression": compression}
    chunk = Chunk(**packed, uncompressed_size=declared, **zeros)
    path = mcap_file(tmp_path / "x.mcap", chunk)

    with (
        bounded(),
        pytest.raises(FormatError, match=r"raise `max_bytes`|holds no messages"),
    ):
        read_table(path, max_bytes=SMALL)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("lines", "seconds", "max_bytes", "message"),
    [
        (
            b"# note\n" * (BOMB // 28),
            60.0,
            SMALL,
            "raise `max_bytes`|lines after line 2 are",
        ),
        (
            b"\n" * BOMB,
            20.0,
            MAX_BYTES,
            "1000000 lines after line 2 are blank or comments",
        ),
    ],
    ids=["comments", "line ends"],
)
def test_compressed_text_without_rows_is_left_soon(
    tmp_path, lines, seconds, max_bytes, message
):
    path = tmp_path / "x.csv.gz"
    path.write_bytes(gzip.compress(b"t,f\n0,1\n" + lines))

    with (
        bounded(peak=12 * SMALL, seconds=seconds),
        pytest.raises(FormatError, match=message),
    ):
        read_table(path, max_bytes=max_bytes)


@pytest.mark.parametrize("order", ["C", "F"])
def test_an_npz_unpacking_beyond_the_limit_is_refused(tmp_path, order):
    path = tmp_path / "x.npz"
    unused = np.zeros((3000, BOMB // 3000 // 8), order=order)
    np.savez_compressed(path, t=np.arange(3000.0), f=np.ones(3000), unused=unused)

    with bounded(), pytest.raises(FormatError, match="raise `max_bytes`"):
        read_log(path, max_bytes=SMALL)


def test_a_parquet_unpacking_beyond_the_limit_is_refused(tmp_path):
    path = tmp_path / "x.parquet"
    pq.write_table(pa.table({"t": np.zeros(BOMB // 8)}), path)

    assert path.stat().st_size < SMALL
    with bounded(), pytest.raises(FormatError, match="raise `max_bytes`"):
        read_table(path, max_bytes=SMALL)


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_lists_that_are_no_signals_are_left_out(tmp_path, suffix):
    # Every row would take as much memory as the longest.
    lists = [[0.0] * 10_000, [0.0] * 10_000, [1.0]]
    path = tmp_path / f"x.{suffix}"
    if suffix == "csv":
        rows = [f'{k},1,"{cell}"' for k, cell in enumerate(lists)]
        path.write_text("\n".join(["t,f,image", *rows, ""]))
    else:
        columns = {"t": [0.0, 1.0, 2.0], "f": [1.0, 1.0, 1.0], "image": lists}
        pq.write_table(pa.table(columns), path)

    with bounded(seconds=60.0):
        table = read_table(path)

    assert list(table.columns) == ["t", "f"]
    assert "column 'image' holds" in table.warnings[0]


@pytest.mark.parametrize(
    "name", ["x.npz", "x.mcap", "x.db3", "x.csv", "x.parquet", "x.toml"]
)
def test_a_device_is_no_file(tmp_path, name):
    (tmp_path / name).symlink_to("/dev/zero")
    read = load_mapping if name == "x.toml" else read_table

    with pytest.raises(FileAccessError, match="neither a file, a folder nor a pipe"):
        read(tmp_path / name)


@pytest.mark.parametrize(
    "name", ["a\0b.csv", "a\0b.npz", "a\0b.mcap", f"{'x' * 300}.csv"]
)
def test_an_impossible_file_name_is_reported(tmp_path, name):
    for read in (
        read_table,
        load_mapping,
        lambda path: list(stream_tables(path, FollowOptions())),
    ):
        with pytest.raises(FileAccessError, match="cannot read"):
            read(tmp_path / name)

    with pytest.raises(FileAccessError, match="cannot write"):
        write_table(tmp_path / name, {"t_s": [0.0]})


def test_endless_nul_bytes_are_no_text():
    with bounded(), pytest.raises(FormatError, match="not text"):
        list(csv_tables(iter(lambda: bytes(1 << 18), b""), "x"))


def nested(depth, size):
    """A message type of arrays in arrays of a type without fields."""
    parts = [f"a/T1[{size}] x"]
    parts += [f"MSG: a/T{k}\na/T{k + 1}[{size}] x" for k in range(1, depth)]
    return f"\n{'=' * 80}\n".join([*parts, f"MSG: a/T{depth}", ""])


@pytest.mark.parametrize(
    "definition",
    [
        *(nested(6, 1000), nested(2, 10**9), "a/X x\n", "string[999999999] x"),
        *("float64 x; import os", "".join(f"string[1000] x{k}\n" for k in range(500))),
    ],
)
def test_a_type_of_endless_arrays_is_no_signal(tmp_path, definition):
    schema = Schema(data=definition.encode(), encoding="ros2msg", id=1, name="a/msg/X")
    channel = Channel(
        id=1, topic="/x", message_encoding="cdr", metadata={}, schema_id=1
    )
    data = b"\0\1\0\0" + bytes(1 << 16)
    message = Message(channel_id=1, log_time=1, data=data, publish_time=1, sequence=0)
    path = mcap_file(tmp_path / "x.mcap", schema, channel, message)

    with bounded(), pytest.raises(FormatError, match="holds no topic with numbers"):
        read_table(path)


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (range(1000, 1500), "was written anew while it was followed"),
        ((), "has become shorter"),
    ],
    ids=["as long", "shorter"],
)
def test_a_followed_file_written_anew_is_noticed(tmp_path, rows, message):
    path = tmp_path / "log.csv"
    path.write_text("t,f\n" + "".join(f"{k},1\n" for k in range(300)))
    tables = stream_tables(path, FollowOptions(follow=True, idle_s=5.0))
    next(tables)
    path.write_text("t,f\n" + "".join(f"{k},2\n" for k in rows))

    with pytest.raises(FileAccessError, match=message):
        list(tables)


@pytest.mark.parametrize("is_rotated", [True, False])
def test_followed_files_that_vanish_are_read_and_reported(tmp_path, is_rotated):
    path = tmp_path / "log.csv"
    path.write_text("t,f\n" + "".join(f"{k},1\n" for k in range(300)))
    tables = stream_tables(path, FollowOptions(follow=True, idle_s=5.0))
    next(tables)
    with path.open("a") as log:
        log.write("300,1\n")

    path.rename(tmp_path / "log.1.csv")
    if is_rotated:
        path.write_text("t,f\n301,1\n")

    end_times = []

    with pytest.raises(
        FileAccessError, match="was renamed or removed while it was followed"
    ):
        end_times.extend(table.columns["t"][-1] for table in tables)

    assert end_times[-1] == 300.0


def test_file_names_stay_comments_in_suggested_mappings(tmp_path):
    evil = 'x\nrate_hz = 5\n[force]\ncolumns = "t"'
    path = tmp_path / "evil\nrate_hz = 6\n.npz"
    np.savez(path, t=np.arange(3.0), force=np.ones(3), **{evil: np.ones(3)})
    content = tomllib.loads(suggest_mapping(path, ["depth", "force"]))

    assert set(content) == {"time", "force"}
    assert content["force"]["columns"] == "force"

    folder = write_bag(tmp_path / "bag", [(f"/{evil}", k, number(k)) for k in range(9)])

    assert tomllib.loads(suggest_mapping(folder, ["depth"])) == {}
