"""Time stamps: nanoseconds and seconds, interpolation, and the time between rows.

A recorder stamps with whole nanoseconds since its clock began, often since 1970. As
seconds in float64 such stamps would be rounded to 0.2 µs; then seconds are counted
from the first stamp instead, see `start_of_clock`.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foundation.arrays import Array
from needleforce.recordings.errors import FaultCounts, LogError

NS_PER_S = 1_000_000_000

MIN_RUN_SET_BACK_S = 0.1
"""A clock counts as set back when the rows behind the latest span so much time."""

MIN_ROWS_SET_BACK = 3
"""A clock counts as set back when so many rows follow each other behind the latest."""

_SET_BACK = "time: clock set back, from where it counts anew"
_BACKWARD = "time: stamps running backward"
_REPEATED = "time: stamps repeated"


def start_of_clock(first_ns: int) -> int:
    """Return the instant from which seconds are counted so that nothing is lost.

    It is 0, so that the file's clock is kept, or the first stamp if that clock began
    long ago.
    """
    max_exact_ns = 1 << 52  # up to here, 52 days, a double of seconds resolves ns
    return 0 if abs(first_ns) < max_exact_ns // 2 else first_ns


def first_valid_stamp(stamps_ns: NDArray[np.int64]) -> int:
    """Return the first stamp that is near most of the others, shape (n,), n > 0.

    The very first may be one that was never set.
    """
    head_ns = stamps_ns[:200]
    distinct_ns = np.unique(head_ns)
    middle_ns = int(distinct_ns[len(distinct_ns) // 2])
    # What is an hour from the others is not of their clock. Python's integers do not
    # overflow.
    hour_ns = 3600 * NS_PER_S
    near = (ns for ns in head_ns.tolist() if abs(ns - middle_ns) <= hour_ns)
    return next(near)


def to_seconds(stamps_ns: NDArray[np.int64], start_ns: int) -> Array:
    """Return stamps in seconds since `start_ns`, as the nearest doubles.

    `to_nanoseconds` gives the same stamps back.
    """
    return (stamps_ns - np.int64(start_ns)) / NS_PER_S


def to_nanoseconds(t_s: ArrayLike, start_ns: int) -> NDArray[np.int64]:
    """Return finite seconds since `start_ns` as stamps, to the nearest nanosecond."""
    counted = np.rint(np.asarray(t_s, dtype=np.float64) * NS_PER_S).astype(np.int64)
    return counted + np.int64(start_ns)


def exceed_float64(values: np.ndarray) -> bool:
    """Return whether float64 rounds one of some whole numbers, and int64 does not."""
    # Not abs, which overflows for the least integer; a NaN is not larger than anything.
    # float64 holds every whole number up to the first, int64 none from the second on.
    max_exact = 1 << 53
    int64_end = 1 << 63
    is_large = (values > max_exact) & (values < int64_end)
    return bool(is_large.any())


def interpolate(
    at_ns: NDArray[np.int64],
    stamps_ns: NDArray[np.int64],
    values: Array,
    limit_ns: float,
) -> Array:
    """Interpolate values linearly; where stamps agree, they stay as they are.

    Args:
        at_ns: Stamps at which values are asked for, shape (n,).
        stamps_ns: Stamps at which they are known, shape (m,), in any order.
        values: The known values, shape (m, k).
        limit_ns: Gaps between known stamps that are longer are not bridged.

    Returns:
        Values, shape (n, k); NaN within longer gaps and outside the known stamps.
    """
    if not stamps_ns.size:
        return np.full((at_ns.size, values.shape[1]), np.nan)

    order = np.argsort(stamps_ns, kind="stable")
    stamps_ns = stamps_ns[order]
    values = values[order]

    below = np.clip(np.searchsorted(stamps_ns, at_ns, side="right") - 1, 0, None)
    above = np.clip(below + 1, None, stamps_ns.size - 1)
    is_gap = stamps_ns[above] - stamps_ns[below] > limit_ns
    is_unknown = is_gap & (stamps_ns[below] != at_ns)

    # float64 holds differences of stamps, not stamps.
    elapsed_ns = at_ns - stamps_ns[0]
    known_ns = stamps_ns - stamps_ns[0]
    rows = np.stack(
        [
            np.interp(elapsed_ns, known_ns, column, left=np.nan, right=np.nan)
            for column in values.T
        ],
        axis=1,
    )
    rows[is_unknown] = np.nan
    return rows


class RowClock:
    """The time from row to row, where rows may come late or the clock be set back.

    A row that is not later than those before is no step in time. If few rows are so,
    they came late. If several follow each other behind the latest stamp, later than
    each other, and span some time, the clock was set back: from there on it counts
    anew. Rows that do not advance stay in a log; an online step skips them.
    """

    def __init__(self) -> None:
        self._latest_s = -math.inf
        self._behind_s: list[float] = []
        """Stamps before the latest, each later than the one before."""
        self._row_count = 0
        self._advance_count = 0
        # Reported in this order.
        self._faults = FaultCounts()
        self._faults.note(_SET_BACK, "", 0)
        self._faults.note(_BACKWARD, "", 0)

    def update(self, t_s: Array, rows: Array | None = None) -> Array:
        """Return the time since the latest row that advanced, for every row.

        Args:
            t_s: Time stamps, shape (n,).
            rows: Their numbers in the file, for messages, shape (n,); None to count
                from 1.

        Returns:
            Time in s, shape (n,): not positive for a row that does not advance, inf for
            the first of all. The row at which a set clock is recognised advances by the
            time for which that clock has run.
        """
        if rows is None:
            rows = self._row_count + np.arange(1.0, t_s.size + 1.0)

        self._row_count += t_s.size
        dt_s = np.diff(t_s, prepend=self._latest_s)
        if not dt_s.any():
            if t_s.size:
                stamp = f"{self._latest_s:.9g} s"
                place = f"row {rows[0]:.0f}, {stamp} after {stamp}"
                self._faults.note(_REPEATED, place, t_s.size)

            return dt_s
        if not (dt_s > 0.0).all():
            numbered = zip(t_s.tolist(), rows.tolist(), strict=True)
            return np.array(
                [self._update_one(*stamp_and_row) for stamp_and_row in numbered]
            )

        self._latest_s = float(t_s[-1])
        self._behind_s.clear()
        self._advance_count += t_s.size
        return dt_s

    def _update_one(self, stamp_s: float, row: float) -> float:
        """Return the time since the latest row that advanced, for the next row.

        Args:
            stamp_s: Its time stamp.
            row: Its number in the file.
        """
        latest_s = self._latest_s
        dt_s = stamp_s - latest_s
        fault = _REPEATED if dt_s == 0.0 else _BACKWARD
        if dt_s < 0.0:
            run_s = self._run_behind_latest(stamp_s)
            if run_s is not None:
                fault = _SET_BACK
                dt_s = run_s

        if dt_s > 0.0:
            self._latest_s = stamp_s
            self._advance_count += 1
            self._behind_s.clear()

        if stamp_s <= latest_s:
            place = f"row {row:.0f}, {stamp_s:.9g} s after {latest_s:.9g} s"
            self._faults.note(fault, place)

        return dt_s

    def _run_behind_latest(self, stamp_s: float) -> float | None:
        """Return for how long a clock that was set back has run; None if it was not."""
        if self._behind_s and stamp_s < self._behind_s[-1]:
            self._behind_s.clear()
        if not self._behind_s or stamp_s > self._behind_s[-1]:
            self._behind_s.append(stamp_s)

        run_s = stamp_s - self._behind_s[0]
        is_set = len(self._behind_s) >= MIN_ROWS_SET_BACK
        return run_s if is_set and run_s >= MIN_RUN_SET_BACK_S else None

    def warnings(self) -> tuple[str, ...]:
        """Report stamps that do not advance, by kind.

        Raises:
            LogError: Fewer than two rows advance; the first of all counts as one.
        """
        if self._advance_count < 2:
            raise LogError(
                f"no usable time: of {self._row_count} samples none is later than the "
                "first; at least two time stamps must advance",
                "Give time stamps that increase; name their unit in the "
                "`mapping`, or give `rate_hz` instead.",
            )

        return self._faults.lines()
