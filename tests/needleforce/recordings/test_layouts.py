"""Layouts of exports: where the table begins, its names, its units and its encoding."""

import gzip

import numpy as np
import pytest

from needleforce.recordings import (
    ColumnError,
    ColumnSpec,
    FollowOptions,
    FormatError,
    read_log,
    read_table,
    stream_tables,
)
from needleforce.recordings.csv_file import csv_tables
from needleforce.recordings.table import HEAD_ROWS
from tests.needleforce.recordings.bag_samples import mapped

ROWS = 300
TIME_S = np.arange(ROWS) / 100.0
DEPTH_MM = np.arange(ROWS) / 10.0
FORCE_N = np.round(np.sin(TIME_S), 4)


def rows_of(delimiter=",", decimal=".", quote="", scale=1.0):
    """Lines of time, depth and force; the force in units of `scale` newtons."""
    lines = []
    for values in zip(TIME_S, DEPTH_MM, FORCE_N / scale, strict=True):
        cells = [f"{value:.7f}".replace(".", decimal) for value in values]
        lines.append(delimiter.join(f"{quote}{cell}{quote}" for cell in cells))

    return "\n".join(lines) + "\n"


LVM_HEADER = """LabVIEW Measurement\t
Writer_Version\t2
Separator\tTab
Decimal_Separator\t{decimal}
Multi_Headings\tNo
X_Columns\tOne
Time_Pref\tRelative
Date\t2024/05/01
***End_of_Header***\t
\t
Channels\t2\t\t
Samples\t300\t300\t
Y_Unit_Label\tmm\tN\t
X_Dimension\tTime\tTime\t
X0\t0.0000000000000000E+0\t0.0000000000000000E+0\t
Delta_X\t0.010000\t0.010000\t
***End_of_Header***\t\t\t
X_Value\tTravel\tLoad\tComment
"""

RESULTS = """Results Table 1
,Maximum load,Extension at maximum
,(N),(mm)
1,4.51,12.3
2,4.73,12.9
Mean,4.62,12.6

"""

LAYOUTS = {
    "row of units": "Time,Extension,Load\n(s),(mm),(kN)\n" + rows_of(scale=1000.0),
    "quoted row of units": '"Time","Extension","Load"\n"(s)","(mm)","(N)"\n'
    + rows_of(quote='"'),
    "results above": RESULTS + "Time,Extension,Load\n(s),(mm),(N)\n" + rows_of(),
    "notes as wide as the table": "Operator,Smith,\nMachine,5943,\nMethod,needle,x\n"
    "Time,Displacement,Force\n(s),(mm),(N)\n" + rows_of(),
    "description between": "Time,Distance,Force\nelapsed,of the arm,of the cell\n"
    "sec,mm,gf\n" + rows_of(scale=9.80665e-3),
    "sep line": "sep=;\nTime (s);Weg (mm);Kraft (N)\n" + rows_of(";", ","),
    "German machine": '"Prüfinstitut";"eins"\n"Projektnummer";"123456"\n"Datum";"x"\n\n'
    '"Prüfzeit";"Standardweg";"Standardkraft"\n"s";"mm";"N"\n' + rows_of(";", ","),
    "LabVIEW": LVM_HEADER.format(decimal=".") + rows_of("\t"),
    "LabVIEW, decimal commas": LVM_HEADER.format(decimal=",") + rows_of("\t", ","),
    "test bench": "MTS793|MPT|ENU|1|0|/|:|1|0|0\n\nData Acquisition\nStation x\n\n"
    "Time\tAxial Displacement\tAxial Force\nSec\tmm\tkN\n"
    + rows_of("\t", scale=1000.0),
    "units in names": "Time/s,Stroke / mm,Force/kN\n" + rows_of(scale=1000.0),
    "units after spaces": "Time s;Travel mm;Load N\n" + rows_of(";"),
    "white space": "# made by numpy\n# t_s depth_mm force_N\n" + rows_of(" "),
    "units above the names": "s,mm,N\nTime,Extension,Load\n" + rows_of(),
    "two lines of names": "Timer,Crosshead,Cell\nTime,Displacement,Load\ns,mm,N\n"
    + rows_of(),
    "short names": "t [s];s [mm];F [N]\n" + rows_of(";", ","),
    "white space and brackets": "Time (s)  Travel [mm] Load (N)\n" + rows_of(" "),
    "units in a comment": "# t,depth,force\n# s,mm,N\n" + rows_of(),
    "names and white space": "time_s   depth_mm force_N\n" + rows_of("   "),
    "pounds": "Reading [lbF],Travel [in],Time [s]\n"
    + "".join(
        f"{force / 4.4482216152605:.9f},{depth / 25.4:.9f},{t}\n"
        for t, depth, force in zip(TIME_S, DEPTH_MM, FORCE_N, strict=True)
    ),
}


