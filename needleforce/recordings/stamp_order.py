"""Rows in the order of time: bad stamps are left out, late rows put where they belong.

A stamp is bad if those around it contradict it: they go on as if the row had another
one. A clock that was set, or a recording that paused, is something else: there the
stamps that follow agree with each other. Rows of a file may be written later than
others of the same clock; they fill the places that others left free. Two rows for one
place are no late rows: the clock was set back, which `RowClock` follows.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.arrays import Array
from needleforce.recordings.errors import FaultCounts
from needleforce.recordings.time_stamps import MIN_ROWS_SET_BACK, MIN_RUN_SET_BACK_S

SORTED_WITHIN_S = 1.0
"""Rows of a file are sorted if they come no later than this after newer ones: so long a
recorder may hold back what it writes."""

LIVE_JUMP_S = 0.1
"""A longer step of time in a stream whose rows are used at once is looked at."""

JUMP_STEPS = 20.0
"""So many usual time steps are no jump, however slow the log."""

PAUSE_S = 15.0
"""A row alone, so far from all others, belongs to none of them: it is a bad stamp."""

PAUSE_STEPS = 1000.0
"""So many usual time steps are as far, in a slow log."""

JUDGED_STAMPS = 9
"""So many different stamps after a jump say what it was: up to four may be bad."""

MAX_JUDGED_ROWS = 10_000
"""More rows with few different stamps are not waited for."""

MIN_TRAILING_ROWS = 3
"""So many rows at the end, after a pause, are no bad stamps."""

MAX_HELD_ROWS = 1 << 18
"""More rows are not held back to be sorted, whatever their stamps."""

STEP_ROWS = 200
"""The usual time step is that of so many first rows."""

MIN_OCCUPANCY = 0.4
"""Two runs of rows that each take such a fraction of the places in a span of time were
not written by one clock."""

MIN_DISPLACED_STEPS = 3.0
"""A row that is nearer to its place has no bad stamp."""

DISPLACED_MARGIN = 3
"""So many rows before and after a row say where its place is."""

FREE_PLACE_STEPS = 1.5
"""Between two rows that are farther apart there is a free place."""

MAX_FREE_PLACE_STEPS = 2.5
"""Between two rows that are farther apart more than one row is missing."""

MAX_NAMED_ROWS = 3
"""Rows with a bad stamp that are named one by one; the others are counted."""

MIN_UNSORTED_RATIO = 0.05
"""If more of the rows have bad stamps, it is rather their order that is not right."""

Rows = dict[str, Array]
"""Consecutive rows of a log by channel, with their time `t_s` and number `row`."""


def _part(rows: Mapping[str, Array], chosen: NDArray) -> Rows:
    """Return chosen rows, by index or by truth values."""
    return {key: values[chosen] for key, values in rows.items()}


def _joined(parts: list[Rows]) -> Rows:
    """Return rows after each other."""
    if len(parts) == 1:
        return parts[0]
    return {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}


class StampVerdict(NamedTuple):
    """What is known of the first n rows that wait.

    Attributes:
        is_bad: Which of them have a bad stamp, shape (n,).
        starts_anew: Whether the others are on another stretch of the clock than the
            rows before, after a pause or because it was set.
    """

    is_bad: NDArray[np.bool_]
    starts_anew: bool


@dataclass
class StampJudge:
    """Decides which stamps those around them contradict, as they come.

    Attributes:
        jump_s: A longer step is looked at.
        pause_s: A few rows alone, so far from the others, have bad stamps.
        latest_s: The latest valid stamp; None before the first.
        waiting_s: Stamps that cannot be judged yet.
    """

    jump_s: float
    pause_s: float = PAUSE_S
    latest_s: float | None = None
    waiting_s: list[float] = field(default_factory=list)
    _distinct: set[float] = field(default_factory=set)

    def add(self, stamp_s: float) -> StampVerdict | None:
        """Take the next stamp; return what is now known of those that wait, and it."""
        if self.latest_s is not None and abs(stamp_s - self.latest_s) <= self.jump_s:
            is_bad = np.ones(len(self.waiting_s) + 1, dtype=np.bool_)
            is_bad[-1] = False
            self.accept(stamp_s)
            return StampVerdict(is_bad, starts_anew=False)

        self.waiting_s.append(stamp_s)
        self._distinct.add(stamp_s)
        is_enough = len(self._distinct) >= JUDGED_STAMPS
        if is_enough or len(self.waiting_s) >= MAX_JUDGED_ROWS:
            return self._judge()

        return None

    def accept(self, latest_s: float) -> None:
        """Go on from a valid stamp; nothing waits any more."""
        self.latest_s = latest_s
        self.waiting_s.clear()
        self._distinct.clear()

    def finish(self) -> StampVerdict | None:
        """Return what is known of the first stamps that wait when no more come."""
        if not self.waiting_s:
            return None

        if self.latest_s is None or len(self.waiting_s) >= MIN_TRAILING_ROWS:
            return self._judge()

        is_good = _follow(self.waiting_s, self.latest_s, self.pause_s)
        self.accept(self.latest_s)
        return StampVerdict(~is_good, starts_anew=bool(is_good.any()))

    def _judge(self) -> StampVerdict:
        """Judge the stamps up to the last of the majority; those behind it wait on."""
        stamps_s = np.array(self.waiting_s)
        distinct_s = np.array(sorted(self._distinct))
        middle_s = distinct_s[len(distinct_s) // 2]
        near_count = np.count_nonzero(np.abs(distinct_s - middle_s) <= self.jump_s)
        if 2 * near_count > len(distinct_s):
            is_good = np.abs(stamps_s - middle_s) <= self.jump_s
            # A slow beginning is no reason to leave a row out.
            first = int(np.argmax(is_good))
            before_s = (-stamps_s[:first][::-1]).tolist()
            first_s = float(stamps_s[is_good].min())
            is_good[:first] = _follow(before_s, -first_s, self.pause_s)[::-1]
        else:
            is_good = _increasing(stamps_s)

        judged_count = int(np.flatnonzero(is_good)[-1]) + 1
        left_s = self.waiting_s[judged_count:]
        self.accept(float(stamps_s[judged_count - 1]))
        self.waiting_s += left_s
        self._distinct |= set(left_s)
        return StampVerdict(~is_good[:judged_count], starts_anew=True)


def _follow(stamps_s: list[float], start_s: float, pause_s: float) -> NDArray[np.bool_]:
    """Return which of some stamps go on from a start, without a longer pause."""
    follows: list[bool] = []
    for stamp_s in stamps_s:
        follows.append(0.0 <= stamp_s - start_s <= pause_s)
        if follows[-1]:
            start_s = stamp_s

    return np.array(follows, dtype=np.bool_)


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


class _Stretch(NamedTuple):
    """Rows with valid stamps in the order of the file.

    Attributes:
        rows: The rows.
        starts_anew: Whether they are on another stretch of the clock than those before.
    """

    rows: Rows
    starts_anew: bool


class StampOrder:
    """Leaves out the rows of a log whose stamps are bad, and sorts the others.

    Rows are given and returned in pieces; what is returned does not depend on where
    they are cut. The newest rows are held back until it is clear where they belong.

    Args:
        sorted_within_s: Rows are sorted that come no later than this after newer ones;
            0 where they are to be used at once.

    Attributes:
        bad_count: Rows left out so far.
    """

    def __init__(self, sorted_within_s: float = SORTED_WITHIN_S) -> None:
        self.bad_count = 0
        self._window_s = sorted_within_s
        self._step_s = 0.0
        self._judge: StampJudge | None = None
        self._unjudged: list[Rows] = []
        self._before_s = np.empty(0)  # valid stamps before those of the tail
        self._tail: list[Rows] = []  # the last rows of a file, and those after them
        self._held: list[Rows] = []
        self._row_count = 0
        self._sorted_count = 0
        self._first_sorted = np.inf
        self._latest_s = np.empty(0)  # the latest valid stamp, if there was one
        self._warnings: list[str] = []
        self._faults = FaultCounts()

    def take_warnings(self) -> list[str]:
        """Return what was wrong with the stamps since the last call."""
        warnings = self._warnings
        self._warnings = []
        return warnings

    def add(self, rows: Rows) -> list[Rows]:
        """Take further rows; return those that are ready, in the order of time."""
        self._row_count += len(rows["t_s"])
        self._unjudged.append(rows)
        if self._judge is None and self._row_count < STEP_ROWS:
            return []

        return self._released(self._judged_stretches())

    def finish(self) -> list[Rows]:
        """Return all rows that were held back; report what only the end shows."""
        if not self._row_count:
            return []

        stretches = [*self._judged_stretches(), *self._last_stretches()]
        ready = self._released(stretches)
        ready += self._hold(self._tail)
        self._tail = []
        ready += self._release_all()
        self._report_end()
        return ready

    def _learn_step(self, t_s: Array) -> StampJudge:
        """Learn the usual time step from the first rows; return who judges stamps."""
        steps_s = np.diff(np.unique(t_s[:STEP_ROWS]))
        self._step_s = float(np.median(steps_s)) if steps_s.size else 0.0
        jump_s = LIVE_JUMP_S
        if self._window_s > 0.0:
            self._window_s = max(self._window_s, JUMP_STEPS * self._step_s)
            jump_s = self._window_s

        return StampJudge(
            jump_s=max(jump_s, JUMP_STEPS * self._step_s),
            pause_s=max(PAUSE_S, PAUSE_STEPS * self._step_s),
        )

    def _judged_stretches(self) -> list[_Stretch]:
        """Judge the rows that wait; return those that are valid."""
        rows = _joined(self._unjudged)
        t_s = rows["t_s"]
        if self._judge is None:
            self._judge = self._learn_step(t_s)

        judge = self._judge
        jumps = np.flatnonzero(np.abs(np.diff(t_s)) > judge.jump_s)
        stretches: list[_Stretch] = []
        start = 0
        row = len(judge.waiting_s)
        while row < len(t_s):
            verdict = judge.add(float(t_s[row]))
            row += 1
            if verdict is None:
                continue

            end = start + len(verdict.is_bad)
            is_bad = verdict.is_bad
            if not judge.waiting_s:
                # What follows without a jump is valid, too.
                jump = np.searchsorted(jumps, row - 1)
                row = int(jumps[jump]) + 1 if jump < len(jumps) else len(t_s)
                is_bad = np.concatenate((is_bad, np.zeros(row - end, dtype=np.bool_)))
                judge.accept(float(t_s[row - 1]))
                end = row

            stretches += self._valid_stretch(
                _part(rows, np.arange(start, end)), is_bad, verdict.starts_anew
            )
            start = end

        self._unjudged = [_part(rows, np.arange(start, len(t_s)))]
        return stretches

    def _last_stretches(self) -> Iterator[_Stretch]:
        """Judge the rows that still wait at the end; yield those that are valid."""
        judge = self._judge
        (rows,) = self._unjudged
        start = 0
        while judge is not None and (verdict := judge.finish()) is not None:
            end = start + len(verdict.is_bad)
            part = _part(rows, np.arange(start, end))
            yield from self._valid_stretch(part, verdict.is_bad, verdict.starts_anew)
            start = end

    def _valid_stretch(
        self, rows: Rows, is_bad: NDArray[np.bool_], starts_anew: bool
    ) -> list[_Stretch]:
        """Name the bad rows of a stretch; return it without them, if any is left."""
        good_s = rows["t_s"][~is_bad]
        if is_bad.any():
            for row in np.flatnonzero(is_bad).tolist():
                after_s = rows["t_s"][row:][~is_bad[row:]]
                before_s = rows["t_s"][:row][~is_bad[:row]]
                before_s = np.concatenate((self._latest_s, before_s))
                self._name_bad(rows, row, before_s[-1:], after_s[:1])

        if not good_s.size:
            return []
        if starts_anew and self._latest_s.size:
            self._note_step(rows, int(np.argmin(is_bad)))

        self._latest_s = good_s[-1:]
        return [_Stretch(_part(rows, ~is_bad), starts_anew)]

    def _name_bad(self, rows: Rows, row: int, before_s: Array, after_s: Array) -> None:
        """Report a row with a bad stamp, by name as long as they are few.

        Args:
            rows: With the row.
            row: Its index.
            before_s: The valid stamp before it, shape (1,); empty before the first.
            after_s: The valid stamp after it, likewise.
        """
        self.bad_count += 1
        if self.bad_count > MAX_NAMED_ROWS:
            return

        around = [f"{stamp_s:.13g} s" for stamp_s in (*before_s, *after_s)]
        relation = "between" if len(around) == 2 else "after"
        if not before_s.size:
            relation = "before"
        self._warnings.append(
            f"row {rows['row'][row]:.0f} has a bad time stamp and is left out: "
            f"{rows['t_s'][row]:.13g} s, {relation} {' and '.join(around)}"
        )

    def _note_step(self, rows: Rows, row: int) -> None:
        """Count a step of time ahead that is longer than a pause in motion."""
        (before_s,) = self._latest_s.tolist()
        after_s = float(rows["t_s"][row])
        if self._judge is not None and after_s - before_s > self._judge.pause_s:
            self._faults.note(
                "time: long steps ahead, where the recording paused or its clock was "
                "set",
                f"row {rows['row'][row]:.0f}, {after_s:.13g} s after {before_s:.13g} s",
            )

    def _released(self, stretches: list[_Stretch]) -> list[Rows]:
        """Put valid rows where they belong; return those that are ready."""
        ready: list[Rows] = []
        for stretch in stretches:
            if self._window_s <= 0.0:
                ready.append(stretch.rows)
                continue

            if stretch.starts_anew:
                ready += self._hold(self._tail)
                ready += self._release_all()
                self._tail = []
                self._before_s = np.empty(0)

            ready += self._hold(self._without_displaced(stretch.rows))

        return ready

    def _without_displaced(self, rows: Rows) -> list[Rows]:
        """Leave out single rows whose stamp is near, but whose own place is free.

        The last rows wait for those after them.
        """
        rows = _joined([*self._tail, rows])
        t_s = np.concatenate((self._before_s, rows["t_s"]))
        is_bad = np.zeros(len(t_s), dtype=np.bool_)
        margin = DISPLACED_MARGIN
        if len(t_s) > 2 * margin:
            is_bad[margin:-margin] = _displaced(t_s, self._step_s)

        first = len(self._before_s)
        for i in np.flatnonzero(is_bad).tolist():
            self._name_bad(rows, i - first, t_s[i - 1 : i], t_s[i + 1 : i + 2])

        end = max(len(t_s) - margin, first)
        self._before_s = t_s[max(end - margin, 0) : end]
        self._tail = [_part(rows, np.arange(end - first, len(rows["t_s"])))]
        passed = np.flatnonzero(~is_bad[first:end])
        return [_part(rows, passed)] if passed.size else []

    def _hold(self, parts: list[Rows]) -> list[Rows]:
        """Hold rows in the order of the file; return those that are ready."""
        if not parts:
            return []

        rows = _joined([*self._held, *parts])
        ready: list[Rows] = []
        while (row := _find_set_back(rows["t_s"], self._step_s)) is not None:
            self._held = [_part(rows, np.arange(row))]
            ready += self._release_all()
            rows = _part(rows, np.arange(row, len(rows["t_s"])))

        t_s = rows["t_s"]
        if not t_s.size:
            return ready

        newest_s = np.maximum.accumulate(t_s)
        # A row that comes later than the window stays where it is.
        place_s = np.maximum(t_s, newest_s - self._window_s)
        order = np.argsort(place_s, kind="stable")
        count = int(
            np.searchsorted(place_s[order], newest_s[-1] - self._window_s, "right")
        )
        count = max(count, len(t_s) - MAX_HELD_ROWS)
        is_late = (t_s < newest_s) & (place_s == t_s)
        self._count_sorted(rows, order[:count], is_late)
        self._held = [_part(rows, np.sort(order[count:]))]
        return [*ready, _part(rows, order[:count])] if count else ready

    def _release_all(self) -> list[Rows]:
        """Return all rows that are held, in the order of time."""
        if not self._held:
            return []

        rows = _joined(self._held)
        self._held = []
        t_s = rows["t_s"]
        newest_s = np.maximum.accumulate(t_s)
        place_s = np.maximum(t_s, newest_s - self._window_s)
        order = np.argsort(place_s, kind="stable")
        self._count_sorted(rows, order, (t_s < newest_s) & (place_s == t_s))
        return [_part(rows, order)] if len(t_s) else []

    def _count_sorted(
        self, rows: Rows, chosen: NDArray[np.intp], is_late: NDArray[np.bool_]
    ) -> None:
        """Count the rows among chosen ones that came after newer ones."""
        late = chosen[is_late[chosen]]
        if late.size:
            first = float(rows["row"][late].min())
            self._first_sorted = min(self._first_sorted, first)
            self._sorted_count += late.size

    def _report_end(self) -> None:
        """Report what only the whole log shows."""
        if self.bad_count > MAX_NAMED_ROWS:
            text = f"rows with a bad time stamp, left out: {self.bad_count}"
            if self.bad_count > MIN_UNSORTED_RATIO * self._row_count:
                text += (
                    "; so many may be rows out of order, which --sort-within SECONDS "
                    f"sorts in a wider window than {self._window_s:.3g} s"
                )

            self._warnings.append(text)

        if self._sorted_count:
            self._warnings.append(
                f"time: rows out of order, sorted within {self._window_s:.3g} s: "
                f"{self._sorted_count} of {self._row_count} (first: row "
                f"{self._first_sorted:.0f})"
            )

        self._warnings += self._faults.lines()


def _displaced(t_s: Array, step_s: float) -> NDArray[np.bool_]:
    """Return which stamps are not where the order of the rows has a free place.

    The rows before and after follow each other evenly, and leave one place free.

    Args:
        t_s: Stamps in the order of the file, shape (n,).
        step_s: The usual time step.

    Returns:
        For the rows with `DISPLACED_MARGIN` rows on each side; shape (n - 6,).
    """
    margin = DISPLACED_MARGIN
    windows_s = np.lib.stride_tricks.sliding_window_view(t_s, 2 * margin + 1)
    others_s = np.delete(windows_s, margin, axis=1)
    steps_s = np.diff(others_s, axis=1)
    place_s = steps_s[:, margin - 1].copy()
    steps_s[:, margin - 1] = step_s
    is_even = (steps_s > 0.0) & (steps_s < FREE_PLACE_STEPS * step_s)
    is_ordered = is_even.all(axis=1)
    is_free = (place_s > FREE_PLACE_STEPS * step_s) & (
        place_s < MAX_FREE_PLACE_STEPS * step_s
    )
    stamps_s = windows_s[:, margin]
    distance_s = np.maximum(
        stamps_s - others_s[:, margin], others_s[:, margin - 1] - stamps_s
    )
    return is_ordered & is_free & (distance_s > MIN_DISPLACED_STEPS * step_s)


def _find_set_back(t_s: Array, step_s: float) -> int | None:
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
    min_count = MIN_OCCUPANCY * spans_s / step_s
    is_set_back = is_run & (lengths > min_count) & (taken - lengths > min_count)
    return int(starts[np.argmax(is_set_back)]) if is_set_back.any() else None
