"""Time stamps: nanoseconds and seconds, interpolation, and the time between rows.

A recorder stamps with whole nanoseconds since its clock began, often since 1970. As
seconds in float64 such stamps would be rounded to 0.2 µs; then seconds are counted
from the first stamp instead, see `start_of_clock`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import median_filter

from foundation.arrays import Array
from needleforce.recordings.errors import LogError
from needleforce.recordings.table import Table

NS_PER_S = 1_000_000_000


def start_of_clock(stamps_ns: NDArray[np.int64]) -> int:
    """Return the instant from which seconds are counted so that nothing is lost.

    It is 0, so that the file's clock is kept, or the first stamp if that clock began
    long ago: the first one that is near most of the others, shape (n,), n > 0, since
    the very first may never have been set.
    """
    max_exact_ns = 1 << 52  # up to here, 52 days, a double of seconds resolves ns
    head_ns = stamps_ns[:200]
    distinct_ns = np.unique(head_ns)
    middle_ns = int(distinct_ns[len(distinct_ns) // 2])
    # What is an hour from the others is not of their clock. Python's integers do not
    # overflow.
    hour_ns = 3600 * NS_PER_S
    first_ns = next(ns for ns in head_ns.tolist() if abs(ns - middle_ns) <= hour_ns)
    return 0 if abs(first_ns) < max_exact_ns // 2 else first_ns


def to_seconds(stamps_ns: NDArray[np.int64], start_ns: int) -> Array:
    """Return stamps in seconds since `start_ns`, as the nearest doubles.

    `to_nanoseconds` gives the same stamps back.
    """
    return (stamps_ns - np.int64(start_ns)) / NS_PER_S


def to_nanoseconds(t_s: ArrayLike, start_ns: int) -> NDArray[np.int64]:
    """Return finite seconds since `start_ns` as stamps, to the nearest nanosecond."""
    counted = np.rint(np.asarray(t_s, dtype=np.float64) * NS_PER_S).astype(np.int64)
    return counted + np.int64(start_ns)


def with_own_clocks(table: Table, found: Mapping[str, Sequence[str]]) -> Table:
    """Return a table whose channels have clocks, where rows hold one or the other.

    Rows may have a stamp and either a force or a pose. Then a row without a value is no
    sample of a channel, rather than one that is missing.

    Args:
        table: With the time stamp of each row as `t_s`.
        found: Columns by channel.

    Returns:
        The table itself unless two channels share less than half of their samples.
    """
    t_s = table.columns["t_s"]
    samples: dict[str, NDArray[np.bool_]] = {}
    for name, columns in found.items():
        rows = np.column_stack([t_s, *map(table.values, columns)])
        samples[name] = np.isfinite(rows.sum(axis=1))

    shared = np.logical_and.reduce([*samples.values()])
    fewest = min(map(np.count_nonzero, samples.values()))
    if 2 * np.count_nonzero(shared) >= fewest:
        return table

    columns = {
        name: (channel, table.values(name)[samples[channel]])
        for channel, names in found.items()
        for name in names
    }
    return replace(
        table,
        columns={name: values for name, (_, values) in columns.items()},
        clocks={name: channel for name, (channel, _) in columns.items()},
        stamps_ns={
            channel: to_nanoseconds(t_s[rows], table.start_ns)
            for channel, rows in samples.items()
        },
    )


def aligned(table: Table, reference: str) -> Table:
    """Return a table whose columns all have a value at the stamps of one clock.

    Those of other clocks are interpolated, not across gaps of more than 0.1 s and five
    of their periods.

    Args:
        table: Whose columns have clocks.
        reference: The clock.
    """
    at_ns = table.stamps_ns[reference]
    columns: dict[str, np.ndarray] = {}
    notes: dict[str, None] = {}
    for name, values in table.columns.items():
        clock = table.clocks[name]
        known_ns = table.stamps_ns[clock]
        columns[name] = values
        if clock != reference:
            columns[name] = interpolate(at_ns, known_ns, values)
            if abs(len(known_ns) - len(at_ns)) > 1:
                notes[f"{clock} was interpolated to the stamps of {reference}"] = None

    start_ns = start_of_clock(at_ns)
    return replace(
        table,
        columns={"t_s": to_seconds(at_ns, start_ns), **columns},
        start_ns=start_ns,
        seconds=frozenset({"t_s"}),
        clocks={},
        warnings=(*table.warnings, *notes),
    )


def interpolate(
    at_ns: NDArray[np.int64], stamps_ns: NDArray[np.int64], values: Array
) -> Array:
    """Interpolate values linearly; where stamps agree, they stay as they are.

    Args:
        at_ns: Stamps at which values are asked for, shape (n,).
        stamps_ns: Stamps at which they are known, shape (m,), in any order.
        values: The known values, shape (m,) or (m, k).

    Returns:
        Values, shape (n,) or (n, k); NaN outside the known stamps and in gaps of more
        than 0.1 s and five periods.
    """
    if not stamps_ns.size:
        return np.full((at_ns.size, *values.shape[1:]), np.nan)

    order = np.argsort(stamps_ns, kind="stable")
    known_ns = stamps_ns[order]
    limit_ns = max(0.1 * NS_PER_S, 5.0 * np.ptp(known_ns) / max(len(known_ns) - 1, 1))
    below = np.clip(np.searchsorted(known_ns, at_ns, side="right") - 1, 0, None)
    above = np.clip(below + 1, None, known_ns.size - 1)
    is_gap = known_ns[above] - known_ns[below] > limit_ns
    is_gap &= known_ns[below] != at_ns
    # float64 holds differences of stamps, not stamps.
    elapsed_ns = np.where(is_gap, -1, at_ns - known_ns[0])
    rows = [
        np.interp(elapsed_ns, known_ns - known_ns[0], column, np.nan, np.nan)
        for column in np.atleast_2d(values[order].T)
    ]
    return np.stack(rows, axis=1).reshape(len(at_ns), *values.shape[1:])


SORTED_WITHIN_S = 1.0
"""Rows of a file are sorted if they come no later than this after newer ones."""


class OrderedRows(NamedTuple):
    """The rows of a log in the order of time.

    Attributes:
        rows: Their indices in the file, shape (m,).
        t_s: Their stamps, shape (m,).
        notes: What was odd.
    """

    rows: NDArray[np.intp]
    t_s: Array
    notes: list[str]


def rows_in_order(t_s: Array, values: Array) -> OrderedRows:
    """Return the rows of a log in the order of time, and what was odd.

    Rows without a stamp, with one that those around contradict, or with that of an
    earlier row are left out; late rows are sorted.

    Args:
        t_s: Stamps in the order of the file, shape (n,).
        values: A channel, shape (n,) or (n, k): rows that repeat it are no new samples.

    Raises:
        LogError: Fewer than two stamps advance, the clock was set back, or samples
            share stamps or came in bursts, so that stamps do not tell their times.
    """
    rows = np.flatnonzero(np.isfinite(t_s))
    is_bad = _is_contradicted(t_s[rows])
    left_out = {
        "no": np.flatnonzero(~np.isfinite(t_s)),
        "a contradicted": rows[is_bad],
    }
    notes = [
        f"time: rows with {what} stamp, left out: {len(which)} (first: row "
        f"{which[0] + 1}, {t_s[which[0]]:.13g} s)"
        for what, which in left_out.items()
        if len(which)
    ]
    rows = rows[~is_bad]
    lateness_s = np.maximum.accumulate(t_s[rows]) - t_s[rows]
    if lateness_s.any():
        if lateness_s.max() > SORTED_WITHIN_S:
            row = rows[np.argmax(lateness_s > SORTED_WITHIN_S)]
            raise LogError(
                f"time: the clock was set back at row {row + 1}, by up to "
                f"{lateness_s.max():.6g} s",
                "Cut the file there and read its parts, or give the sample rate "
                "(`rate_hz`, --rate) if no time is missing.",
            )

        notes.append(f"time: rows out of order, sorted: {np.count_nonzero(lateness_s)}")
        rows = rows[np.argsort(t_s[rows], kind="stable")]

    stamps_s = t_s[rows]
    _refuse_shared_stamps(stamps_s, values[rows])
    # Late rows are sorted by now: none is before the one above it.
    keep = np.append(True, np.diff(stamps_s) > 0.0)[: len(rows)]
    if not keep.all():
        count = np.count_nonzero(~keep)
        notes.append(f"time: rows whose stamps do not advance, left out: {count}")

    rows = rows[keep]
    if len(rows) < 2:
        raise LogError(
            f"no usable time: of {len(t_s)} rows at least two must have stamps that "
            "advance",
            "Give time stamps that increase; name their unit in the `mapping`, or give "
            "`rate_hz` instead.",
        )

    _refuse_bursts(t_s[rows])
    return OrderedRows(rows, t_s[rows], notes)


def _refuse_shared_stamps(stamps_s: Array, values: Array) -> None:
    """Raise `LogError` if samples share stamps; values that repeat are no samples.

    Args:
        stamps_s: Shape (m,).
        values: A channel, shape (m,) or (m, k).
    """
    is_new = np.diff(stamps_s) > 0.0
    is_changed = values[1:] != values[:-1]
    is_sample = is_changed.any(axis=tuple(range(1, values.ndim)))
    if np.count_nonzero(~is_new & is_sample) > len(stamps_s) / 3:
        starts = np.flatnonzero(is_new) + 1
        raise _no_times("samples share stamps", stamps_s, starts)


def _refuse_bursts(stamps_s: Array) -> None:
    """Raise `LogError` for stamps in bursts, shape (m,), m > 1."""
    steps_s = np.diff(stamps_s)
    is_pause = steps_s > 5.0 * np.median(steps_s)
    starts = np.flatnonzero(is_pause) + 1
    is_mostly_paused = steps_s[is_pause].sum() > 0.5 * steps_s.sum()
    if len(starts) >= 10 and is_mostly_paused and np.median(np.diff(starts)) >= 2:
        raise _no_times("stamps come in bursts", stamps_s, starts)


def _no_times(fault: str, stamps_s: Array, starts: NDArray[np.intp]) -> LogError:
    """Return the error of stamps that say only when each group of samples came.

    Args:
        fault: What is wrong.
        stamps_s: Shape (m,).
        starts: The first row of each group but the first one.
    """
    rate = "HZ"
    if len(starts) > 1:
        first, *_, last = starts
        rate = f"{(last - first) / (stamps_s[last] - stamps_s[first]):.4g}"

    return LogError(
        f"time: {fault}, so they do not tell when a sample was measured",
        f"If the samples are even, number them: --rate {rate}, `rate_hz` in the "
        "mapping; a stamp in two columns is --time sec:s+nanosec:ns; else write stamps "
        "of the source with all digits.",
    )


def _is_contradicted(t_s: Array) -> NDArray[np.bool_]:
    """Return which finite stamps, shape (n,), those around contradict."""
    step_s = float(np.median(np.diff(t_s[:200]))) if len(t_s) > 8 else 0.0
    if step_s <= 0.0:
        return np.zeros(len(t_s), dtype=np.bool_)

    around_s = median_filter(t_s, 9, mode="nearest")
    return np.abs(t_s - around_s) > max(SORTED_WITHIN_S, 20.0 * step_s)