def assert_is_the_log(log):
    np.testing.assert_allclose(log.t_s, TIME_S, atol=1e-6)
    np.testing.assert_allclose(log["depth_m"], DEPTH_MM / 1000.0, atol=1e-6)
    np.testing.assert_allclose(log["force_N"], FORCE_N, atol=2e-4)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_layouts_of_machines_are_read(tmp_path, layout):
    path = tmp_path / "log.csv"
    path.write_text(LAYOUTS[layout], encoding="utf-8")
    log = read_log(path, required=("depth", "force"))

    assert_is_the_log(log)
    assert [unit.channel for unit in log.units] == ["time", "depth", "force"]
    assert "assumed" not in "".join(map(str, log.units))


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "cp1252"])
@pytest.mark.parametrize("bare", ["utf-16-le", "utf-16-be", "utf-8-sig"])
@pytest.mark.parametrize("is_packed", [False, True])
def test_encodings_give_the_same_log(tmp_path, encoding, bare, is_packed):
    for name in (encoding, bare):
        data = LAYOUTS["German machine"].encode(name)
        path = tmp_path / ("log.csv.gz" if is_packed else "log.csv")
        path.write_bytes(gzip.compress(data, mtime=0) if is_packed else data)
        log = read_log(path, required=("depth", "force"))

        assert_is_the_log(log)
        assert "Prüfzeit in s (row of units, line 6)" in map(str, log.units)


@pytest.mark.parametrize("size", [1, 7, 4096])
@pytest.mark.parametrize("layout", ["results above", "LabVIEW"])
def test_the_pieces_in_which_a_file_comes_do_not_matter(tmp_path, layout, size):
    data = LAYOUTS[layout].encode()
    pieces = [data[start : start + size] for start in range(0, len(data), size)]
    first, *others = csv_tables(pieces, "log")
    path = tmp_path / "log.csv"
    path.write_bytes(data)
    whole = read_table(path)

    assert len(first) == HEAD_ROWS
    assert first.units == whole.units
    for name, values in whole.columns.items():
        pieces_of_column = [first.columns[name], *(t.columns[name] for t in others)]
        np.testing.assert_array_equal(np.concatenate(pieces_of_column), values)


def test_a_nul_byte_costs_its_row_only(tmp_path):
    path = tmp_path / "log.csv"
    lines = ["t_s,force_N", *(f"{k / 100},{k}" for k in range(500))]
    lines[101] = "1.0,\x00100"
    lines[401] = "\0" * 5000 + "4.0,400"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    log = read_log(path)

    assert len(log) == 498
    assert log["force_N"][-1] == 499.0
    assert log.warnings == ("rows with NUL bytes, left out: 2 (first: line 102)",)

    tables = stream_tables(path, FollowOptions(follow=True, idle_s=0.1))

    assert sum(len(table) for table in tables) == 498


