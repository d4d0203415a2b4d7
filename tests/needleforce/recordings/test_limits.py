"""Hostile and damaged files end in one of our errors, soon and within bounded
memory."""

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
from mcap.records import DataEnd

from needleforce.recordings import (
    FileAccessError,
    FormatError,
    load_mapping,
    read_table,
)
from needleforce.recordings.mapping_suggestion import suggest_mapping
from tests.needleforce.recordings.bag_samples import MAGIC, number, write_bag

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


def nested(depth, size):
    """A message type of arrays in arrays of a type without fields."""
    parts = [f"a/T1[{size}] x"]
    parts += [f"MSG: a/T{k}\na/T{k + 1}[{size}] x" for k in range(1, depth)]
    return f"\n{'=' * 80}\n".join([*parts, f"MSG: a/T{depth}", ""])


def test_file_names_stay_comments_in_suggested_mappings(tmp_path):
    evil = 'x\nrate_hz = 5\n[force]\ncolumns = "t"'
    path = tmp_path / "evil\nrate_hz = 6\n.npz"
    np.savez(path, t=np.arange(3.0), force=np.ones(3), **{evil: np.ones(3)})
    content = tomllib.loads(suggest_mapping(path, ["depth", "force"]))

    assert set(content) == {"time", "force"}
    assert content["force"]["columns"] == "force"

    folder = write_bag(tmp_path / "bag", [(f"/{evil}", k, number(k)) for k in range(9)])

    assert set(tomllib.loads(suggest_mapping(folder, ["depth"]))) == {"reference_topic"}
