"""A log and a table: what they hold, refuse and report."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from needleforce import recordings
from needleforce.recordings import ColumnError, FormatError, Log, LogError, RecordingError, Table
from needleforce.recordings.timestamps import RowClock

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
