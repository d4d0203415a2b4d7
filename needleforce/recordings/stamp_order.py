"""Rows in the order of time: bad stamps are left out, late rows put where they belong.

A stamp is bad if those around it contradict it: they go on as if the row had another
one. A clock that was set, or a recording that paused, is something else: there the
stamps that follow agree with each other. Rows of a file may be written later than
others of the same clock; they fill the places that others left free. Two rows for one
place are no late rows: the clock was set back, which `RowClock` follows. Stamps with
too few digits are equal in many rows; these are numbered, see
`_spread_rounded`. `rows_in_order` does all of it.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from foundation.arrays import Array
from needleforce.recordings.errors import FaultCounts
from needleforce.recordings.time_stamps import MIN_ROWS_SET_BACK, MIN_RUN_SET_BACK_S

SORTED_WITHIN_S = 1.0
"""Rows of a file are sorted if they come no later than this after newer ones: so long a
recorder may hold back what it writes."""

STEP_ROWS = 200
"""The usual time step is that of so many first rows."""

MAX_NAMED_ROWS = 3
"""Rows with a bad stamp that are named one by one; the others are counted."""

Rows = dict[str, Array]
"""Consecutive rows of a log by channel, with their time `t_s` and number `row`."""


def _part(rows: Mapping[str, Array], chosen: NDArray | slice) -> Rows:
    """Return chosen rows."""
    return {key: values[chosen] for key, values in rows.items()}


def _joined(parts: Iterable[Rows]) -> Rows:
    """Return rows after each other; nothing if there is no part with rows."""
    parts = [part for part in parts if part]
    if len(parts) < 2:
        return parts[0] if parts else {}

    return {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}


class StampOrder:
    """Leaves out the rows of a log whose stamps are bad, and sorts the others.

    Rows are given and returned in pieces; what is returned does not depend on where
    they are cut. The newest rows are held back until it is clear where they belong.

    Args:
        sorted_within_s: Rows are sorted that come no later than this after newer ones;
            0 where they are to be used at once.
        report: Is told what is wrong with the stamps.

    Attributes:
        bad_count: Rows left out so far.
    """

    def __init__(
        self,
        sorted_within_s: float = SORTED_WITHIN_S,
        report: Callable[[str], None] = lambda _: None,
    ) -> None:
        self.bad_count = 0
        self._report = report
        self._window_s = sorted_within_s
        self._step_s: float | None = None
        self._jump_s = 0.0  # a longer step is looked at
        self._pause_s = 0.0  # rows alone, so far from the others, have bad stamps
        self._latest_s: float | None = None  # the latest valid stamp
        self._unjudged: Rows = {}
        self._latest: Rows = {}  # some that passed, and those that wait for later ones
        self._passed_count = 0  # of these
        self._held: Rows = {}  # valid rows, which wait for late ones
        self._row_count = 0
        self._sorted_count = 0
        self._first_sorted = np.inf
        self._faults = FaultCounts()

    def add(self, rows: Rows) -> list[Rows]:
        """Take further rows; return those that are ready, in the order of time."""
        self._row_count += len(rows["t_s"])
        self._unjudged = _joined([self._unjudged, rows])
        if self._step_s is None and self._row_count < STEP_ROWS:
            return []

        return self._ready(is_last=False)

    def finish(self) -> list[Rows]:
        """Return all rows that were held back; report what only the end shows."""
        if not self._row_count:
            return []

        ready = self._ready(is_last=True)
        self._report_end()
        return ready

    def _learn_step(self, t_s: Array) -> float:
        """Learn from the first rows how long a usual time step, and a jump, is."""
        steps_s = np.diff(np.unique(t_s[:STEP_ROWS]))
        step_s = float(np.median(steps_s)) if steps_s.size else 0.0
        # In a stream whose rows are used at once a shorter jump is looked at.
        jump_s = 0.1
        max_steps_s = 20.0 * step_s  # so many are no jump, however slow the log
        if self._window_s > 0.0:
            self._window_s = max(self._window_s, max_steps_s)
            jump_s = self._window_s

        self._jump_s = max(jump_s, max_steps_s)
        self._pause_s = max(15.0, 1000.0 * step_s)
        return step_s

    def _ready(self, *, is_last: bool) -> list[Rows]:
        """Judge the rows that wait; return those that are ready."""
        if self._step_s is None:
            self._step_s = self._learn_step(self._unjudged["t_s"])

        ready: list[Rows] = []
        for rows, starts_anew in self._stretches(is_last=is_last):
            if starts_anew:
                ready += self._placed({}, is_last=True)

            ready += self._placed(rows, is_last=False)

        return [*ready, *self._placed({}, is_last=True)] if is_last else ready

    def _stretches(self, *, is_last: bool) -> Iterator[tuple[Rows, bool]]:
        """Yield rows with valid stamps, as far as it is clear which these are.

        The truth value says whether they are on another stretch of the clock than those
        before, after a pause or because it was set.
        """
        rows = self._unjudged
        t_s = rows["t_s"]
        jumps = np.flatnonzero(np.abs(np.diff(t_s)) > self._jump_s)
        start = 0
        while start < len(t_s):
            latest_s = self._latest_s
            starts_anew = latest_s is None or abs(t_s[start] - latest_s) > self._jump_s
            if starts_anew:
                is_bad = _judge(
                    t_s[start:], latest_s, self._jump_s, self._pause_s, is_last
                )
                if is_bad is None:
                    break
            else:
                jump = np.searchsorted(jumps, start)
                end = int(jumps[jump]) + 1 if jump < len(jumps) else len(t_s)
                is_bad = np.zeros(end - start, dtype=np.bool_)

            judged = _part(rows, slice(start, start + len(is_bad)))
            start += len(is_bad)
            if is_bad.any():
                next_s = t_s[start : start + 1].tolist()
                self._name_bad(judged, is_bad, latest_s, next_s)
            if not is_bad.all():
                row = int(np.argmin(is_bad))
                after_s = float(judged["t_s"][row])
                step_s = 0.0 if latest_s is None else after_s - latest_s
                if starts_anew and step_s > self._pause_s:
                    self._faults.note(
                        "time: long steps ahead, where the recording paused or its "
                        "clock was set",
                        f"row {judged['row'][row]:.0f}, {after_s:.13g} s after "
                        f"{latest_s:.13g} s",
                    )

                good = _part(judged, ~is_bad)
                self._latest_s = float(good["t_s"][-1])
                yield good, starts_anew and latest_s is not None

        self._unjudged = _part(rows, slice(start, None))

    def _name_bad(
        self,
        rows: Rows,
        is_bad: NDArray[np.bool_],
        latest_s: float | None,
        next_s: Sequence[float],
    ) -> None:
        """Report rows with a bad stamp, by name as long as they are few.

        Args:
            rows: With the rows around them.
            is_bad: Which these are.
            latest_s: The valid stamp before the rows; None before the first of all.
            next_s: The stamp after the rows, if there is one.
        """
        earlier_s = [] if latest_s is None else [latest_s]
        for row in np.flatnonzero(is_bad).tolist():
            self.bad_count += 1
            if self.bad_count > MAX_NAMED_ROWS:
                self.bad_count += int(np.count_nonzero(is_bad[row + 1 :]))
                return

            before_s = [*earlier_s, *rows["t_s"][:row][~is_bad[:row]]][-1:]
            after_s = [*rows["t_s"][row:][~is_bad[row:]], *next_s][:1]
            relation = "between" if after_s else "after"
            if not before_s:
                relation = "before"
            around = " and ".join(f"{stamp_s:.13g} s" for stamp_s in before_s + after_s)
            self._report(
                f"row {rows['row'][row]:.0f} has a bad time stamp and is left out: "
                f"{rows['t_s'][row]:.13g} s, {relation} {around}"
            )

    def _passed(self, rows: Rows, *, is_last: bool) -> Rows:
        """Leave out single rows whose stamp is near, but whose own place is free.

        The last rows wait for those after them, unless they are the last of a clock.
        """
        margin = 3  # rows before and after a row that say where its place is
        rows = _joined([self._latest, rows])
        if not rows:
            return {}

        t_s = rows["t_s"]
        is_bad = np.zeros(len(t_s), dtype=np.bool_)
        if len(t_s) > 2 * margin and self._step_s:
            is_bad[margin:-margin] = _displaced(t_s, self._step_s, margin)

        first = self._passed_count
        end = len(t_s) if is_last else max(len(t_s) - margin, first)
        self._name_bad(rows, is_bad, None, ())
        kept_from = len(t_s) if is_last else max(end - margin, 0)
        self._latest = {} if is_last else _part(rows, slice(kept_from, None))
        self._passed_count = end - kept_from
        return _part(rows, first + np.flatnonzero(~is_bad[first:end]))

    def _placed(self, rows: Rows, *, is_last: bool) -> list[Rows]:
        """Take further valid rows, as the file has them; return those that are ready.

        Args:
            rows: That follow those held.
            is_last: Whether they are the last of a clock; none is held any more.
        """
        if self._window_s <= 0.0:
            return [rows] if rows else []

        held = _joined([self._held, self._passed(rows, is_last=is_last)])
        self._held = {}
        ready: list[Rows] = []
        while held and (row := _find_set_back(held["t_s"], self._step_s)) is not None:
            ready += self._sorted(_part(held, slice(0, row)), is_last=True)
            held = _part(held, slice(row, None))

        return [*ready, *self._sorted(held, is_last=is_last)]

    def _sorted(self, rows: Rows, *, is_last: bool) -> list[Rows]:
        """Return the rows that are ready, sorted, and hold the others."""
        if not rows or not len(rows["t_s"]):
            return []

        t_s = rows["t_s"]
        newest_s = np.maximum.accumulate(t_s)
        # A row that comes later than the window stays where it is.
        place_s = np.maximum(t_s, newest_s - self._window_s)
        order = np.argsort(place_s, kind="stable")
        oldest_s = np.inf if is_last else newest_s[-1] - self._window_s
        count = int(np.searchsorted(place_s[order], oldest_s, "right"))
        max_held = 1 << 18  # more rows are not held, whatever their stamps
        count = max(count, len(t_s) - max_held)
        late = order[:count][((t_s < newest_s) & (place_s == t_s))[order[:count]]]
        if late.size:
            first = float(rows["row"][late].min())
            self._first_sorted = min(self._first_sorted, first)
            self._sorted_count += late.size

        self._held = _part(rows, np.sort(order[count:]))
        return [_part(rows, order[:count])] if count else []

    def _report_end(self) -> None:
        """Report what only the whole log shows."""
        if self.bad_count > MAX_NAMED_ROWS:
            text = f"rows with a bad time stamp, left out: {self.bad_count}"
            if self.bad_count > 0.05 * self._row_count:
                text += (
                    "; so many may be rows out of order, which --sort-within SECONDS "
                    f"sorts in a wider window than {self._window_s:.3g} s"
                )

            self._report(text)

        if self._sorted_count:
            self._report(
                f"time: rows out of order, sorted within {self._window_s:.3g} s: "
                f"{self._sorted_count} of {self._row_count} (first: row "
                f"{self._first_sorted:.0f})"
            )

        for line in self._faults.lines():
            self._report(line)


def _judge(
    t_s: Array, latest_s: float | None, jump_s: float, pause_s: float, is_last: bool
) -> NDArray[np.bool_] | None:
    """Return which of the first stamps after a jump are bad; None if it is not clear.

    Args:
        t_s: All that have come, shape (n,).
        latest_s: The valid stamp before; None before the first of all.
        jump_s: A longer step is a jump.
        pause_s: A longer one is no pause of a few rows.
        is_last: Whether no more come.
    """
    # So many different stamps say what the jump was: up to four may be bad. More rows
    # with fewer different ones are not waited for.
    judged_count = 9
    max_rows = 10_000
    waiting_s = t_s[:max_rows]
    places = np.sort(np.unique(waiting_s, return_index=True)[1])
    is_enough = len(places) >= judged_count or len(waiting_s) == max_rows
    if len(places) >= judged_count:
        waiting_s = waiting_s[: places[judged_count - 1] + 1]
    if latest_s is not None:
        returns = np.abs(waiting_s - latest_s) <= jump_s
        if returns.any():
            return np.ones(int(np.argmax(returns)), dtype=np.bool_)
    if not (is_enough or is_last):
        return None
    if latest_s is not None and len(waiting_s) < 3 and not is_enough:
        return ~_follow(waiting_s, latest_s, pause_s)

    distinct_s = np.unique(waiting_s)
    middle_s = distinct_s[len(distinct_s) // 2]
    is_good = np.abs(waiting_s - middle_s) <= jump_s
    near_count = np.count_nonzero(np.abs(distinct_s - middle_s) <= jump_s)
    if 2 * near_count > len(distinct_s):
        # A slow beginning is no reason to leave a row out.
        first = int(np.argmax(is_good))
        before_s = -waiting_s[:first][::-1]
        is_good[:first] = _follow(before_s, -waiting_s[is_good].min(), pause_s)[::-1]
    else:
        is_good = _increasing(waiting_s)

    return ~is_good[: np.flatnonzero(is_good)[-1] + 1]


def _follow(stamps_s: Array, start_s: float, pause_s: float) -> NDArray[np.bool_]:
    """Return which of some stamps go on from a start, without a longer pause."""
    follows = np.zeros(len(stamps_s), dtype=np.bool_)
    for row, stamp_s in enumerate(stamps_s.tolist()):
        follows[row] = 0.0 <= stamp_s - start_s <= pause_s
        if follows[row]:
            start_s = stamp_s

    return follows


def _increasing(stamps_s: Array) -> NDArray[np.bool_]:
    """Return which stamps form the longest part that never decreases, shape (n,)."""
    lengths = np.ones(len(stamps_s), dtype=int)
    previous = np.full(len(stamps_s), -1)
    for i, stamp_s in enumerate(stamps_s.tolist()):
        fits = np.flatnonzero(stamps_s[:i] <= stamp_s)
        if fits.size:
            best = fits[np.argmax(lengths[fits])]
            lengths[i] = lengths[best] + 1
            previous[i] = best

    chosen = np.zeros(len(stamps_s), dtype=np.bool_)
    i = int(np.argmax(lengths))
    while i >= 0:
        chosen[i] = True
        i = int(previous[i])

    return chosen


def _displaced(t_s: Array, step_s: float, margin: int) -> NDArray[np.bool_]:
    """Return which stamps are not where the order of the rows has a free place.

    The rows before and after follow each other evenly, and leave one place free.

    Args:
        t_s: Stamps in the order of the file, shape (n,).
        step_s: The usual time step.
        margin: Rows on each side that are looked at.

    Returns:
        For the rows with so many on each side; shape (n - 2 margin,).
    """
    windows_s = np.lib.stride_tricks.sliding_window_view(t_s, 2 * margin + 1)
    others_s = np.delete(windows_s, margin, axis=1)
    steps_s = np.diff(others_s, axis=1)
    place_s = steps_s[:, margin - 1].copy()
    steps_s[:, margin - 1] = step_s
    is_even = ((steps_s > 0.0) & (steps_s < 1.5 * step_s)).all(axis=1)
    is_free = (place_s > 1.5 * step_s) & (place_s < 2.5 * step_s)
    stamps_s = windows_s[:, margin]
    distance_s = np.maximum(
        stamps_s - others_s[:, margin], others_s[:, margin - 1] - stamps_s
    )
    # A row that is nearer to its place has no bad stamp.
    return is_even & is_free & (distance_s > 3.0 * step_s)


def _find_set_back(t_s: Array, step_s: float | None) -> int | None:
    """Return the first row that a clock counts after it was set back.

    That is where rows that follow each other take places that others have taken.

    Args:
        t_s: Stamps in the order of the file, shape (n,).
        step_s: The usual time step.
    """
    newest_s = np.maximum.accumulate(t_s)
    is_behind = t_s < newest_s
    if not step_s or not is_behind.any():
        return None

    is_next = np.concatenate(([False], is_behind[:-1] & (np.diff(t_s) > 0.0)))
    starts = np.flatnonzero(is_behind & ~is_next)
    runs = np.cumsum(is_behind & ~is_next)[is_behind] - 1
    lengths = np.bincount(runs, minlength=len(starts))
    ends = starts + lengths - 1
    spans_s = t_s[ends] - t_s[starts]
    is_run = (lengths >= MIN_ROWS_SET_BACK) & (spans_s >= MIN_RUN_SET_BACK_S)
    ordered_s = np.sort(t_s)
    taken = np.searchsorted(ordered_s, t_s[ends], "right") - np.searchsorted(
        ordered_s, t_s[starts], "left"
    )
    # Two runs that each take so many of the places were not written by one clock.
    min_count = 0.4 * spans_s / step_s
    is_set_back = is_run & (lengths > min_count) & (taken - lengths > min_count)
    return int(starts[np.argmax(is_set_back)]) if is_set_back.any() else None


def rows_in_order(
    parts: Iterable[Rows], order: StampOrder, report: Callable[[str], None]
) -> Iterator[Rows]:
    """Yield the rows whose place in time is known, once further rows were read.

    Args:
        parts: Consecutive rows.
        order: That leaves out rows with bad stamps, and sorts the others.
        report: Is told of stamps that are rounded.
    """
    for part in _spread_rounded(parts, report):
        yield from order.add(part)

    yield from order.finish()


def _spread_rounded(
    parts: Iterable[Rows], report: Callable[[str], None]
) -> Iterator[Rows]:
    """Number the rows between stamps that were rounded; others stay as they are.

    A stream that writes 6 digits gives a hundred rows one stamp. If most of the first
    rows share theirs, though what they hold differs, each is put evenly between its
    stamp and the next.

    Args:
        parts: Consecutive rows.
        report: Is told of it, once.
    """
    waiting: Rows = {}
    is_rounded: bool | None = None
    step_s = 0.0
    for part in parts:
        waiting = _joined([waiting, part])
        if is_rounded is None and len(waiting["t_s"]) >= STEP_ROWS:
            is_rounded = _is_rounded(waiting)
        if is_rounded is False:
            yield waiting
            waiting = {}
        elif is_rounded:
            # The first group may begin anywhere: its step is that of the second.
            changes = np.flatnonzero(np.diff(waiting["t_s"])) + 1
            if len(changes) < (2 if not step_s else 1):
                continue
            if not step_s:
                step_s = _warn_of_rounding(waiting["t_s"], changes, report)

            yield _evenly(_part(waiting, slice(0, changes[-1])), waiting, step_s)
            waiting = _part(waiting, slice(changes[-1], None))

    if waiting:
        is_rounded = _is_rounded(waiting) if is_rounded is None else is_rounded
        yield _evenly(waiting, {}, step_s) if is_rounded and step_s else waiting


def _is_rounded(rows: Rows) -> bool:
    """Return whether most rows have the stamp of the row before, but other values."""
    head = _part(rows, slice(0, STEP_ROWS))
    is_equal = np.diff(head["t_s"]) == 0.0
    differs = np.zeros(len(is_equal), dtype=np.bool_)
    for key, values in head.items():
        if key not in ("t_s", "row"):
            columns = values.reshape(len(values), -1)
            differs |= (np.abs(np.diff(columns, axis=0)) > 0.0).any(axis=1)

    return bool(np.count_nonzero(is_equal & differs) > 2 * len(is_equal) / 3)


def _warn_of_rounding(
    t_s: Array, changes: NDArray[np.intp], report: Callable[[str], None]
) -> float:
    """Say that stamps are rounded, and to what; return the time from row to row."""
    grain_s = t_s[changes[1]] - t_s[changes[0]]
    count = changes[1] - changes[0]
    report(
        f"time: stamps are rounded to {grain_s:.3g} s, about {count} rows each; the "
        f"rows between were numbered, at about {count / grain_s:.4g} Hz; if the rate "
        "is known, give it with --rate"
    )
    return float(grain_s / count)


def _evenly(rows: Rows, following: Rows, step_s: float) -> Rows:
    """Return rows of equal stamps with stamps evenly between these and the next.

    Args:
        rows: Of whole groups with equal stamps.
        following: With the rows after them; nothing after the last.
        step_s: From row to row, where the next stamp does not say it.
    """
    t_s = rows["t_s"]
    starts = np.concatenate(([0], np.flatnonzero(np.diff(t_s)) + 1))
    counts = np.diff([*starts, len(t_s)])
    next_s = t_s[starts[-1]] + counts[-1] * step_s
    if following:
        next_s = following["t_s"][len(t_s)]

    steps_s = np.diff([*t_s[starts], next_s]) / counts
    is_first = rows["row"][0] == 1.0
    if is_first and len(steps_s) > 1:
        steps_s[0] = step_s

    places = np.arange(len(t_s)) - np.repeat(starts, counts)
    evenly_s = t_s + places * np.repeat(steps_s, counts)
    if is_first and len(steps_s) > 1:
        back = counts[0] - np.arange(counts[0])
        evenly_s[: counts[0]] = t_s[starts[1]] - back * step_s

    return {**rows, "t_s": evenly_s}
