"""A log and a table: what they hold, refuse and report; and the time of their rows."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from needleforce import recordings
from needleforce.recordings import (
    ColumnError,
    FormatError,
    Log,
    LogError,
    RecordingError,
    Table,
    read_log,
    write_log,
    write_table,
)
from needleforce.recordings.follow import FollowOptions
from needleforce.recordings.log import LogStream
from needleforce.recordings.open_recording import stream_tables
from needleforce.recordings.table import RowClock, start_of_clock, to_nanoseconds, to_seconds

T_S = np.arange(4) / 1000.0


def test_all_is_sorted_and_resolves():
    assert list(recordings.__all__) == sorted(recordings.__all__)
    assert all(hasattr(recordings, name) for name in recordings.__all__)
    assert len(recordings.__all__) <= 20


def test_every_error_has_the_one_base_and_is_one_level_below_it():
    leaves = [getattr(recordings, name) for name in recordings.__all__ if name.endswith("Error")]
    leaves.remove(RecordingError)
    assert len(leaves) == 5
    assert all(leaf.__bases__[0] is RecordingError and len(leaf.__bases__) == 2 for leaf in leaves)


def test_log_stores_read_only_copies():
    t_s, force_N = T_S.copy(), np.ones(4)
    log = Log(t_s=t_s, channels={"force_N": force_N})
    t_s[0] = force_N[0] = 99.0
    assert log.t_s[0] == 0.0
    assert log["force_N"][0] == 1.0
    assert not log.t_s.flags.writeable
    assert not log["force_N"].flags.writeable
    with pytest.raises(TypeError):
        log.channels["force_N"] = force_N  # pyright: ignore
    with pytest.raises(dataclasses.FrozenInstanceError):
        log.t_s = t_s  # pyright: ignore


def test_log_answers_for_its_channels():
    log = Log(t_s=T_S, channels={"q_rad": np.zeros((4, 7))})
    assert len(log) == 4
    assert "q_rad" in log
    assert "tau_Nm" not in log
    with pytest.raises(ColumnError, match="no channel 'tau_Nm'; it has: q_rad"):
        log["tau_Nm"]


@pytest.mark.parametrize(
    ("t_s", "channels", "message"),
    [
        (T_S, {}, "at least one channel"),
        (T_S[:, None], {"force_N": T_S}, "expected"),
        ([], {"force_N": []}, "n > 0"),
        ([0.0, np.nan, 1.0], {"force_N": [0.0, 0.0, 0.0]}, "not finite: 1 .first: row 2"),
        (T_S, {"force_N": T_S[:-1]}, r"force_N has shape \(3,\).*4 stamps"),
        (T_S, {"force_N": np.zeros((4, 1, 1))}, "shape"),
        (T_S, {"force_N": np.full(4, np.nan)}, "no finite value in 4 rows"),
        (T_S, {"force_N": ["a", "b", "c", "d"]}, "force_N is not an array of numbers"),
        ([3.0, 2.0, 1.0], {"force_N": [0.0, 0.0, 0.0]}, "no usable time"),
        ([1.0, 1.0], {"force_N": [0.0, 0.0]}, "at least two time stamps must advance"),
        ([1.0], {"force_N": [0.0]}, "no usable time"),
    ],
)
def test_what_is_no_log_is_refused_with_the_reason(t_s, channels, message):
    with pytest.raises(LogError, match=message):
        Log(t_s=t_s, channels=channels)


def test_backward_and_repeated_stamps_are_counted_and_kept():
    t_s = np.array([0.0, 1.0, 0.5, 1.0, 2.0, 2.0])
    log = Log(t_s=t_s, channels={"force_N": np.zeros(6)})
    np.testing.assert_array_equal(log.t_s, t_s)
    backward, repeated = log.warnings
    assert "backward: 1 (first: row 3, 0.5 s after 1 s)" in backward
    assert "repeated: 2 (first: row 4, 1 s after 1 s)" in repeated


@given(hnp.arrays(np.float64, st.integers(2, 30), elements=st.integers(-5, 5).map(float)))
def test_every_stamp_advances_or_is_counted(t_s):
    advancing = int(np.count_nonzero(RowClock().update(t_s)[1:] > 0.0))
    if not advancing:
        with pytest.raises(LogError):
            Log(t_s=t_s, channels={"force_N": np.zeros(t_s.size)})
        return
    log = Log(t_s=t_s, channels={"force_N": np.zeros(t_s.size)})
    faults = [warning for warning in log.warnings if "set back" not in warning]
    counted = sum(int(warning.split(": ")[2].split()[0]) for warning in faults)
    assert advancing + counted == t_s.size - 1


def test_missing_values_are_counted_by_row_not_refused():
    q_rad = np.zeros((4, 7))
    q_rad[2, 3] = np.nan
    q_rad[2, 4] = np.inf
    log = Log(t_s=T_S, channels={"q_rad": q_rad})
    assert log.warnings == ("q_rad: rows with NaN or infinity: 1 (first: row 3)",)
    np.testing.assert_array_equal(log["q_rad"], q_rad)


def test_a_log_made_from_a_log_says_nothing_twice():
    log = Log(t_s=[0.0, 1.0, 1.0], channels={"force_N": [0.0, np.nan, 1.0]}, warnings=("w",))
    again = Log(t_s=log.t_s, channels=log.channels, warnings=log.warnings)
    assert again.warnings == log.warnings
    assert len(log.warnings) == 3


def test_table_keeps_copies_and_describes_its_columns():
    values = np.zeros((3, 2))
    table = Table(columns={"wrench": values, "t": np.zeros(3)})
    values[0] = 1.0
    assert not table.columns["wrench"].any()
    assert table.describe() == "wrench (2 columns), t"
    assert table.describe(limit=1) == "wrench (2 columns) and 1 more"


@pytest.mark.parametrize(
    ("columns", "error", "message"),
    [
        ({}, FormatError, "at least one"),
        ({"x": np.zeros((2, 2, 2))}, FormatError, "expected"),
        ({"x": [[1.0], [1.0, 2.0]]}, LogError, "x is not an array of numbers"),
    ],
)
def test_what_is_no_table_is_refused_with_the_reason(columns, error, message):
    with pytest.raises(error, match=message):
        Table(columns=columns)


RAMP_S = np.arange(1000) / 1000


def test_rows_in_order_take_their_differences():
    dt_s = RowClock().update(RAMP_S + 5.0)
    assert dt_s[0] == np.inf
    np.testing.assert_allclose(dt_s[1:], 0.001)


def test_late_and_repeated_rows_do_not_advance_and_shift_nothing():
    t_s = RAMP_S.copy()
    t_s[100::50] -= 0.02
    t_s[320] = t_s[319]
    dt_s = RowClock().update(t_s)
    advances = dt_s > 0.0
    assert np.count_nonzero(~advances) == 19
    assert dt_s[advances][1:].sum() == pytest.approx(t_s.max() - t_s[0])


def test_stamps_that_run_ahead_once_shift_nothing():
    t_s = RAMP_S.copy()
    t_s[100:900:200] += 0.09
    dt_s = RowClock().update(t_s)
    assert dt_s[dt_s > 0.0][1:].sum() == pytest.approx(RAMP_S[-1])


@pytest.mark.parametrize("back_s", [0.5, 3600.0])
def test_a_clock_that_stays_back_is_followed_after_a_few_rows(back_s):
    t_s = np.concatenate((RAMP_S, RAMP_S[-1] + RAMP_S + 0.001 - back_s))
    dt_s = RowClock().update(t_s)
    late = dt_s[1000:] <= 0.0
    assert 3 <= np.count_nonzero(late) <= 105
    assert not late[110:].any()
    assert dt_s[dt_s > 0.0][1:].sum() == pytest.approx(1.998, abs=0.002)


def test_a_clock_a_little_back_catches_up():
    t_s = np.concatenate((RAMP_S, RAMP_S[-1] + RAMP_S - 0.08))
    dt_s = RowClock().update(t_s)
    assert dt_s[dt_s > 0.0][1:].sum() == pytest.approx(t_s[-1])


@given(st.integers(1, 2500), st.integers(0, 900))
def test_pieces_give_what_the_whole_gives(cut, late):
    t_s = np.concatenate((RAMP_S, RAMP_S, RAMP_S + 2.0))
    t_s[late] -= 0.3
    clock = RowClock()
    found = np.concatenate([clock.update(t_s[:cut]), clock.update(t_s[cut:])])
    np.testing.assert_array_equal(found, RowClock().update(t_s))


def test_a_log_shows_that_its_clock_was_set_back():
    log = Log(t_s=np.concatenate((RAMP_S, RAMP_S)), channels={"force_N": np.ones(2000)})
    assert "clock set back, from where it counts anew: 1 (first: row 1101" in log.warnings[0]
    assert "stamps running backward: 100 (first: row 1001, 0 s after 0.999 s)" in log.warnings[1]


SUFFIXES = ("csv", "csv.gz", "npz", "parquet", "mcap", "db3")
EPOCH_NS = 1_700_000_000_123_456_789


@given(
    first_ns=st.one_of(st.integers(0, 1 << 40), st.integers(1 << 60, (1 << 62) - 1)),
    since_ns=st.lists(st.integers(0, 86_400 * 10**9), min_size=1, max_size=20),
)
def test_stamps_come_back_from_seconds(first_ns, since_ns):
    stamps_ns = np.array([first_ns, *(first_ns + step for step in since_ns)])
    start_ns = start_of_clock(first_ns)
    assert to_nanoseconds(to_seconds(stamps_ns, start_ns), start_ns).tolist() == stamps_ns.tolist()
    assert start_ns in (0, first_ns)


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("start_ns", [0, EPOCH_NS])
def test_every_format_keeps_the_clock_of_the_source(tmp_path, suffix, start_ns):
    stamps_ns = start_ns + np.cumsum(np.arange(300)) * 1_000_003
    log = Log(
        t_s=to_seconds(stamps_ns, start_ns),
        channels={"q_rad": np.zeros((300, 2))},
        start_ns=start_ns,
    )
    path = tmp_path / f"log.{suffix}"
    write_log(path, log)
    again = read_log(path, required=["q"])
    assert to_nanoseconds(again.t_s, again.start_ns).tolist() == stamps_ns.tolist()
    stream = LogStream(stream_tables(path, FollowOptions()), required=["q"])
    t_s = np.concatenate([chunk.t_s for chunk in stream])
    assert to_nanoseconds(t_s, stream.start_ns).tolist() == stamps_ns.tolist()


def test_the_comment_of_a_csv_is_read_and_others_are_not(tmp_path):
    path = tmp_path / "log.csv"
    for comment, start_ns in (("# start_ns = 17", 17), ("#start_ns=-3", -3), ("# start_ns = x", 0)):
        path.write_text(f"{comment}\nt,force\n0.0,1\n0.1,2\n", encoding="utf-8")
        assert read_log(path).start_ns == start_ns


@pytest.mark.parametrize("suffix", ["csv", "csv.gz", "npz", "parquet"])
@pytest.mark.parametrize("is_ragged", [False, True])
def test_whole_nanoseconds_since_the_epoch_lose_no_digit(tmp_path, suffix, is_ragged):
    stamps_ns = EPOCH_NS + np.cumsum(np.arange(5000)) % 7 + 1_000_003 * np.arange(5000)
    path = tmp_path / f"log.{suffix}"
    write_table(path, {"time [ns]": stamps_ns, "force_N": np.ones(5000)})
    if is_ragged and suffix == "csv":
        lines = path.read_text().splitlines()
        lines[3000:3000] = ["1,2,3", f"{EPOCH_NS}"]
        path.write_text("\n".join(lines) + "\n")
    log = read_log(path)
    assert to_nanoseconds(log.t_s, log.start_ns).tolist() == stamps_ns.tolist()
    stream = LogStream(stream_tables(path, FollowOptions()))
    t_s = np.concatenate([chunk.t_s for chunk in stream])
    assert to_nanoseconds(t_s, stream.start_ns).tolist() == stamps_ns.tolist()
    write_log(tmp_path / "log.mcap", log)
    again = read_log(tmp_path / "log.mcap")
    assert to_nanoseconds(again.t_s, again.start_ns).tolist() == stamps_ns.tolist()


@pytest.mark.parametrize("row", [100, 4000])
def test_a_stamp_that_is_no_whole_number_costs_digits_but_no_second(tmp_path, row):
    path = tmp_path / "log.csv"
    stamps_ns = [EPOCH_NS + 1_000_000 * k for k in range(5000)]
    lines = [f"{stamp},1.0" for stamp in stamps_ns]
    lines[row] = "oops,1.0"
    path.write_text("\n".join(["time_ns,force_N", *lines]) + "\n")
    t_s = np.concatenate([chunk.t_s for chunk in LogStream(stream_tables(path, FollowOptions()))])
    assert len(t_s) == 4999
    expected_s = np.delete(1e-3 * np.arange(5000), row)
    np.testing.assert_allclose(t_s - t_s[0], expected_s, atol=2e-6)
