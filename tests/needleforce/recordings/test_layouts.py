"""Layouts of exports: where the table begins, its names, its units and its encoding."""

import gzip

import numpy as np
import pytest

from needleforce.recordings import (
    read_log,
)

HEAD_ROWS = 200

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


def test_a_table_of_results_is_not_taken_for_the_recording(tmp_path):
    path = tmp_path / "log.csv"
    results = "".join(f"{k},{k / 7:.3f}\n" for k in range(20))
    path.write_text(
        f"No,Maximum\n,(N)\n{results}\nTime,Travel,Load\ns,mm,N\n{rows_of()}"
    )

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


def test_bars_may_separate_cells(tmp_path):
    path = tmp_path / "log.txt"
    path.write_text("Time [s]|Travel [mm]|Load [N]\n" + rows_of("|"))

    assert_is_the_log(read_log(path, required=("depth", "force")))
