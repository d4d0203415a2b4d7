"""CSV files, whole and broken."""

import csv
import gzip

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from needleforce.recordings import FileAccessError, FormatError, csv_file, read_table
from needleforce.recordings.csv_file import csv_tables


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
        "t,f\n0,1\n1,2",
        "t;f\n0;1\n1;2\n",
        "t\tf\n0\t1\n1\t2\n",
        "\ufefft,f\r\n0,1\r\n1,2\r\n",
        "t,f\r0,1\r1,2\r",
        "# by someone\n\nt,f\n# half way\n0,1\n\n1,2\n",
        '"t", "f"\n"0","1"\n"1","2"\n',
        "# t,f\n0,1\n1,2\n",
        "# made by numpy\n# t,f\n0,1\n1,2\n",
        " t , f \n 0 , 1 \n 1 , 2 \n",
        "t,f\n0,1,\n1,2,\n",
        "t,f\n0e0,1.0\n+1,2.\n",
    ],
)
def test_every_usual_form_gives_the_same_table(read, text):
    table = read(text)
    assert values(table) == {"t": [0.0, 1.0], "f": [1.0, 2.0]}
    assert table.warnings == ()


NAN = None
NOT_NUMBERS = "cells that are not numbers, read as NaN"
FAULTS = {
    "f\n1\n2\n": ({"f": [1, 2]}, ()),
    't,"f [N, axial]"\n0,1\n': ({"t": [0], "f [N, axial]": [1]}, ()),
    ",t,f\n0,0,1\n1,1,2\n": ({"column_1": [0, 1], "t": [0, 1], "f": [1, 2]}, ()),
    "t,f\n0,\n1,nan\n2,5\n": ({"t": [0, 1, 2], "f": [NAN, NAN, 5]}, ()),
    "t;f\n0,0;1,5\n0,1;-2\n": (
        {"t": [0.0, 0.1], "f": [1.5, -2.0]},
        ("decimal commas read as points (first: line 2)",),
    ),
    "# note\nt,f\n0,1\n1,bad\n2,worse\n3,4\n": (
        {"t": [0, 1, 2, 3], "f": [1, NAN, NAN, 4]},
        (f"column 'f': {NOT_NUMBERS}: 2 (first: line 4, 'bad')",),
    ),
    # A row of units under the header costs that row only.
    "t,f\ns,N\n0,1\n1,2\n": (
        {"t": [NAN, 0, 1], "f": [NAN, 1, 2]},
        tuple(f"column {n!r}: {NOT_NUMBERS}: 1 (first: line 2, {u!r})" for n, u in ("ts", "fN")),
    ),
    "t,phase,spare\n0,in,\n1,out,\n": (
        {"t": [0, 1]},
        (
            "column 'phase' holds text (line 2, 'in') and was left out",
            "column 'spare' is empty and was left out",
        ),
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
    found = {name: [x if x == x else NAN for x in v] for name, v in values(table).items()}
    assert found == columns
    assert table.warnings == warnings


def test_text_that_is_not_utf8_is_read_and_reported(read):
    table = read("t,q [°]\n0,1\n".encode("cp1252"))
    assert list(table.columns) == ["t", "q [°]"]
    assert "cp1252" in table.warnings[0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        (" \n\n", "is empty"),
        ("# only\n# comments\n", "only comments"),
        ("t,f\n", "a header but no rows; the header is: t,f"),
        ("0,1\n1,2\n", "no header row: line 1 already holds numbers .'0,1'"),
        ("# made on Monday\n0,1\n1,2\n", "no header row: line 2"),
        ("t,f,t\n0,1,2\n", "names 't' twice, in columns 1 and 3"),
        ("t,f\n0\n1\n", "no row has the header's 2 cells .first: line 2 with 1"),
        ("t,f\n0", "no row has the header's 2 cells"),
        ("Of Monday\nt,f\n0,1\n", "2 with 2.; check .* what stands above the header begins with #"),
        ("Of Monday\nat noon\n0,1\n", "no column .* what stands above the header begins with #"),
        ("t f\n0 1\n", "no column holds a number: column 't f' holds text .line 2, '0 1'"),
        (b"PK\x03\x04\x00\x00\x01", "is not text"),
        (b"\x00" * 9, "is not text"),
        (b"t,f\n0,1\n\x00\x001,2\n", "is not text"),
    ],
)
def test_what_cannot_be_read_is_refused_with_file_and_reason(read, text, message):
    with pytest.raises(FormatError, match=message) as caught:
        read(text)
    assert "log.csv" in str(caught.value)


@pytest.mark.parametrize("tail", ["", "2,3"])
def test_nul_bytes_at_the_end_cost_the_line_before_them_only(read, tail):
    table = read(f"t,f\n0,1\n1,2\n{tail}".encode() + bytes(300_000))
    assert values(table) == {"t": [0.0, 1.0], "f": [1.0, 2.0]}
    assert table.warnings == (
        "the file ends in 300000 NUL bytes, as power loss may leave them; what follows line 3 is "
        "lost",
    )


def test_a_file_that_is_not_there_is_reported(tmp_path):
    with pytest.raises(FileAccessError, match=r"cannot read .*No such file"):
        read_table(tmp_path / "none.csv")
    (tmp_path / "folder.csv").mkdir()
    with pytest.raises(FileAccessError, match="cannot read"):
        read_table(tmp_path / "folder.csv")


def long_csv(rows=40_000):
    noise = np.random.default_rng(0).normal(size=rows)
    return "t,f\n" + "".join(f"{i},{f!r}\n" for i, f in enumerate(noise.tolist()))


def test_a_compressed_file_reads_the_same(read):
    text = long_csv(100)
    assert values(read(gzip.compress(text.encode()), "log.csv.gz")) == values(read(text))
    # Appended members, as `cat a.gz b.gz` or a logger that reopens its file gives.
    parts = gzip.compress(text[:500].encode()) + gzip.compress(text[500:].encode())
    assert values(read(parts, "log.csv.gz")) == values(read(text))


def test_a_cut_compressed_file_yields_its_whole_lines(read):
    text = long_csv()
    packed = gzip.compress(text.encode())
    table = read(packed[: len(packed) // 2], "log.csv.gz")
    rows = len(table.columns["t"])
    assert 10_000 < rows < 40_000
    whole = values(read(text))
    assert values(table) == {name: column[:rows] for name, column in whole.items()}
    assert table.warnings == (
        f"the compressed file is cut short; what follows line {rows + 1} is lost",
    )


def test_a_damaged_compressed_file_yields_what_precedes_the_damage(read):
    packed = bytearray(gzip.compress(long_csv().encode()))
    place = len(packed) * 3 // 4
    packed[place : place + 2000] = bytes(2000)
    table = read(bytes(packed), "log.csv.gz")
    assert "is damaged; what follows line" in table.warnings[0]
    assert "lines before it may be wrong" in table.warnings[0]
    assert len(table.columns["t"]) > 10_000


@pytest.mark.parametrize("size", [3, 12])
def test_a_compressed_file_without_a_whole_line_is_refused(read, size):
    with pytest.raises(FormatError, match=r"is empty.*is cut short"):
        read(gzip.compress(long_csv(10).encode())[:size], "log.csv.gz")


def test_a_format_error_shows_what_was_lost_before_it(read):
    packed = gzip.compress(b"\n".join([b"t,f", *[b"word"] * 100_000]))
    with pytest.raises(FormatError, match=r"header.*cut short"):
        read(packed[:-10], "log.csv.gz")


cells = st.floats() | st.integers(-(10**6), 10**6)


@given(st.lists(st.lists(cells, min_size=3, max_size=3), min_size=1, max_size=20))
def test_the_fast_and_the_slow_reader_agree(rows):
    text = "a,b,c\n" + "".join(",".join(map(repr, row)) + "\n" for row in rows)
    lines = text.split("\n")[1:-1]
    columns = csv_file._Columns(csv_file._Header(("a", "b", "c"), ","))
    fast, slow = columns._read_fast(lines), columns._read_cells(lines, range(len(lines)))
    assert columns.notes() == ()
    np.testing.assert_array_equal(fast, slow)
    np.testing.assert_array_equal(fast, rows)


@given(st.text(alphabet='t,f;\t\n#"0123.e-x ', max_size=60))
def test_any_text_is_read_or_refused_with_our_own_error(text):
    try:
        *_, table = csv_tables([text.encode()], "text")
    except FormatError:
        return
    assert table.columns


def test_a_stray_quote_costs_no_more_than_its_line(read):
    table = read('t,f\n0,"1\n1,2\n2,"3,\n3,4\n')
    np.testing.assert_array_equal(table.columns["t"], [0.0, 1.0, 2.0, 3.0])
    np.testing.assert_array_equal(table.columns["f"], [1.0, 2.0, np.nan, 4.0])
    assert "first: line 4, '3,'" in table.warnings[0]


def test_a_monstrous_cell_costs_no_more_than_itself(read):
    monster = '"' + "x" * 2 * csv.field_size_limit()
    table = read(f"t,f\n0,{monster}\n1,2\n")
    np.testing.assert_array_equal(table.columns["f"], [np.nan, 2.0])
    assert "first: line 2" in table.warnings[0]
