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
from pyarrow import feather

from needleforce.recordings import (
    FileAccessError,
    FormatError,
    read_log,
    read_table,
    write_table,
)
from needleforce.recordings.bags.message_types import standard_types
from needleforce.recordings.csv_file import csv_tables
from needleforce.recordings.follow import BINARY, FollowOptions
from needleforce.recordings.open_recording import stream_tables


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


@pytest.mark.parametrize("text", FAULTS)
def test_what_is_odd_costs_little_and_is_reported(read, text):
    table = read(text)
    columns, warnings = FAULTS[text]
    numbers = {
        name: [x if x == x else NAN for x in v] for name, v in values(table).items()
    }

    assert numbers == columns
    assert table.warnings == warnings


def test_text_other_than_utf8_is_read_and_reported(read):
    table = read("t,q [°]\n0,1\n".encode("cp1252"))

    assert list(table.columns) == ["t", "q [°]"]
    assert "cp1252" in table.warnings[0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        ("t,f\n", "a header but no rows; the header is line 1: t,f"),
        ("of Monday\nt,f\n", "no row of numbers in lines 1 to 2, .* 'of Monday'"),
        ("t,f\n0\n1\n", "no table: line 2 .'0'. is the first with numbers, and no "),
        *(
            (head + bytes(3), f"it is {suffix[1:]}, not text")
            for head, suffix in BINARY.items()
        ),
        (b"#a\n\x00\x01", "only comments.*goes on with NUL bytes"),
        (b"\x00" * 9, "it is not text"),
    ],
)
def test_other_than_csv_is_refused_with_the_reason(read, text, message):
    with pytest.raises(FormatError, match=f"log.csv.*{message}"):
        read(text)


@pytest.mark.parametrize("tail", ["", "2,3"])
def test_nul_bytes_cost_only_the_line_before(read, tail):
    table = read(f"t,f\n0,1\n1,2\n{tail}".encode() + bytes(300_000))

    assert values(table) == {"t": [0.0, 1.0], "f": [1.0, 2.0]}

    loss = "the file goes on with NUL bytes, as power loss may leave them"

    assert table.warnings == (f"{loss}; what follows line 3 is lost",)


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

    table = read(packed[: len(packed) // 2], "log.csv.gz")
    rows = len(table.columns["t"])

    assert 10_000 < rows < 40_000
    assert values(table) == {name: column[:rows] for name, column in whole.items()}

    lost = f"the compressed file is cut short; what follows line {rows + 1} is lost"

    assert table.warnings == (lost,)

    place = len(packed) * 3 // 4
    table = read(packed[:place] + bytes(2000) + packed[place + 2000 :], "log.csv.gz")

    assert "is damaged; what follows line" in table.warnings[0]


cells = st.floats() | st.integers(-(10**6), 10**6)


@given(st.lists(st.lists(cells, min_size=3, max_size=3), min_size=1, max_size=20))
def test_the_fast_and_the_slow_reader_agree(rows):
    text = "a,b,c\n" + "".join(",".join(map(repr, row)) + "\n" for row in rows)
    for more in ("", "1,2\n"):
        first, notes = csv_tables([(text + more).encode()], "text")
        numbers = np.column_stack(list(first.columns.values()))
        np.testing.assert_array_equal(numbers, rows)
        assert len(notes.warnings) == len(more) // 4


@given(st.text(alphabet='t,f;\t\n#"0123.e-x ', max_size=60))
def test_any_text_is_read_or_cleanly_refused(text):
    try:
        *_, table = csv_tables([text.encode()], "text")
    except FormatError:
        return

    assert table.columns


def test_a_stray_quote_costs_only_its_line(read):
    table = read('t,f\n0,"1\n1,2\n2,"3,\n3,4\n')

    np.testing.assert_array_equal(table.columns["t"], [0.0, 1.0, 2.0, 3.0])
    np.testing.assert_array_equal(table.columns["f"], [1.0, 2.0, np.nan, 4.0])
    assert "first: line 4, '3,'" in table.warnings[0]


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


def test_arrays_without_numbers_are_omitted_pickles_never_loaded(read):
    class Trap:
        def __reduce__(self):
            return pytest.fail, ("the pickle was loaded",)

    others = {
        "names": np.array(["a", "b"]),
        "cube": np.zeros((2, 2, 2)),
        "none": np.zeros(0),
        "spectrum": np.zeros(3, dtype=complex),
        "trap": np.array([Trap()], dtype=object),
        "damaged": np.ones(1000),
    }
    stream = io.BytesIO()
    np.savez(stream, t=np.arange(3.0), **others)
    data = bytearray(stream.getvalue())
    data[data.rindex(np.ones(1000).tobytes()) + 4000] ^= 0xFF
    table = read(bytes(data), "log.npz")

    assert list(table.columns) == ["t"]
    assert [warning.split("'")[1] for warning in table.warnings] == list(others)
    assert (
        "column 'trap' cannot be read (it holds object, no numbers"
        in table.warnings[-2]
    )
    assert "(Bad CRC-32" in table.warnings[-1]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is not an npz archive, or it is cut short"),
        (array_bytes(t=np.arange(1000.0))[:-50], "cut short"),
        (array_bytes(), "holds no array of numbers"),
        (
            array_bytes(names=np.array(["a"])),
            "holds no array of numbers: column 'names' cannot",
        ),
    ],
)
def test_other_than_npz_is_refused_with_the_reason(read, content, message):
    with pytest.raises(FormatError, match=f"log.npz.*{message}"):
        read(content, "log.npz")


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


