"""Time between rows: late rows are no step, and a clock that was set back is followed."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from needleforce.recordings import Log
from needleforce.recordings.timestamps import RowClock

T_S = np.arange(1000) / 1000


def test_rows_in_order_take_their_differences():
    dt_s = RowClock().update(T_S + 5.0)
    assert dt_s[0] == np.inf
    np.testing.assert_allclose(dt_s[1:], 0.001)


def test_late_and_repeated_rows_do_not_advance_and_shift_nothing():
    t_s = T_S.copy()
    t_s[100::50] -= 0.02
    t_s[320] = t_s[319]
    dt_s = RowClock().update(t_s)
    advances = dt_s > 0.0
    assert np.count_nonzero(~advances) == 19
    assert dt_s[advances][1:].sum() == pytest.approx(t_s.max() - t_s[0])


def test_stamps_that_run_ahead_once_shift_nothing():
    t_s = T_S.copy()
    t_s[100:900:200] += 0.09
    dt_s = RowClock().update(t_s)
    assert dt_s[dt_s > 0.0][1:].sum() == pytest.approx(T_S[-1])


@pytest.mark.parametrize("back_s", [0.5, 3600.0])
def test_a_clock_that_stays_back_is_followed_after_a_few_rows(back_s):
    t_s = np.concatenate((T_S, T_S[-1] + T_S + 0.001 - back_s))
    dt_s = RowClock().update(t_s)
    late = dt_s[1000:] <= 0.0
    assert 3 <= np.count_nonzero(late) <= 105
    assert not late[110:].any()
    assert dt_s[dt_s > 0.0][1:].sum() == pytest.approx(1.998, abs=0.002)


def test_a_clock_a_little_back_catches_up():
    t_s = np.concatenate((T_S, T_S[-1] + T_S - 0.08))
    dt_s = RowClock().update(t_s)
    assert dt_s[dt_s > 0.0][1:].sum() == pytest.approx(t_s[-1])


@given(st.integers(1, 2500), st.integers(0, 900))
def test_pieces_give_what_the_whole_gives(cut, late):
    t_s = np.concatenate((T_S, T_S, T_S + 2.0))
    t_s[late] -= 0.3
    clock = RowClock()
    found = np.concatenate([clock.update(t_s[:cut]), clock.update(t_s[cut:])])
    np.testing.assert_array_equal(found, RowClock().update(t_s))


def test_a_log_tells_that_its_clock_was_set_back():
    log = Log(t_s=np.concatenate((T_S, T_S)), channels={"force_N": np.ones(2000)})
    assert "clock set back, from where it counts anew: 1 (first: row 1101" in log.warnings[0]
    assert "stamps running backward: 100 (first: row 1001, 0 s after 0.999 s)" in log.warnings[1]
