"""Rows with bad stamps are left out and named, rows out of order are sorted."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from needleforce.recordings import MappingError, Table, read_log, write_table
from needleforce.recordings.channel_request import ChannelRequest
from needleforce.recordings.log_stream import LogStream
from needleforce.recordings.mapping import ColumnMapping
from needleforce.recordings.stamp_order import StampOrder
from needleforce.recordings.time_stamps import to_nanoseconds

STEP_S = 0.002
T_S = STEP_S * np.arange(3000)
EPOCH_S = 1.7e9


def with_stamps(rows, stamps_s, t_s=T_S):
    changed_s = t_s.copy()
    changed_s[rows] = stamps_s
    return changed_s


def late_by(max_late_s):
    """Return stamps of rows that were written up to a time later than their own."""
    late_s = np.random.default_rng(3).uniform(0.0, max_late_s, T_S.size)
    return T_S[np.argsort(T_S + late_s, kind="stable")]


def log_of(t_s, sorted_within_s=1.0, **mapping):
    """Return the log of rows that carry their number as force."""
    table = Table(columns={"t_s": t_s, "force_N": np.arange(1.0, len(t_s) + 1.0)})
    request = ChannelRequest(ColumnMapping(**mapping), ("force",))
    return LogStream([table], request, sorted_within_s).joined()


BAD_STAMPS = {
    "ahead": ([1000], 22.0),
    "far ahead": ([100], 4e8),
    "behind": ([2000], -3.0),
    "zero": ([1500], 0.0),
    "near, ahead": ([1500], T_S[1500] + 0.5),
    "near, behind": ([1500], T_S[1500] - 0.5),
    "first, ahead": ([0], 1e9),
    "first, behind": ([0], -50.0),
    "last": ([2999], 1e9),
    "two neighbours": ([1000, 1001], [22.0, 22.002]),
    "four that disagree": ([1000, 1001, 1002, 1003], [22.0, -5.0, 1e9, 7.0]),
}


@pytest.mark.parametrize("case", BAD_STAMPS)
def test_bad_stamps_are_left_out_and_named(case):
    rows, stamps_s = BAD_STAMPS[case]
    log = log_of(with_stamps(rows, stamps_s))

    np.testing.assert_array_equal(log.t_s, np.delete(T_S, rows))
    np.testing.assert_array_equal(
        log["force_N"], np.delete(np.arange(1.0, 3001.0), rows)
    )
    assert f"row {rows[0] + 1} has a bad time stamp and is left out" in log.warnings[0]


def test_a_bad_stamp_is_named_with_its_neighbours():
    (warning,) = log_of(with_stamps(1000, 22.0)).warnings

    assert warning.endswith("22 s, between 1.998 s and 2.002 s")


@pytest.mark.parametrize("rows", [slice(0, 100), slice(1000, 1100)])
def test_stamps_that_were_not_set_are_no_clock(rows):
    log = log_of(with_stamps(rows, 0.0, EPOCH_S + T_S))

    assert len(log) == 2900
    assert log.t_s[0] > EPOCH_S - 1.0
    assert "rows with a bad time stamp, left out: 100" in log.warnings


@pytest.mark.parametrize(("step_s", "is_reported"), [(3600.0, True), (3.0, False)])
def test_a_step_that_lasts_is_no_bad_stamp(step_s, is_reported):
    t_s = np.where(np.arange(3000) < 1500, T_S, T_S + step_s)
    log = log_of(t_s)

    np.testing.assert_array_equal(log.t_s, t_s)
    assert any("paused or its clock was set" in text for text in log.warnings) == (
        is_reported
    )


@pytest.mark.parametrize("back_s", [0.5, 3600.0])
def test_a_clock_set_back_is_not_sorted(back_s):
    t_s = np.where(np.arange(3000) < 1500, T_S, T_S - back_s)
    log = log_of(t_s)

    np.testing.assert_array_equal(log.t_s, t_s)
    assert "time: clock set back" in log.warnings[0]


@pytest.mark.parametrize("late_s", [0.1, 0.5])
def test_rows_out_of_order_are_sorted_and_counted(late_s):
    stamps_s = late_by(late_s)
    log = log_of(stamps_s)
    late_count = np.count_nonzero(stamps_s < np.maximum.accumulate(stamps_s))

    np.testing.assert_array_equal(log.t_s, T_S)
    np.testing.assert_array_equal(stamps_s[log["force_N"].astype(int) - 1], T_S)
    assert log.warnings[0].startswith(
        f"time: rows out of order, sorted within 1 s: {late_count} of 3000"
    )


def test_a_block_written_late_fills_its_place():
    t_s = np.concatenate((T_S[:1000], T_S[1100:1200], T_S[1000:1100], T_S[1200:]))

    np.testing.assert_array_equal(log_of(t_s).t_s, T_S)


def test_a_wider_window_sorts_what_comes_later():
    stamps_s = late_by(3.0)

    assert any("--sort-within" in text for text in log_of(stamps_s).warnings)
    np.testing.assert_array_equal(log_of(stamps_s, sort_within_s=4.0).t_s, T_S)
    with pytest.raises(MappingError, match="sort_within_s = -1"):
        ColumnMapping(sort_within_s=-1.0)


def test_live_rows_keep_their_order_without_bad_stamps():
    stamps_s = late_by(0.05)

    np.testing.assert_array_equal(log_of(stamps_s, 0.0).t_s, stamps_s)
    assert len(log_of(with_stamps(1000, 22.0), 0.0)) == 2999


@pytest.mark.parametrize("step_s", [1.0, 30.0])
def test_slow_and_uneven_logs_keep_all_rows(step_s):
    t_s = np.cumsum(np.random.default_rng(4).exponential(step_s, 500))

    np.testing.assert_array_equal(log_of(t_s).t_s, t_s)


@example(cut=1000, late_s=0.1, bad=1000)
@given(
    cut=st.integers(1, 2999),
    late_s=st.sampled_from([0.0, 0.1, 0.9]),
    bad=st.integers(0, 2999),
)
def test_pieces_give_what_the_whole_gives(cut, late_s, bad):
    t_s = with_stamps(bad, 50.0, late_by(late_s) if late_s else T_S)
    rows = {"t_s": t_s, "row": np.arange(1.0, 3001.0)}
    whole = rows_in_order([rows])
    pieces = [{key: values[:cut] for key, values in rows.items()}]
    pieces += [{key: values[cut:] for key, values in rows.items()}]

    np.testing.assert_array_equal(rows_in_order(pieces), whole)


def rows_in_order(pieces):
    order = StampOrder()
    ready = [part for piece in pieces for part in order.add(piece)]
    return np.concatenate([part["row"] for part in [*ready, *order.finish()]])


@pytest.mark.parametrize("first_ns", [0, 2_000_000_000_000_000_000])
@pytest.mark.parametrize("suffix", ["csv", "npz"])
def test_a_bad_first_stamp_does_not_begin_the_clock(tmp_path, first_ns, suffix):
    stamps_ns = 1_700_000_000_123_456_789 + 2_000_000 * np.arange(400)
    stamps_ns[0] = first_ns
    path = tmp_path / f"log.{suffix}"
    columns = {"time [ns]": stamps_ns, "force_N": np.ones(400)}
    write_table(path, columns)
    log = read_log(path)

    assert log.t_s[0] == 0.0
    assert to_nanoseconds(log.t_s, log.start_ns).tolist() == stamps_ns[1:].tolist()


@pytest.mark.parametrize("grain_s", [0.1, 1.0])
@pytest.mark.parametrize("size", [3000, 700, 150])
def test_rows_between_rounded_stamps_are_numbered(grain_s, size):
    t_s = 12345.0 + 0.001 * np.arange(3000)
    rounded_s = np.round(np.floor(t_s / grain_s + 1e-9) * grain_s, 6)
    force_N = np.arange(1.0, 3001.0)
    tables = [
        Table(
            columns={
                "t_s": rounded_s[k : k + size],
                "force_N": force_N[k : k + size],
            }
        )
        for k in range(0, 3000, size)
    ]
    log = LogStream(tables, ChannelRequest(required=("force",))).joined()

    np.testing.assert_array_equal(log["force_N"], force_N)
    np.testing.assert_allclose(np.diff(log.t_s), 0.001, atol=1e-8)
    assert f"stamps are rounded to {grain_s:.3g} s" in log.warnings[0]
    assert "at about 1000 Hz" in log.warnings[0]


def test_rows_that_were_written_twice_are_not_numbered():
    t_s = np.repeat(np.arange(300.0) / 100.0, 10)
    columns = {"t_s": t_s, "force_N": np.repeat(np.arange(300.0), 10)}
    columns["depth_m"] = np.where(t_s > 2.0, 0.1, np.nan)
    request = ChannelRequest(required=("force", "depth"))
    log = LogStream([Table(columns=columns)], request).joined()

    np.testing.assert_array_equal(log.t_s, t_s)
    assert "stamps repeated: 2700" in log.warnings[0]
