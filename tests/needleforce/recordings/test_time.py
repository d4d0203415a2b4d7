"""Time stamps of a log: their order, what is left out, what is refused."""

import numpy as np
import pandas as pd
import pytest

from needleforce.recordings import (
    CHANNELS,
    ChannelRequest,
    ColumnMapping,
    ColumnSpec,
    FormatError,
    LogError,
    MappingError,
    Table,
    UnitError,
    parse_column_spec,
    read_log,
    write_table,
)
from needleforce.recordings.log import log_of_table
from tests.needleforce.recordings.bag_samples import mapped

ROWS = 400
T_S = 0.01 * np.arange(ROWS)
FORCE_N = np.sin(T_S)
REPEATED_S = T_S.copy()
REPEATED_S[7] = REPEATED_S[6]
LATE = np.arange(ROWS)
LATE[100:140] = np.roll(LATE[100:140], 7)
SPIKE_S = T_S.copy()
SPIKE_S[50] += 3600.0
MISSING_S = T_S.copy()
MISSING_S[3] = np.nan


def read(tmp_path, t_s, force_N=FORCE_N, **mapping):
    path = tmp_path / "log.npz"
    write_table(path, {"t_s": t_s, "force_N": force_N})
    return read_log(path, ColumnMapping(**mapping), required=["force"])


@pytest.mark.parametrize(
    ("t_s", "kept", "word"),
    [
        (T_S, np.arange(ROWS), None),
        (MISSING_S, np.delete(np.arange(ROWS), 3), "row 4"),
        (SPIKE_S, np.delete(np.arange(ROWS), 50), "row 51"),
        (REPEATED_S, np.delete(np.arange(ROWS), 7), "left out: 1"),
        (T_S[LATE], np.argsort(LATE), "sorted: "),
        (T_S + np.where(np.arange(ROWS) < 200, 0.0, 60.0), np.arange(ROWS), None),
    ],
    ids=["even", "missing", "bad stamp", "repeated", "late", "a gap"],
)
def test_rows_are_in_the_order_of_time_and_odd_ones_are_reported(
    tmp_path, t_s, kept, word
):
    log = read(tmp_path, t_s)

    np.testing.assert_array_equal(log.t_s, t_s[kept])
    np.testing.assert_array_equal(log["force_N"], FORCE_N[kept])
    assert log.left_out == ROWS - len(kept)
    assert len(log.warnings) == (word is not None)
    assert word is None or word in log.warnings[0]


