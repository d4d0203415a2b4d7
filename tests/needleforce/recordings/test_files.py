"""CSV, npz and Parquet: what is written reads back, what cannot be read is reported."""

import gzip
import io
import sys

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from needleforce.recordings import (
    FileAccessError,
    FormatError,
    read_log,
    read_table,
    write_table,
)
from needleforce.recordings.bag_topics import standard_types


@pytest.fixture
def read(tmp_path):
    def write_and_read(content, name="log.csv"):
        path = tmp_path / name
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return read_table(path)

    return write_and_read


def values(table):
    return {name: column.tolist() for name, column in table.columns.items()}


@pytest.mark.parametrize(
    "text",
    [
        "t,f\n0,1\n1,2\n",
        "t;f\n0;1\n1;2\n",
        "\ufefft,f\r\n0,1\r\n1,2\r\n",
        "t,f\r0,1\r1,2\r",
        "# by someone\n\nt,f\n# half way\n0,1\n\n1,2\n",
        '"t", "f"\n"0","1"\n"1","2"\n',
        "# made by numpy\n# t,f\n0,1\n1,2\n",
        "t,f\n0,1,\n1,2,\n",
    ],
)
def test_every_usual_form_gives_the_same_table(read, text):
    table = read(text)

    assert values(table) == {"t": [0.0, 1.0], "f": [1.0, 2.0]}
    assert table.warnings == ()


NAN = None
NOT_NUMBERS = "cells that are not numbers, read as NaN"
FAULTS = {
    't,"f [N, axial]"\n0,1\n': ({"t": [0], "f [N, axial]": [1]}, ()),
    "t,f\n0,\n1,nan\n2,5\n": ({"t": [0, 1, 2], "f": [NAN, NAN, 5]}, ()),
    "t;f\n0,0;1,5\n0,1;-2\n": (
        {"t": [0.0, 0.1], "f": [1.5, -2.0]},
        ("decimal commas read as points: 3 (first: line 2)",),
    ),
    "# note\nt,f\n0,1\n1,bad\n2,worse\n3,4\n": (
        {"t": [0, 1, 2, 3], "f": [1, NAN, NAN, 4]},
        (f"column 'f': {NOT_NUMBERS}: 2 (first: line 4, 'bad')",),
    ),
    "t,phase,spare\n0,in,\n1,out,\n": (
        {"t": [0, 1]},
        (
            "column 'phase' holds text (line 2, 'in') and was left out",
            "column 'spare' is empty and was left out",
        ),
    ),
    "t,f\n0,1\n1,1_0\n": (  # 10 for Python, in a file rather damage
        {"t": [0, 1], "f": [1, NAN]},
        (f"column 'f': {NOT_NUMBERS}: 1 (first: line 3, '1_0')",),
    ),
    "t,f\n0,1\n1\n2,3,4\n3,5\n": (
        {"t": [0, 3], "f": [1, 5]},
        ("rows without the header's 2 cells, left out: 2 (first: line 3 with 1)",),
    ),
    "t,f,g\n0,1,2\n1,2,3\n2,3": (
        {"t": [0, 1], "f": [1, 2], "g": [2, 3]},
        ("line 4, the last, is cut short (2 of 3 cells) and was left out",),
    ),
}