def test_two_columns_of_one_name_are_refused(path):
    pq.write_table(
        pa.table([[0.0, 1.0], [1.0, 2.0], [3.0, 4.0]], names=["t_s", "f", "f"]), path
    )
    with pytest.raises(
        FormatError, match="more than one column 'f'; rename the others"
    ):
        read_table(path)


def test_a_cut_file_is_refused_with_the_reason(path):
    write_table(path, {"t_s": np.arange(1000.0), "f": np.ones(1000)})
    path.write_bytes(path.read_bytes()[:-10])

    with pytest.raises(FormatError, match="ends with its table of contents"):
        read_table(path)


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


def test_feather_reads_as_parquet_does(tmp_path):
    q = pa.array([[0.0, 1.0], [2.0, 3.0]], pa.list_(pa.float64(), 2))
    table = pa.table({"t_s": [0.0, 0.1], "q": q, "name": ["a", "b"]})
    path = tmp_path / "log.feather"
    feather.write_feather(table, path)
    log = read_log(path, required=["q"])

    assert log["q_rad"].tolist() == [[0.0, 1.0], [2.0, 3.0]]
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(FormatError, match="is not a Feather file, or it is damaged"):
        read_log(path)


def test_parquet_is_read_some_rows_at_a_time(tmp_path):
    count = 40_000
    stamps = 1_700_000_000_123_456_789 + 1_000_000 * np.arange(count)
    widths = np.where(np.arange(count) < 30_000, 2, 3)
    lists = [[1e-5 * row] * width for row, width in enumerate(widths)]
    table = pa.table({"time": stamps.astype("M8[ns]"), "q": lists, "no": ["a"] * count})
    path = tmp_path / "log.parquet"
    pq.write_table(table, path)
    tables = list(stream_tables(path, FollowOptions()))
    log = read_log(path, required=["q"])

    assert [len(each) for each in tables] == [16384, 16384, 7232]
    assert [len(each.warnings) for each in tables] == [1, 0, 0]
    assert log.start_ns == 1_700_000_000_123_456_789
    np.testing.assert_allclose(log.t_s, 0.001 * np.arange(count), atol=1e-9)
    np.testing.assert_allclose(log["q_rad"][:30_000, 0], 1e-5 * np.arange(30_000.0))
    assert np.isnan(log["q_rad"][30_000:]).all()