def test_a_short_first_row_is_left_out_and_named(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("t_s,force_N,depth_mm\n0.1,0.2\n" + rows_of())
    log = read_log(path)

    assert len(log) == ROWS
    assert log.warnings == (
        "rows without the header's 3 cells, left out: 1 (first: line 2 with 2)",
    )


def test_a_nul_byte_in_the_first_row_or_the_header_is_named(tmp_path):
    path = tmp_path / "log.csv"
    rows = [f"{k / 100},{k}" for k in range(300)]
    path.write_text("\n".join(["t_s,force_N", "0.0\0,0", *rows]) + "\n")

    assert read_log(path).warnings == (
        "rows with NUL bytes, left out: 1 (first: line 2)",
    )

    path.write_text("\n".join(["t_s,for\0ce_N", *rows]) + "\n")

    with pytest.raises(ColumnError, match="line 1, above the table, has NUL bytes"):
        read_log(path, required=("force",))


def test_numbers_without_a_header_are_read_by_number(tmp_path):
    path = tmp_path / "log.txt"
    path.write_text(rows_of("\t"), encoding="utf-8")

    with pytest.raises(
        ColumnError, match=r"the file has no header\. Columns"
    ) as caught:
        read_log(path, required=("depth", "force"))

    assert caught.value.advice.endswith(
        "--time column_1:s --depth column_2:mm --force column_3:N"
    )

    with pytest.raises(ColumnError) as caught:
        read_log(path, required=("q", "tau"), joints=("a", "b", "c"))

    assert caught.value.advice.endswith(
        "--time column_1:s --q 'column_{2..4}:rad' --tau 'column_{5..7}:Nm'"
    )

    mapping = mapped(
        time=ColumnSpec(columns="column_1", unit="s"),
        depth=ColumnSpec(columns="column_2", unit="mm"),
        force=ColumnSpec(columns="column_3", unit="N"),
    )
    log = read_log(path, mapping, required=("depth", "force"))

    assert_is_the_log(log)
    assert "there is no header: line 1 ('0.0000000" in log.warnings[0]


def test_names_that_stand_twice_are_read_by_number(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("Time,Load,Time,Load\ns,N,s,N\n0,1,0,2\n1,1,1,2\n")
    table = read_table(path)

    assert list(table.columns) == ["Time", "column_2", "column_3", "column_4"]
    assert table.warnings == (
        "the header, line 1, names 'Time' twice; the others, equal in the first rows, "
        "are called column_3",
        "the header, line 1, names 'Load' twice; these are called column_2 and "
        "column_4",
    )
    assert table.units["column_2"].text == "N"


def test_a_labview_file_without_stamps_names_its_rate(tmp_path):
    path = tmp_path / "log.lvm"
    lines = rows_of("\t").splitlines()
    rows = "\n".join("\t" + line.partition("\t")[2] for line in lines)
    path.write_text(LVM_HEADER.format(decimal=".") + rows + "\n", encoding="utf-8")

    with pytest.raises(ColumnError, match=r"line 16 says Delta_X 0\.01, .* of 100 Hz"):
        read_log(path, required=("depth", "force"))

    assert_is_the_log(read_log(path, mapped(100.0), required=("depth", "force")))


@pytest.mark.parametrize(
    ("cells", "numbers"),
    [
        (('"0,5"', '"12,25"'), [0.5, 12.25]),
        (('"1,234.5"', "2.5"), [1234.5, 2.5]),
        (('"1,234"', "2.5"), [1234.0, 2.5]),
        (('"1.234,5"', '"2,5"'), [1234.5, 2.5]),
        (('"1,234"', "7"), [None, 7.0]),
    ],
)
def test_commas_in_numbers_are_read_where_they_mean_one_thing(tmp_path, cells, numbers):
    path = tmp_path / "log.csv"
    path.write_text(f"t,f\n1,{cells[0]}\n2,{cells[1]}\n")
    column = read_table(path).columns["f"]

    assert [None if np.isnan(value) else value for value in column] == numbers


def test_a_table_of_results_is_not_taken_for_the_recording(tmp_path):
    path = tmp_path / "log.csv"
    results = "".join(f"{k},{k / 7:.3f}\n" for k in range(20))
    path.write_text(
        f"No,Maximum\n,(N)\n{results}\nTime,Travel,Load\ns,mm,N\n{rows_of()}"
    )

    assert_is_the_log(read_log(path, required=("depth", "force")))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<!DOCTYPE html>\n<html>404</html>\n", "no row of numbers in lines 1 to 2"),
        ("Dear all,\nsee the log.\n", "lines 1 to 2, which begin with 'Dear all,'"),
        (
            '{"t": [0, 1, 2]}\n',
            "line 1 .* is the first with numbers, and no line above",
        ),
    ],
)
def test_what_is_no_table_is_refused_with_its_line(tmp_path, text, message):
    path = tmp_path / "log.csv"
    path.write_text(text)

    with pytest.raises(FormatError, match=message):
        read_table(path)


