"""Named columns of numbers before anyone has said what they mean, and the time of
their rows.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from needleforce.recordings.errors import FormatError, LogError

FloatArray = NDArray[np.float64]
Columns = Mapping[str, np.ndarray]

HEAD_ROWS = 200  # So many rows decide which columns a stream has, however they arrive
START_KEY = "start_ns"  # what files of numbers call `Labels.start_ns`


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Table:
    """Named columns as read from a file, in the file's own units.

    Columns may differ in length (an npz file may hold several recordings); a `Log` may
    not. They are read-only copies as float64; those of whole numbers that float64 would
    round, as nanoseconds since 1970 are, as int64. `start_ns` is the instant of t = 0
    on the clock that stamped the file, in ns: zero, unless stamps are too large for
    seconds in float64 to resolve nanoseconds.

    Attributes:
        columns: By name, shape (n,) or (n, k).
        warnings: What the reader had to leave out or guess.
        joint_names: Of (n, k) columns.
        seconds: Columns of time stamps, whatever unit the name says.
    """

    columns: Mapping[str, np.ndarray]
    warnings: tuple[str, ...] = ()
    joint_names: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    start_ns: int = 0
    seconds: frozenset[str] = frozenset()

    def __post_init__(self) -> None:
        """Copy and freeze the columns; `FormatError` or `LogError` if they are none
        of numbers.
        """
        if not self.columns:
            raise FormatError("no column of numbers: a table needs at least one")
        columns = {
            name: read_only(name, v, is_exact=True) for name, v in self.columns.items()
        }
        for name, values in columns.items():
            if values.ndim not in (1, 2):
                shape = f"has shape {values.shape}; expected (n,) or (n, k)"
                raise FormatError(f"column {name!r} {shape}")
        object.__setattr__(self, "columns", MappingProxyType(columns))

    def __len__(self) -> int:
        """Return the number of rows of the longest column."""
        return max(map(len, self.columns.values()))

    def describe(self, limit: int = 40) -> str:
        """Return the column names for a message, two-dimensional ones with their
        width.
        """
        names = [
            f"{name} ({values.shape[1]} columns)" if values.ndim == 2 else name
            for name, values in self.columns.items()
        ]
        more = f" and {len(names) - limit} more" if len(names) > limit else ""
        return ", ".join(names[:limit]) + more

    def left_out(self, limit: int = 3) -> str:
        """Return in brackets, for a message, which columns the reader left out and
        why.
        """
        notes = [note for note in self.warnings if note.endswith("was left out")]
        more = f"; and {len(notes) - limit} more" if len(notes) > limit else ""
        return f" ({'; '.join(notes[:limit])}{more})" if notes else ""


def read_only(name: str, values: ArrayLike, *, is_exact: bool = False) -> np.ndarray:
    """Return a contiguous read-only copy as float64; `LogError` if these are no
    numbers.

    Where it shall be exact, whole numbers that float64 would round stay such, as int64.
    """
    try:
        array = np.asarray(values)
        is_exact &= (
            array.dtype.kind in "iu" and array.ndim == 1 and exceed_float64(array)
        )
        copy = np.array(array, dtype=np.int64 if is_exact else np.float64, order="C")
    except (TypeError, ValueError) as error:
        raise LogError(f"{name} is not an array of numbers: {error}") from error
    copy.setflags(write=False)
    return copy


@dataclass(frozen=True, slots=True, kw_only=True)
class Labels:
    """What goes with the columns of a table that is written.

    Bags carry all of it, the other formats `start_ns`, see `Table`, if it is not zero.
    A bag written from a log that was read from one has the source's stamps, to the
    nanosecond.

    Attributes:
        joint_names: In the order of the columns of joint signals.
        frame: In which forces are given.
        prefix: How the topics of a bag begin that hold estimates.
    """

    start_ns: int = 0
    joint_names: tuple[str, ...] = ()
    frame: str = ""
    prefix: str = "/needleforce"


def flat_columns(columns: Columns) -> dict[str, np.ndarray]:
    """Return columns of one value a row, `q_rad_1`, ... of `q_rad`; `LogError` for a
    name twice.
    """
    flat: dict[str, np.ndarray] = {}
    for name, values in columns.items():
        for i, column in enumerate(np.atleast_2d(values.T), 1):
            part = f"{name}_{i}" if values.ndim == 2 else name
            if part in flat:
                raise LogError(f"column name {part!r} would stand twice in the header")
            flat[part] = column
    return flat


NS_PER_S = 1_000_000_000
_EXACT_NS = 1 << 52  # up to here (52 days) a double of seconds resolves nanoseconds
_EXACT = 1 << 53  # up to here float64 holds every whole number


def start_of_clock(first_ns: int) -> int:
    """Return the instant from which seconds are counted so that nothing is lost.

    It is 0, so that the file's clock is kept, or the first stamp if that clock began
    long ago.
    """
    return 0 if abs(first_ns) < _EXACT_NS // 2 else first_ns


def to_seconds(stamps_ns: NDArray[np.int64], start_ns: int) -> FloatArray:
    """Return stamps in seconds since `start_ns`; the nearest double, from which they
    come back.
    """
    return (stamps_ns - np.int64(start_ns)) / NS_PER_S


def to_nanoseconds(t_s: ArrayLike, start_ns: int) -> NDArray[np.int64]:
    """Return seconds since `start_ns` as stamps, to the nearest nanosecond; they
    must be finite.
    """
    counted = np.rint(np.asarray(t_s, dtype=np.float64) * NS_PER_S).astype(np.int64)
    return counted + np.int64(start_ns)


def exceed_float64(values: np.ndarray) -> bool:
    """Return whether float64 rounds whole numbers as large as these, and int64 does
    not.
    """
    # Not abs, which overflows for the least integer; a NaN is not larger than anything.
    return bool(len(values)) and bool(((values > _EXACT) & (values < 1 << 63)).all())


def interpolate(
    at_ns: NDArray[np.int64],
    stamps_ns: NDArray[np.int64],
    values: FloatArray,
    limit_ns: float,
) -> FloatArray:
    """Interpolate values (m, k) linearly; where stamps agree, they are taken as they
    are.

    They are known at stamps in any order; where these are further apart than the limit
    the result is NaN, as outside them.
    """
    if not stamps_ns.size:
        return np.full((at_ns.size, values.shape[1]), np.nan)
    order = np.argsort(stamps_ns, kind="stable")
    stamps_ns = stamps_ns[order]
    values = values[order]
    low = np.clip(np.searchsorted(stamps_ns, at_ns, side="right") - 1, 0, None)
    high = np.clip(low + 1, None, stamps_ns.size - 1)
    is_far = (stamps_ns[high] - stamps_ns[low] > limit_ns) & (stamps_ns[low] != at_ns)
    # float64 holds differences of stamps, not stamps.
    at = at_ns - stamps_ns[0]
    known = stamps_ns - stamps_ns[0]
    rows = [np.interp(at, known, each, left=np.nan, right=np.nan) for each in values.T]
    rows = np.stack(rows, axis=1)
    rows[is_far] = np.nan
    return rows


class Faults(dict[str, tuple[int, str]]):
    """What is wrong with a recording, by kind: how often, and where first."""

    def note(self, what: str, where: str, count: int = 1) -> None:
        """Count a fault; `where` it is counts the first time."""
        before, first = self.get(what, (0, ""))
        self[what] = before + count, first or where

    def lines(self) -> tuple[str, ...]:
        """Return a line for each kind of fault."""
        return tuple(
            f"{what}: {count} (first: {first})" if first else what
            for what, (count, first) in self.items()
            if count
        )


_SET_BACK = "time: clock set back, from where it counts anew"
_BACK = "time: stamps running backward"
_REPEATED = "time: stamps repeated"
_SET_AFTER_S = 0.1
_SET_AFTER_ROWS = 3
"""A row that is not later than those before came late. When so many rows in a row, over
so much time, are later than each other but not than those before, it was not they: the
clock was set."""


class RowClock:
    """Time from row to row; a row that comes late is no step, a clock that was set back
    is left.

    A clock that goes back a little soon catches up; until then rows do not advance. If
    it stays behind, it counts from there, however many rows come at a time. Rows that
    do not advance stay in a log: an online step skips them.
    """

    def __init__(self) -> None:
        self._latest_s = -math.inf
        self._behind: list[
            float
        ] = []  # stamps since the latest, each later than the one before
        self._rows = self._advanced = 0
        self._faults = Faults({_SET_BACK: (0, ""), _BACK: (0, "")})  # in this order

    def update(self, t_s: FloatArray) -> FloatArray:
        """Take time stamps in s, shape (n,); return time in s since the latest row that
        advanced.

        It is not positive for a row that does not advance, inf for the first of all.
        The row at which a set clock is recognised advances by the time for which it has
        run.
        """
        dt_s = np.diff(t_s, prepend=self._latest_s)
        if not (dt_s > 0.0).all():
            return np.array([self._step(now_s) for now_s in t_s.tolist()])
        if t_s.size:
            self._latest_s = float(t_s[-1])
            self._behind.clear()
            self._rows = self._rows + t_s.size
            self._advanced = self._advanced + t_s.size
        return dt_s

    def _step(self, now_s: float) -> float:
        before_s = self._latest_s
        dt_s = now_s - self._latest_s
        what = _REPEATED if dt_s == 0.0 else _BACK
        self._rows = self._rows + 1
        if dt_s < 0.0:
            if self._behind and now_s < self._behind[-1]:
                self._behind.clear()
            if not self._behind or now_s > self._behind[-1]:
                self._behind.append(now_s)
            ran_s = now_s - self._behind[0]
            if len(self._behind) >= _SET_AFTER_ROWS and ran_s >= _SET_AFTER_S:
                what = _SET_BACK
                dt_s = ran_s
        if dt_s > 0.0:
            self._latest_s = now_s
            self._advanced = self._advanced + 1
            self._behind.clear()
        if now_s <= before_s:
            self._faults.note(
                what, f"row {self._rows}, {now_s:.9g} s after {before_s:.9g} s"
            )
        return dt_s

    def warnings(self) -> tuple[str, ...]:
        """Report stamps that do not advance, by kind; `LogError` if fewer than two
        advance.
        """
        # The first of all counts as one that advances.
        if self._advanced < 2:
            raise LogError(
                f"no usable time: of {self._rows} samples none is later than the first; "
                "at least two time stamps must advance"
            )
        return self._faults.lines()
