"""Text files: where the table begins, its names, units, encoding; what is odd."""

import gzip

import numpy as np
import pytest

from needleforce.recordings import FormatError, LogError, read_log, read_table

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


@pytest.fixture
def write(tmp_path):
    def write_file(content, name="log.csv"):
        path = tmp_path / name
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return path

    return write_file


@pytest.mark.parametrize("layout", LAYOUTS)
def test_tables_of_machines_are_read_with_their_units(write, layout):
    log = read_log(write(LAYOUTS[layout]), required=("depth", "force"))

    assert_is_the_log(log)
    assert [unit.channel for unit in log.units] == ["time", "depth", "force"]
    assert "assumed" not in "".join(map(str, log.units))


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "cp1252"])
@pytest.mark.parametrize("is_packed", [False, True])
def test_encodings_give_the_same_log(write, encoding, is_packed):
    data = LAYOUTS["German machine"].encode(encoding)
    # Appended members, as a logger that opens its file again writes them.
    packed = gzip.compress(data[:100], mtime=0) + gzip.compress(data[100:], mtime=0)
    path = write(packed, "log.csv.gz") if is_packed else write(data)

    assert_is_the_log(read_log(path, required=("depth", "force")))


@pytest.mark.parametrize(
    ("text", "columns", "words"),
    [
        ("\ufefft,f\r\n0,1\r\n1,2\r\n", {"t": [0, 1], "f": [1, 2]}, ()),
        ("# by someone\n\nt,f\n# half\n0,1\n\n1,2\n", {"t": [0, 1], "f": [1, 2]}, ()),
        ('"t", "f"\n"0","1"\n"1","2"\n', {"t": [0, 1], "f": [1, 2]}, ()),
        ("# by numpy\n# t,f\n0,1\n1,2\n", {"t": [0, 1], "f": [1, 2]}, ()),
        ("t,f\n0,1,\n1,2,\n", {"t": [0, 1], "f": [1, 2]}, ()),
        ('t,"f [N, axial]"\n0,1\n', {"t": [0], "f [N, axial]": [1]}, ()),
        ("t,f\n0,\n1,nan\n2,5\n", {"t": [0, 1, 2], "f": [None, None, 5]}, ()),
        ("t;f\n0,0;1,5\n0,1;-2\n", {"t": [0, 0.1], "f": [1.5, -2]}, ("commas",)),
        ("t,f\n0,1\n1,bad\n3,4\n", {"t": [0, 1, 3], "f": [1, None, 4]}, ("'f'",)),
        ("t,f\n0,1\n1,1_0\n", {"t": [0, 1], "f": [1, None]}, ("'f'",)),
        ("t,phase,spare\n0,in,\n1,out,\n", {"t": [0, 1]}, ("empty", "'in'")),
        (
            "t,f\n0,1\n1\n2,3,4\n3,5\n",
            {"t": [0, 1, 3], "f": [1, None, 5]},
            ("left out: 1",),
        ),
        ("t f\n0 1\n1\n3 5\n", {"t": [0, 1, 3], "f": [1, None, 5]}, ()),
        ("t,f\n0,1\n1,2\n2", {"t": [0, 1, 2], "f": [1, 2, None]}, ()),
        ("t,f,f\n0,1,2\n", {"t": [0], "f": [1], "column_3": [2]}, ("column_3",)),
        ("0,1\n1,2\n", {"column_1": [0, 1], "column_2": [1, 2]}, ("no header",)),
        ('t,q\n0,"[1, 2]"\n1,"[1, 2]"\n', {"t": [0, 1]}, ("as columns",)),
    ],
)
def test_what_is_odd_in_a_text_is_reported(write, text, columns, words):
    table = read_table(write(text))

    assert list(table.columns) == list(columns)
    for name, values in columns.items():
        expected = np.array(values, dtype=np.float64)
        np.testing.assert_array_equal(table.columns[name], expected)

    assert len(table.warnings) == len(words)
    assert all(word in note for word, note in zip(words, table.warnings, strict=True))


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"t,f\n",
        b"no table at all\n",
        b"a,b\nx,y\nz,w\n",
        "t,f\n0,1\n".encode("utf-16-le"),
        b"t,f\n0,1\n\0\0\0\0",
        gzip.compress(b"t,f\n" + b"0,1\n" * 4000, mtime=0)[:40],
        b't,f\n0,1\n1,"2\n',
    ],
)
def test_a_text_without_a_sound_table_is_refused(write, data):
    with pytest.raises(FormatError):
        read_table(write(data))