def test_shift_jis_of_japanese_machines_is_read(tmp_path):
    path = tmp_path / "log.csv"
    text = '"名前","x"\n"時間","ストローク","試験力"\n"sec","mm","N"\n' + rows_of()
    path.write_bytes(text.encode("cp932"))

    assert_is_the_log(read_log(path, required=("depth", "force")))


@pytest.mark.parametrize("encoding", ["gb18030", "cp949", "mac_roman", "cp1250"])
def test_an_encoding_is_known_by_the_words_in_it(tmp_path, encoding):
    names = {
        "gb18030": "试验时间 (s),位移 (mm),载荷 (N)",
        "cp949": "t (s),depth (mm),force (N),온도",
        "mac_roman": "Prüfzeit (s),Weg (mm),Prüfkraft (N)",
        "cp1250": "t (s),depth (mm),force (N),teplota °",
    }[encoding]
    extra = ",1" if names.count(",") == 3 else ""
    rows = "".join(f"{row}{extra}\n" for row in rows_of().splitlines())
    path = tmp_path / "log.csv"
    path.write_bytes(f"{names}\n{rows}".encode(encoding))

    assert_is_the_log(read_log(path, required=("depth", "force")))


def test_times_of_a_clock_are_seconds_also_over_midnight(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(
        "No.,Time(h:m:s),Position(mm),Force(N)\n"
        "1,23:59:59.980,1,2\n2,23:59:59.990,1,2\n3,0:00:00.000,1,2\n4,,1,2\n"
        "5,00:00:00.020,1,2\n"
    )
    log = read_log(path, required=("depth", "force"))

    np.testing.assert_allclose(log.t_s, [86399.98, 86399.99, 86400.0, 86400.02])
    assert "rows without a stamp, left out: 1" in log.warnings[0]
    assert str(log.units[0]) == "Time(h:m:s) in s (format of the file)"


def test_dates_with_times_lose_no_nanosecond(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(
        "time,force_N\n2024-05-01 12:00:00.123456789,1\n"
        "2024-05-01T14:00:00.123456799+02:00,2\n2024/05/01 12:00:01Z,3\n"
    )
    log = read_log(path)

    assert log.start_ns == 1_714_564_800_123_456_789
    assert log.t_s.tolist() == [0.0, 1e-8, 0.876543211]


def test_a_clock_in_pieces_reads_as_whole(tmp_path):
    stamps = [
        f"{k // 3600 % 24}:{k // 60 % 60:02}:{k % 60:02}" for k in range(86000, 87000)
    ]
    text = "Time,F [N]\n" + "".join(f"{stamp},1\n" for stamp in stamps)
    tables = csv_tables([text[:5000].encode(), text[5000:].encode()], "log")
    seconds = np.concatenate([table.columns["Time"] for table in tables])

    np.testing.assert_array_equal(seconds, np.arange(86000.0, 87000.0))


@pytest.mark.parametrize(
    "form", ["[{}, {}]", "({};{})", "[np.float64({}), np.float64({})]"]
)
def test_cells_of_lists_are_columns_of_two_dimensions(tmp_path, form):
    path = tmp_path / "log.csv"
    cells = [form.format(k / 10, -k) for k in range(4)]
    rows = [f'{k / 100},"{cell}",x' for k, cell in enumerate([*cells, "[1.0]"])]
    path.write_text("\n".join(["time,q,note", *rows, ""]))
    log = read_log(path, required=("q",))

    expected = [[0.0, 0.0], [0.1, -1.0], [0.2, -2.0], [0.3, -3.0], [np.nan, np.nan]]
    np.testing.assert_array_equal(log["q_rad"], expected)


def test_bars_may_separate_cells(tmp_path):
    path = tmp_path / "log.txt"
    path.write_text("Time [s]|Travel [mm]|Load [N]\n" + rows_of("|"))

    assert_is_the_log(read_log(path, required=("depth", "force")))
