"""Time stamps: nanoseconds and seconds, interpolation, and the time between rows.

A recorder stamps with whole nanoseconds since its clock began, often since 1970. As
seconds in float64 such stamps would be rounded to 0.2 µs; then seconds are counted
from the first stamp instead, see `start_of_clock`.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import median_filter

from foundation.arrays import Array
from needleforce.recordings.errors import LogError

NS_PER_S = 1_000_000_000


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


def rows_in_order(
    t_s: Array, values: Array, sorted_within_s: float
) -> tuple[NDArray[np.intp], Array, list[str]]:
    """Return the rows of a log in the order of time, and what was odd.

    Rows without a stamp, with one that those around contradict, or with that of an
    earlier row are left out; late rows are sorted. Stamps that most rows share, as of a
    clock with few digits, are spread evenly.

    Args:
        t_s: Stamps in the order of the file, shape (n,).
        values: A channel, shape (n,) or (n, k): rows that repeat it are no new samples.
        sorted_within_s: Rows that come later than this are left out.

    Returns:
        Indices of the rows, shape (m,), their stamps, shape (m,), and notes.

    Raises:
        LogError: Fewer than two stamps advance.
    """
    notes: list[str] = []
    rows = np.flatnonzero(np.isfinite(t_s))
    if missing := len(t_s) - len(rows):
        first = int(np.argmin(np.isfinite(t_s)))
        notes.append(
            f"time: rows without a stamp, left out: {missing} (first: row {first + 1})"
        )

    stamps_s = t_s[rows]
    step_s = float(np.median(np.diff(stamps_s[:200]))) if len(rows) > 1 else 0.0
    if len(rows) > 8 and step_s > 0.0:
        around_s = median_filter(stamps_s, 9, mode="nearest")
        is_bad = np.abs(stamps_s - around_s) > max(sorted_within_s, 20.0 * step_s)
        if is_bad.any():
            first = rows[np.argmax(is_bad)]
            notes.append(
                f"rows with a bad time stamp, left out: {np.count_nonzero(is_bad)} "
                f"(first: row {first + 1}, {t_s[first]:.13g} s)"
            )
            rows, stamps_s = rows[~is_bad], stamps_s[~is_bad]

    stamps_s, set_back = _continue_clock(rows, stamps_s, step_s)
    notes += set_back
    lateness_s = np.fmax.accumulate(stamps_s) - stamps_s
    is_late = (lateness_s > 0.0) & (lateness_s <= sorted_within_s)
    if is_late.any():
        kept = lateness_s <= sorted_within_s
        order = np.argsort(stamps_s[kept], kind="stable")
        rows, stamps_s = rows[kept][order], stamps_s[kept][order]
        notes.append(f"time: rows out of order, sorted: {np.count_nonzero(is_late)}")

    is_repeated = np.diff(stamps_s, prepend=-np.inf) <= 0.0
    changed = (
        np.diff(values[rows], axis=0).reshape(max(len(rows) - 1, 0), -1).any(axis=1)
    )
    if (
        len(rows) > 2
        and np.count_nonzero(is_repeated[1:] & changed) > 2 * len(rows) / 3
    ):
        starts = np.flatnonzero(~is_repeated)
        stamps_s = np.interp(np.arange(len(rows)), starts, stamps_s[starts])
        keep = np.arange(len(rows)) <= starts[-1]
        notes.append("time: stamps are rounded; rows between were spread evenly")
    else:
        keep = stamps_s > np.concatenate(
            ([-np.inf], np.maximum.accumulate(stamps_s)[:-1])
        )
        if not keep.all():
            count = np.count_nonzero(~keep)
            notes.append(f"time: rows whose stamps do not advance, left out: {count}")

    if np.count_nonzero(keep) < 2:
        raise LogError(
            f"no usable time: of {len(t_s)} rows at least two must have stamps that "
            "advance",
            "Give time stamps that increase; name their unit in the `mapping`, or give "
            "`rate_hz` instead.",
        )

    return rows[keep], stamps_s[keep], notes


def _continue_clock(
    rows: NDArray[np.intp], stamps_s: Array, step_s: float
) -> tuple[Array, list[str]]:
    """Return stamps that run on where the clock was set back, and a note on each.

    Args:
        rows: Indices of the rows in the log, shape (m,).
        stamps_s: Their stamps, shape (m,).
        step_s: Usual time from one to the next.
    """
    notes: list[str] = []
    for start in np.flatnonzero(np.diff(stamps_s) < 0.0).tolist():
        # Rows behind the latest that follow each other for so long were not late.
        is_behind = stamps_s[start + 1 :] < stamps_s[: start + 1].max()
        is_next = np.diff(stamps_s[start + 1 :], prepend=-np.inf) > 0.0
        run = stamps_s[start + 1 :][np.logical_and.accumulate(is_behind & is_next)]
        if len(run) >= 3 and run[-1] - run[0] >= 0.1:
            notes.append(
                f"time: clock set back at row {rows[start + 1] + 1}, {run[0]:.9g} s "
                f"after {stamps_s[start]:.9g} s; it was continued from there"
            )
            stamps_s = stamps_s.copy()
            stamps_s[start + 1 :] += stamps_s[start] - run[0] + step_s

    return stamps_s, notes