def test_a_table_of_results_is_not_taken_for_the_recording(write):
    results = "".join(f"{k},{k / 7:.3f}\n" for k in range(20))
    text = f"No,Maximum\n,(N)\n{results}\nTime,Travel,Load\ns,mm,N\n{rows_of()}"

    assert_is_the_log(read_log(write(text), required=("depth", "force")))


def test_times_of_a_clock_are_seconds_of_one_day(write):
    header = "No.,Time(h:m:s),Position(mm),Force(N)\n"
    rows = "1,23:59:59.970,1,2\n2,23:59:59.980,1,2\n3,,1,2\n4,23:59:59.990,1,2\n"
    log = read_log(write(header + rows), required=("depth", "force"))

    np.testing.assert_allclose(log.t_s, [86399.97, 86399.98, 86399.99])
    assert log.left_out == 1
    with pytest.raises(LogError, match="set back"):
        read_log(write(header + rows + "5,00:00:00.000,1,2\n"))


def test_dates_with_times_lose_no_nanosecond(write):
    path = write(
        "time,force_N\n2024-05-01 12:00:00.123456789,1\n"
        "2024-05-01T14:00:00.123456799+02:00,2\n2024-05-01 12:00:00.123456809Z,3\n"
    )
    log = read_log(path)

    assert log.start_ns == 1_714_564_800_123_456_789
    assert log.t_s.tolist() == [0.0, 1e-8, 2e-8]


FIELDS = ("position", "velocity", "effort")


def by_path():
    names = [
        f"/joint_states/{j}/{field}" for field in FIELDS for j in ("elbow", "base")
    ]
    return ["__time", *names], []


def by_numbered_names():
    names = [f"field.{field}{i}" for field in FIELDS for i in (0, 1)]
    return ["t", "field.name0", "field.name1", *names], ["elbow", "base"]


def by_list_of_names():
    names = [f"{field}_{i}" for field in FIELDS for i in (0, 1)]
    return ["Time", "name", *names], ["\"['elbow', 'base']\""]


@pytest.mark.parametrize("export", [by_path, by_numbered_names, by_list_of_names])
def test_exported_joints_are_put_into_the_robots_order_by_their_names(write, export):
    names, texts = export()
    values = [0.1, 0.2, 1.1, 1.2, 2.1, 2.2]  # of the elbow and the base in turns
    rows = [[0.01 * k, *texts, *(v + k for v in values)] for k in range(10)]
    lines = [",".join(map(str, row)) for row in [names, *rows]]
    path = write("\n".join(lines))
    log = read_log(path, required=["q", "dq", "tau"], joints=("base", "elbow"))

    row = np.arange(10)
    np.testing.assert_allclose(log["q_rad"], np.stack([0.2 + row, 0.1 + row], axis=1))
    np.testing.assert_allclose(log["dq_rad_s"][:, 0], 1.2 + row)
    np.testing.assert_allclose(log["tau_Nm"][:, 1], 2.1 + row)


def test_a_list_of_names_that_fits_no_columns_is_not_used(write):
    rows = "".join(f"{0.01 * k},\"['elbow', 'base']\",1,2,3\n" for k in range(10))
    path = write("Time,name,position_0,position_1,position_2\n" + rows)
    log = read_log(path, required=["q"], joints=("a", "b", "c"))

    assert log["q_rad"][0].tolist() == [1.0, 2.0, 3.0]
    assert "'name'" in log.warnings[0]