@pytest.mark.slow
def test_compressed_files_read_alike_until_a_cut(read):
    noise = np.random.default_rng(0).normal(size=40_000).tolist()
    text = "t,f\n" + "".join(f"{i},{f!r}\n" for i, f in enumerate(noise))
    whole = values(read(text))
    packed = gzip.compress(text.encode())

    assert values(read(packed, "log.csv.gz")) == whole

    # Appended members, as `cat a.gz b.gz` or a logger that reopens its file gives.
    parts = gzip.compress(text[:500].encode()) + gzip.compress(text[500:].encode())

    assert values(read(parts, "log.csv.gz")) == whole

    with pytest.raises(FormatError, match="damaged gzip"):
        read(packed[: len(packed) // 2], "log.csv.gz")


cells = st.floats() | st.integers(-(10**6), 10**6)


def array_bytes(**arrays):
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    return stream.getvalue()


def test_arrays_become_columns(read):
    q_rad = np.arange(6.0).reshape(3, 2)
    contact = [True, False, True]
    content = array_bytes(t_s=np.arange(3), q_rad=q_rad, rate_Hz=100, contact=contact)
    table = read(content, "log.npz")

    np.testing.assert_array_equal(table.columns["q_rad"], q_rad)
    np.testing.assert_array_equal(table.columns["contact"], [1.0, 0.0, 1.0])
    assert all(column.dtype == np.float64 for column in table.columns.values())
    assert list(table.columns) == ["t_s", "q_rad", "contact"]
    assert table.warnings == ()


@pytest.fixture
def path(tmp_path):
    return tmp_path / "log.parquet"


def test_types_of_other_writers_become_numbers(path):
    lists = pa.array([[1, 2], None, [5, 6], [7, 8]], pa.list_(pa.int32()))
    cells = {"t": [0.0, 1.0, 2.0, 3.0], "flag": [True, None, False, True], "q": lists}
    pq.write_table(pa.table({**cells, "name": ["a", "b", "1", "d"]}), path)
    table = read_table(path)

    np.testing.assert_array_equal(table.columns["flag"], [1.0, np.nan, 0.0, 1.0])
    np.testing.assert_array_equal(
        table.columns["q"], [[1.0, 2.0], [np.nan, np.nan], [5.0, 6.0], [7.0, 8.0]]
    )
    assert table.warnings == (
        "column 'name' holds string, no numbers, and was left out",
    )


@pytest.mark.parametrize(
    ("unit", "name"), [("ns", "time"), ("us", "stamp_ns"), ("ms", "time_ms")]
)
def test_parquet_stamps_become_exact_seconds_missing_ones_reported(path, unit, name):
    stamps = np.array([1_700_000_000_123, 1_700_000_000_124, "NaT"], dtype="M8[ms]")
    stamps = stamps.astype(f"M8[{unit}]")
    pq.write_table(pa.table({name: pa.array(stamps), "f": [1.0, 2.0, 3.0]}), path)
    log = read_log(path)

    assert log.t_s.tolist() == [0.0, 0.001]
    assert log.start_ns == 1_700_000_000_123_000_000
    assert "rows without a stamp, left out: 1" in log.warnings[0]


@pytest.mark.parametrize(
    ("suffix", "library"), [("parquet", "pyarrow"), ("mcap", "rosbags")]
)
def test_a_missing_library_error_says_what_to_install(
    tmp_path, monkeypatch, suffix, library
):
    path = tmp_path / f"log.{suffix}"
    write_table(path, {"t_s": [0.0], "f": [1.0]})
    standard_types.cache_clear()
    for module in ("pyarrow", "pyarrow.parquet", "rosbags.typesys"):
        monkeypatch.setitem(sys.modules, module, None)

    for use in (read_table, lambda path: write_table(path, {"t_s": [0.0], "f": [1.0]})):
        with pytest.raises(
            FileAccessError, match=rf"(?s)need {library},.*\[recordings\]"
        ):
            use(path)


@given(where=st.floats(0.0, 1.0, exclude_max=True), byte=st.integers(0, 255))
def test_damaged_bytes_are_read_or_cleanly_refused(tmp_path_factory, where, byte):
    path = tmp_path_factory.mktemp("damaged") / "log.parquet"
    write_table(path, {"t_s": np.arange(50.0), "force_N": np.ones(50)})
    data = bytearray(path.read_bytes())
    data[int(where * len(data))] ^= byte
    path.write_bytes(data)
    try:
        table = read_table(path)
    except (FormatError, FileAccessError):
        return

    assert table.columns
