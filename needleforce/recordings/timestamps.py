"""The time of a recording: stamps without loss, and what is wrong with them."""

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from needleforce.recordings.errors import LogError
from needleforce.recordings.table import FloatArray

NS_PER_S = 1_000_000_000
_EXACT_NS = 1 << 52
"""Up to here (52 days) a double of seconds resolves nanoseconds."""
_EXACT = 1 << 53
"""Up to here float64 holds every whole number."""


def start_of_clock(first_ns: int) -> int:
    """Return the instant from which seconds are counted so that nothing is lost.

    Returns:
        0, so that the file's clock is kept, or the first stamp if that clock began long ago.
    """
    return 0 if abs(first_ns) < _EXACT_NS // 2 else first_ns


def to_seconds(stamps_ns: NDArray[np.int64], start_ns: int) -> FloatArray:
    """Return stamps in seconds since `start_ns`; the nearest double, from which they come back."""
    return (stamps_ns - np.int64(start_ns)) / NS_PER_S


def to_nanoseconds(t_s: ArrayLike, start_ns: int) -> NDArray[np.int64]:
    """Return seconds since `start_ns` as stamps, to the nearest nanosecond; they must be finite."""
    return np.rint(np.asarray(t_s, dtype=np.float64) * NS_PER_S).astype(np.int64) + np.int64(
        start_ns
    )


def whole_stamps(columns: Mapping[str, np.ndarray]) -> dict[str, NDArray[np.int64]]:
    """Return the columns of whole numbers that float64 would round, as ns since 1970 are.

    Args:
        columns: as the file has them, in its own types.
    """
    return {
        name: values.astype(np.int64)
        for name, values in columns.items()
        if values.dtype.kind in "iu" and values.ndim == 1 and exceed_float64(values)
    }


def exceed_float64(values: np.ndarray) -> bool:
    """Return whether float64 rounds whole numbers as large as these, and int64 does not."""
    # Not abs, which overflows for the least integer; a NaN is not larger than anything.
    return bool(len(values)) and bool(((values > _EXACT) & (values < 1 << 63)).all())


_SET_AFTER_S = 0.1
_SET_AFTER_ROWS = 3
"""A row that is not later than those before came late. When so many rows in a row, over so much
time, are later than each other but not than those before, it was not they: the clock was set."""


class RowClock:
    """Time from row to row; a row that comes late is no step, a clock that was set back is left.

    A clock that goes back a little soon catches up; until then rows do not advance. If it stays
    behind, it counts from there, however many rows come at a time.
    """

    def __init__(self) -> None:
        self._latest_s = -math.inf
        self._behind_s = math.inf
        self._rows, self._ran_s = 0, 0.0

    def update(self, t_s: FloatArray) -> FloatArray:
        """Take further rows.

        Args:
            t_s: time stamps in s, shape (n,).

        Returns:
            Time in s since the latest row that advanced, shape (n,): not positive for a row that
            does not, inf for the first of all. The row at which a set clock is recognised
            advances by the time for which it has run.
        """
        dt_s = np.diff(t_s, prepend=self._latest_s)
        if (dt_s > 0.0).all():
            if t_s.size:
                self._latest_s, self._rows = float(t_s[-1]), 0
            return dt_s
        return np.array([self._step(now_s) for now_s in t_s.tolist()])

    def _step(self, now_s: float) -> float:
        dt_s = now_s - self._latest_s
        if dt_s > 0.0:
            self._latest_s, self._rows = now_s, 0
            return dt_s
        # A stamp that is no number says nothing of the clock.
        if not dt_s < 0.0 or (self._rows and now_s == self._behind_s):
            return dt_s
        if not self._rows or now_s < self._behind_s:
            self._rows, self._ran_s = 0, 0.0
        else:
            self._ran_s += now_s - self._behind_s
        self._rows, self._behind_s = self._rows + 1, now_s
        if self._rows < _SET_AFTER_ROWS or self._ran_s < _SET_AFTER_S:
            return dt_s
        self._latest_s, self._rows = now_s, 0
        return self._ran_s


class TimeStampWatch:
    """Counts stamps that do not advance, however many come at a time.

    A stamp advances if it is later than every stamp before it, or than those since the clock was
    set back, see `RowClock`. The others stay in the log: an online step skips them.
    """

    def __init__(self) -> None:
        self._rows = self._advanced = 0
        self._clock = RowClock()
        self._latest_s = -np.inf
        self._faults: dict[str, tuple[int, str]] = {}

    def update(self, t_s: FloatArray) -> FloatArray:
        """Take finite time stamps in s, shape (n,); return what `RowClock.update` does."""
        dt_s = self._clock.update(t_s)
        advances = dt_s > 0.0
        self._advanced += int(np.count_nonzero(advances))
        # The latest stamp that advanced before each row.
        stamps = np.concatenate(([self._latest_s], t_s))
        which = np.maximum.accumulate(np.where(advances, np.arange(1, len(t_s) + 1), 0))
        before_s = stamps[np.concatenate(([0], which))]
        self._latest_s, before_s = float(before_s[-1]), before_s[:-1]
        is_back = t_s < before_s
        for what, rows in (
            ("clock set back, from where it counts anew", advances & is_back),
            ("stamps running backward", ~advances & is_back),
            ("stamps repeated", dt_s == 0.0),
        ):
            count, first = self._faults.get(what, (0, ""))
            if rows.any() and not count:
                row = int(np.argmax(rows))
                first = f"row {self._rows + row + 1}, {t_s[row]:.9g} s after {before_s[row]:.9g} s"
            self._faults[what] = count + int(np.count_nonzero(rows)), first
        self._rows += t_s.size
        return dt_s

    def warnings(self) -> tuple[str, ...]:
        """Report stamps that do not advance; refuse a log in which none does.

        Returns:
            One warning for each kind of fault, with how many and where the first stands (rows
            count from 1).

        Raises:
            LogError: fewer than two stamps advance, so that no time step can be formed.
        """
        # The first of all counts as one that advances.
        if self._advanced < 2:
            raise LogError(
                f"no usable time: of {self._rows} samples none is later than the first; "
                "at least two time stamps must advance"
            )
        return tuple(
            f"time: {what}: {count} (first: {first})"
            for what, (count, first) in self._faults.items()
            if count
        )