SET_BACK_S = np.concatenate((T_S[:300], T_S[:100]))
ROUNDED_S = 0.1 * (np.arange(ROWS) // 10)
BURSTS_S = 0.08 * (np.arange(ROWS) // 8) + 0.0001 * (np.arange(ROWS) % 8)


@pytest.mark.parametrize(
    ("t_s", "word"),
    [
        (SET_BACK_S, "row 301"),
        (ROUNDED_S, "share"),
        (BURSTS_S, "bursts"),
        (np.zeros(ROWS), "share"),
        (np.append(np.zeros(1), np.full(ROWS - 1, np.nan)), "no usable time"),
    ],
    ids=["clock set back", "rounded", "bursts", "never advances", "one stamp"],
)
def test_stamps_that_do_not_tell_the_time_of_a_sample_are_refused(tmp_path, t_s, word):
    with pytest.raises(LogError, match=word):
        read(tmp_path, t_s)


@pytest.mark.parametrize("t_s", [ROUNDED_S, BURSTS_S], ids=["rounded", "bursts"])
def test_the_rate_that_serves_in_place_of_stamps_is_named(tmp_path, t_s):
    with pytest.raises(LogError) as refused:
        read(tmp_path, t_s)
    assert "--rate 100," in refused.value.advice
    log = read(tmp_path, t_s, rate_hz=100.0)

    np.testing.assert_allclose(log.t_s, T_S)
    np.testing.assert_array_equal(log["force_N"], FORCE_N)


def test_samples_that_repeat_a_value_under_one_stamp_are_one(tmp_path):
    held = np.repeat(np.arange(ROWS // 4), 4)
    log = read(tmp_path, 0.04 * held, FORCE_N[held])

    np.testing.assert_array_equal(log["force_N"], FORCE_N[: ROWS // 4])


@pytest.mark.parametrize(
    ("whole", "fraction", "factor", "time"),
    [
        ("header.stamp.sec", "header.stamp.nanosec", 1e9, None),
        ("timestamp_sec", "timestamp_nanosec", 1e9, None),
        ("secs", "nsecs", 1e9, None),
        ("sec", "nanosec", 1e9, None),
        ("header.stamp.secs", "header.stamp.nsecs", 1e9, None),
        ("/cell/header/stamp/sec", "/cell/header/stamp/nanosec", 1e9, None),
        ("header_stamp_sec", "header_stamp_nanosec", 1e9, None),
        ("t.sec", "t.usec", 1e6, "t.sec:s+t.usec:us"),
        ("a", "b", 1e3, "a:s+b:ms"),
    ],
)
def test_a_stamp_in_two_columns_is_their_sum(tmp_path, whole, fraction, factor, time):
    path = tmp_path / "log.csv"
    fractions = np.round(factor * (T_S % 1.0))
    columns = {whole: 1.7e9 + np.floor(T_S), fraction: fractions, "force_N": FORCE_N}
    write_table(path, columns)
    spec = parse_column_spec(time, CHANNELS["time"]) if time else None
    log = read_log(path, mapped(time=spec) if spec else None, required=["force"])

    assert log.start_ns == 1_700_000_000_000_000_000
    np.testing.assert_allclose(log.t_s, T_S, atol=1e-12)
    np.testing.assert_array_equal(log["force_N"], FORCE_N)


def test_a_sum_has_a_unit_for_each_column():
    spec = ColumnSpec(columns=("a", "b"), unit=("s",))
    with pytest.raises(MappingError, match="time"):
        log_of_table(
            Table(columns={"a": T_S, "b": T_S, "f": T_S}),
            ChannelRequest(mapped(time=spec)),
        )


def test_a_whole_stamp_beside_its_parts_is_taken(tmp_path):
    path = tmp_path / "log.csv"
    parts = {"stamp.secs": np.floor(T_S), "stamp.nsecs": 1e9 * (T_S % 1.0)}
    write_table(path, {"t": T_S, **parts, "force_N": FORCE_N})

    np.testing.assert_array_equal(read_log(path, required=["force"]).t_s, T_S)


def test_rows_of_two_clocks_in_one_table_are_one_log(tmp_path):
    is_force = np.arange(ROWS) % 3 != 0
    rows = {
        "t_s": T_S,
        "depth_mm": np.where(is_force, np.nan, 20.0 * T_S),
        "force_N": np.where(is_force, FORCE_N, np.nan),
    }
    path = tmp_path / "log.csv"
    write_table(path, rows)
    log = read_log(path, required=["depth", "force"])

    np.testing.assert_allclose(log.t_s, T_S[is_force], atol=1e-9)
    np.testing.assert_array_equal(log["force_N"], FORCE_N[is_force])
    np.testing.assert_allclose(log["depth_m"][:-1], 0.02 * log.t_s[:-1], atol=1e-9)

    pause = (T_S > 1.0) & (T_S < 1.5)
    write_table(path, {**rows, "depth_mm": np.where(pause, np.nan, rows["depth_mm"])})
    depth_m = read_log(path, required=["depth", "force"])["depth_m"]
    assert np.isnan(depth_m[(log.t_s > 1.0) & (log.t_s < 1.5)]).all()


def test_a_folder_with_one_file_for_each_signal_is_one_log(tmp_path):
    q_rad = np.column_stack([T_S, 2.0 * T_S])
    shifted_s = T_S + 0.0004
    files = {
        "gel_7_Joint_Positions.dat": (T_S, q_rad),
        "gel_7_Joint_Torques.dat": (shifted_s, 3.0 * q_rad + 5.0),
        "gel_7_Force_Sensor.dat": (
            T_S[:-9],
            np.column_stack([0 * T_S, 0 * T_S, T_S])[:-9],
        ),
    }
    for name, (t_s, values) in files.items():
        np.savetxt(tmp_path / name, np.column_stack([t_s, values]), delimiter=",")
    log = read_log(tmp_path, required=["q", "tau"], optional=["force"])

    np.testing.assert_allclose(log.t_s, shifted_s, atol=1e-9)
    np.testing.assert_allclose(log["tau_Nm"], 3.0 * q_rad + 5.0)
    expected = np.column_stack([shifted_s, 2.0 * shifted_s, -shifted_s])
    found = np.column_stack([log["q_rad"], log["force_N"]])
    np.testing.assert_allclose(found[:-10], expected[:-10], atol=1e-9)
    assert np.isnan(log["force_N"][-9:]).all()

    paths = sorted(tmp_path.iterdir())
    same = read_log(paths, required=["q", "tau"], optional=["force"])
    for name, values in log.channels.items():
        np.testing.assert_array_equal(same[name], values)
    assert "force_N" in read_log(paths, required=["q", "tau"], named=["force"])
    assert "force_N" not in read_log(paths[1:], required=["q", "tau"], named=["force"])


@pytest.mark.parametrize(
    "t_s",
    [BURSTS_S, SET_BACK_S, ROUNDED_S, np.zeros(ROWS), 1e9 * T_S],
    ids=["bursts", "clock set back", "rounded", "never advances", "nanoseconds"],
)
def test_the_stamps_of_every_file_are_judged(tmp_path, t_s):
    for name, stamps in (("force.dat", T_S[: len(t_s)]), ("depth.dat", t_s)):
        rows = np.column_stack([stamps, np.sin(np.arange(len(stamps)))])
        np.savetxt(tmp_path / name, rows, delimiter=";")
    with pytest.raises((LogError, UnitError), match=r"depth\.dat"):
        read_log(tmp_path, required=["depth", "force"])


@pytest.mark.parametrize(
    ("time", "stamps"),
    [
        ("column_1:ms", [1e3 * T_S]),
        ("column_1:s+column_2:ns", [T_S // 1.0, np.rint(1e9 * (T_S % 1.0))]),
    ],
)
def test_stamps_of_files_without_a_header_are_as_the_mapping_says(
    tmp_path, time, stamps
):
    for name in ("force", "depth"):
        rows = np.column_stack([*stamps, 0.1 * FORCE_N])
        np.savetxt(tmp_path / f"{name}.txt", rows, fmt="%.17g")
    mapping = mapped(time=parse_column_spec(time, CHANNELS["time"]))
    log = read_log(tmp_path, mapping, required=["depth", "force"])

    np.testing.assert_allclose(log.t_s, T_S, atol=1e-9)
    np.testing.assert_allclose(log["depth_m"], 0.1 * FORCE_N)


@pytest.mark.parametrize("headers", [("t_s,depth_m", "t_s,force_N"), ("", "")])
def test_rows_of_several_files_are_numbered_at_a_rate(tmp_path, headers):
    rows = [f"0,{force_N / 10!r}" for force_N in FORCE_N.tolist()]
    files = {"depth.csv": [headers[0], *rows], "force.csv": [headers[1], *rows]}
    for name, lines in files.items():
        (tmp_path / name).write_text("\n".join(lines))
    log = read_log(tmp_path, mapped(rate_hz=100.0), required=["depth", "force"])

    np.testing.assert_allclose(log.t_s, T_S)
    np.testing.assert_allclose(log["depth_m"], 0.1 * FORCE_N)
    assert any("column_1" in text for text in log.warnings) is (headers == ("", ""))
    (tmp_path / "force.csv").write_text("\n".join(files["force.csv"][:-1]))
    with pytest.raises(LogError, match="rows"):
        read_log(tmp_path, mapped(rate_hz=100.0), required=["depth", "force"])


COLUMNS = ("column_1", "column_2", "column_3")


@pytest.mark.parametrize("rows", [ROWS - 100, ROWS + 100])
@pytest.mark.parametrize("names", [("t_s", "q", "force_N"), COLUMNS])
def test_a_file_whose_columns_differ_in_rows_is_refused_by_name(tmp_path, names, rows):
    write_table(tmp_path / "stage.csv", {"t_s": T_S, "depth_m": 0.01 * T_S})
    columns = dict(zip(names, (T_S, T_S, np.sin(np.arange(rows))), strict=True))
    np.savez(tmp_path / "cell.npz", **columns)
    with pytest.raises(LogError, match=rf"cell\.npz.*{names[2]}"):
        read_log(tmp_path, required=["depth", "force"])


@pytest.mark.parametrize("header", ["sec,nanosec", "t_s"])
def test_a_file_of_stamps_alone_is_refused_by_name(tmp_path, header):
    write_table(tmp_path / "cell.csv", {"t_s": T_S, "force_N": FORCE_N})
    rows = [",".join(f"{k}" for _ in header.split(",")) for k in range(9)]
    (tmp_path / "stamps.csv").write_text("\n".join([header, *rows]))
    with pytest.raises(FormatError, match=r"stamps\.csv"):
        read_log(tmp_path, required=["force"])


def test_rows_left_out_of_a_file_without_a_header_are_a_warning(tmp_path):
    for name in ("force", "depth"):
        rows = [f"{t_s},{t_s / 10}" for t_s in T_S]
        rows[9] += ",7" if name == "depth" else ""
        (tmp_path / f"{name}.csv").write_text("\n".join(rows))
    said = read_log(tmp_path, required=["depth", "force"]).warnings

    assert any(text.startswith("depth:") for text in said)
    assert not any("header" in text for text in said)


def test_files_that_are_called_alike_are_refused(tmp_path):
    paths = [tmp_path / name for name in ("force.dat", "force.csv")]
    for path in paths:
        np.savetxt(path, np.column_stack([T_S, FORCE_N]), delimiter=",")
    with pytest.raises(FormatError, match="force"):
        read_log(paths)


def test_a_bag_beside_a_file_is_one_log(tmp_path):
    write_table(tmp_path / "arm.mcap", {"t_s": T_S, "q_rad": np.stack([T_S, T_S], 1)})
    write_table(tmp_path / "cell.csv", {"t_s": T_S + 0.001, "force_N": FORCE_N})
    log = read_log(sorted(tmp_path.iterdir()), required=["q", "force"])

    np.testing.assert_allclose(log.t_s, T_S + 0.001, atol=1e-9)
    np.testing.assert_allclose(log["q_rad"][:-1, 1], log.t_s[:-1], atol=1e-9)


def test_files_with_headers_in_a_folder_need_no_layout(tmp_path):
    stage = pd.DataFrame({"time_ms": 1e3 * T_S, "depth_mm": 20.0 * T_S})
    stage.to_csv(tmp_path / "stage.csv")  # its first column numbers the rows
    write_table(tmp_path / "cell.csv", {"time_s": T_S[1:-1], "force_N": FORCE_N[1:-1]})
    log = read_log(tmp_path, required=["depth", "force"])

    np.testing.assert_allclose(log["depth_m"], 0.02 * T_S[1:-1])
    np.testing.assert_array_equal(log["force_N"], FORCE_N[1:-1])
    assert "stage" in log.warnings[0]
