"""From tables to a log: channels in SI units, whole or row by row as they come."""

import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np

from foundation.arrays import Array
from needleforce.recordings.channel_request import ChannelRequest
from needleforce.recordings.channel_units import ChannelUnit, advise_unit
from needleforce.recordings.channels import Channel
from needleforce.recordings.column_names import advise_column, columns_in_other_units
from needleforce.recordings.errors import (
    MAX_BYTES,
    ColumnError,
    FaultCounts,
    LogError,
    RecordingError,
    UnitError,
    require_size,
)
from needleforce.recordings.log import Log
from needleforce.recordings.log_signal import (
    Signal,
    VelocityWatch,
    require_equal_sizes,
)
from needleforce.recordings.stamp_order import (
    SORTED_WITHIN_S,
    Rows,
    StampOrder,
    rows_in_order,
)
from needleforce.recordings.table import HEAD_ROWS, Table, ToolMass, tool_mass_in
from needleforce.recordings.time_stamps import (
    NS_PER_S,
    RowClock,
    first_valid_stamp,
    start_of_clock,
    to_seconds,
)

ROW = "row"
"""Name of the numbers of rows in the file, beside the keys of channels."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LogChunk:
    """Consecutive rows of a log.

    Attributes:
        t_s: Time stamps, shape (n,), as in a `Log`.
        dt_s: Time since the latest row that advanced, shape (n,), see `RowClock`.
        channels: By name, shape (n,) or (n, joints), as in a `Log`.
    """

    t_s: Array
    dt_s: Array
    channels: Mapping[str, Array]


class LogStream:
    """Iterates over the rows of a recording in SI units, a chunk at a time.

    Which columns are which channels is decided from the first rows. Rows and numbers
    are those of `read_log`, and what is wrong with them is reported as there.

    Args:
        tables: From `stream_tables`, with the same request.
        request: Which channels are read, and which columns they are; by default all
            that look like one.
        sorted_within_s: Rows are sorted that come no later than this after newer ones,
            if the mapping does not say how late; 0 for rows that are used as they come.

    Attributes:
        start_ns: The instant of t_s = 0, see `Table`; known after the first chunk.
        tool_mass: What the recording says hangs on the flange, likewise.
        units: In which unit each channel is read; known after the first chunk.
    """

    def __init__(
        self,
        tables: Iterable[Table],
        request: ChannelRequest | None = None,
        sorted_within_s: float = SORTED_WITHIN_S,
    ) -> None:
        self._tables = iter(tables)
        self._request = request or ChannelRequest()
        self._warnings: dict[str, None] = {}  # in order, each once
        self._taken_count = 0  # warnings that were taken
        self._row_count = 0
        self._kept_count = 0  # rows with a time stamp
        self._clock_start_ns = 0  # of whole nanoseconds too large for float64
        self._faults = FaultCounts()
        self._row_clock = RowClock()
        mapping = self._request.mapping
        if mapping.sort_within_s is not None:
            sorted_within_s = mapping.sort_within_s

        self._channels = mapping.knowledge.channels
        self._order = StampOrder(sorted_within_s, self._report)
        self._velocity_watch = VelocityWatch()
        self._signals: dict[str, Signal] = {}
        self.start_ns = 0
        self.tool_mass: ToolMass | None = None
        self.units: tuple[ChannelUnit, ...] = ()

    @property
    def bad_stamp_count(self) -> int:
        """How many rows were left out so far because their time stamp is bad."""
        return self._order.bad_count

    def take_warnings(self) -> tuple[str, ...]:
        """Return what was wrong with the recording since the last call."""
        new_warnings = tuple(self._warnings)[self._taken_count :]
        self._taken_count += len(new_warnings)
        return new_warnings

    def __iter__(self) -> Iterator[LogChunk]:
        """Yield the rows; the first chunk has 200, if there are so many.

        Raises as `read_log`; what only the end shows is reported there.
        """
        head = next(self._tables)
        self._report(*head.warnings)
        self.start_ns = head.start_ns
        self.tool_mass = head.tool_mass or tool_mass_in(head)
        self._request = self._request.with_layout(head)
        layout = self._request.find_layout(head)
        note = f"{layout.name}: {layout.note}" if layout and layout.note else ""
        self._report(*([note] if note else []))
        try:
            self._find_channels(head)
        except RecordingError as error:  # the note may say why
            raise (error.reworded(f"{error}. {note}") if note else error) from error

        has_stamps = self._request.mapping.rate_hz is None
        if has_stamps:
            self._signals = {"t_s": self._find_time(head), **self._signals}

        self.units = tuple(signal.source for signal in self._signals.values())
        parts = self._watched_parts(chain([head], self._tables))
        if has_stamps:
            parts = rows_in_order(parts, self._order, self._report)

        for part in parts:
            yield self._chunk(part)

        self._report_end()

    def joined(self, max_bytes: int = MAX_BYTES) -> Log:
        """Return all rows as one log.

        Raises:
            FormatError: They take more bytes than allowed.
        """
        chunks: list[dict[str, Array]] = []
        size = 0
        for chunk in self:
            values = {"t_s": chunk.t_s, **chunk.channels}
            chunks.append(values)
            size += sum(array.nbytes for array in values.values())
            require_size(size, max_bytes, "what is read of it")

        channels: dict[str, Array] = {}
        for key in list(chunks[0]):
            # Taken from the chunks, so that no channel is held twice for long.
            channels[key] = np.concatenate([values.pop(key) for values in chunks])
            channels[key].setflags(write=False)

        t_s = channels.pop("t_s")
        return Log(
            t_s=t_s,
            channels=channels,
            warnings=self.take_warnings(),
            start_ns=self.start_ns,
            units=self.units,
        )

    def _report(self, *warnings: str) -> None:
        """Add warnings that were not reported before."""
        self._warnings |= dict.fromkeys(warnings)

    def _report_end(self) -> None:
        """Report what only the whole log shows."""
        self._report(*self._faults.lines())
        if not self._kept_count:
            raise LogError(
                f"of {self._row_count} rows none has a time stamp",
                "Give time stamps that increase; name their unit in the "
                "`mapping`, or give `rate_hz` instead.",
            )

        for signal in self._signals.values():
            signal.require_plausible()
        for signal in self._signals.values():
            self._report(*signal.report_implausible())

        self._report(*self._row_clock.warnings())
        self._report(*self._velocity_watch.warnings())
        for key, signal in self._signals.items():
            if key != "t_s":
                self._report(*signal.report_not_finite())

    def _find_time(self, table: Table) -> Signal:
        """Find the column of time stamps; `ColumnError` if there is none."""
        time = self._channels["time"]
        columns = self._request.find(table, time)
        if columns:
            spec = self._request.mapping.channels.get("time")
            return Signal(table, time, columns, spec)
        if not table.has_header:
            raise _no_header([time], table, self._request)

        raise ColumnError(
            f"no time column found. Columns are: {table.describe()}{table.left_out()}",
            "Name it under `time` in the `mapping`, or give `rate_hz`.",
        )

    def _find_channels(self, table: Table) -> None:
        """Decide from the first table which columns are read."""
        request = self._request
        missing: list[Channel] = []
        by_joint: list[str] = []
        for name in request.requested:
            channel = self._channels[name]
            columns = request.find(table, channel)
            if columns and columns == request.find_by_joints(table, channel):
                by_joint.append(f"{name}: {columns[0]}, ...")
            if columns:
                self._add_signal(table, channel, columns)
            elif name in request.required:
                missing.append(channel)

        _require_names(request.mapping.joint_pattern, table, by_joint)
        if by_joint:
            listed = "; ".join(by_joint)
            self._report(f"columns found by the names of the joints: {listed}")
        if missing:
            raise _not_found(missing, table, request)
        if not self._signals:
            raise ColumnError(
                f"no channel was recognised. Columns are: {table.describe()}"
            )

    def _add_signal(
        self, table: Table, channel: Channel, columns: Sequence[str]
    ) -> None:
        """Read a channel from some columns, unless it may lack and has no values."""
        spec = self._request.mapping.channels.get(channel.name)
        is_required = channel.name in self._request.required
        signal = Signal(table, channel, columns, spec)
        head = signal.read(table, slice(HEAD_ROWS))
        if not is_required:
            _require_all_joints(channel, head)
        if is_required or spec is not None or np.isfinite(head).any():
            self._signals[channel.key] = signal
            return

        self._report(
            f"{channel.name}: its columns hold no finite value in the first rows and "
            "were left out"
        )

    def _watched_parts(self, tables: Iterable[Table]) -> Iterator[Rows]:
        """Yield the rows of tables that have a time stamp, some at a time."""
        for table in tables:
            self._report(*table.warnings)
            if not len(table) and self._row_count:
                continue

            if not self._row_count:
                require_equal_sizes(table, self._signals)

            signal = next(iter(self._signals.values()))
            row_count = len(table.values(signal.source.columns[0]))
            max_chunk_rows = 1 << 14  # of a file that is held as a whole
            for start in range(0, row_count, max_chunk_rows):
                watched = self._watched(
                    self._read(
                        table, slice(start, min(start + max_chunk_rows, row_count))
                    )
                )
                if len(watched["t_s"]):
                    yield watched

    def _read(self, table: Table, rows: slice) -> Rows:
        """Return rows of a table in SI units, with their time and number."""
        values = {
            key: signal.read(table, rows) for key, signal in self._signals.items()
        }
        first = self._row_count
        numbers = np.arange(first, first + rows.stop - rows.start)
        rate_hz = self._request.mapping.rate_hz
        values["t_s"] = (
            self._time_s(table, values["t_s"], rows)
            if rate_hz is None
            else numbers / rate_hz
        )
        values[ROW] = numbers + 1.0
        self._row_count += numbers.size
        return values

    def _watched(self, values: Rows) -> Rows:
        """Return the rows that have a time stamp; note what is odd in channels."""
        has_stamp = np.isfinite(values["t_s"])
        if not has_stamp.all():
            self._faults.note(
                "time: rows without a stamp, left out",
                f"row {values[ROW][np.argmin(has_stamp)]:.0f}",
                int(np.count_nonzero(~has_stamp)),
            )
            values = {key: array[has_stamp] for key, array in values.items()}

        if not len(values["t_s"]):
            return values

        is_first = not self._kept_count
        self._kept_count += len(values["t_s"])
        for key, signal in self._signals.items():
            if key != "t_s":
                signal.watch(values[key], values[ROW])

        self._velocity_watch.update(values)
        if is_first:
            if "t_s" in self._signals:
                self._signals["t_s"].watch_step(values["t_s"])

            for signal in self._signals.values():
                signal.require_plausible()

        return values

    def _chunk(self, part: Rows) -> LogChunk:
        """Return rows in the order of time as a chunk of the log."""
        rows = part.pop(ROW)
        t_s = part.pop("t_s")
        time = self._signals.get("t_s")
        if time is not None:
            time.watch(t_s, rows)
            self._report(*time.report_implausible())

        return LogChunk(t_s=t_s, dt_s=self._row_clock.update(t_s, rows), channels=part)

    def _time_s(self, table: Table, column_s: Array, rows: slice) -> Array:
        """Return the time stamps of a table's rows in s, shape (n,).

        Whole nanoseconds too large for float64 are counted from the first, so that none
        is lost.
        """
        signal = self._signals["t_s"]
        is_in_ns = signal.factors[0] * NS_PER_S == 1.0
        if table.start_ns or not is_in_ns:
            return column_s

        stamps = table.values(signal.source.columns[0])[rows]
        is_whole = stamps.dtype.kind == "i"
        if is_whole and not self._row_count:
            self._clock_start_ns = start_of_clock(first_valid_stamp(stamps))
            self.start_ns = self._clock_start_ns
        if is_whole and self._clock_start_ns:
            return to_seconds(stamps, self._clock_start_ns)

        return column_s - self._clock_start_ns / NS_PER_S


def _require_names(pattern: str, table: Table, by_joint: Sequence[str]) -> None:
    """Refuse a pattern that chooses joints in a log that names none.

    Args:
        pattern: Empty where none was given.
        table: Of the log.
        by_joint: Columns that were found by the names of joints.

    Raises:
        ColumnError: Neither columns nor messages have names of joints.
    """
    if pattern and not by_joint and not table.joint_names:
        raise ColumnError(
            f"joints = {pattern!r} chooses joints by name, and neither columns nor "
            "messages of the recording have names of joints; leave it out"
        )


def _require_all_joints(channel: Channel, head: Array) -> None:
    """Refuse a channel that may be left out if some joints, not all, have no value.

    Args:
        channel: The channel.
        head: Its first values, shape (n,) or (n, joints).

    Raises:
        ColumnError: Such joints; every row would be rejected.
    """
    is_known = np.isfinite(head).any(axis=0)
    if channel.per_joint and is_known.any() and not is_known.all():
        numbers = ", ".join(str(i + 1) for i in np.flatnonzero(~is_known).tolist())
        raise ColumnError(
            f"{channel.name} has no finite value at joint {numbers} in the first "
            f"{len(head)} rows",
            "Leave it out with `ColumnSpec(columns=LEFT_OUT)` under "
            f"`{channel.name}` in the `mapping`, or name its columns there.",
        )


def _not_found(
    missing: list[Channel], table: Table, request: ChannelRequest
) -> RecordingError:
    """Return the error for required channels that no column of a table is."""
    channel, *others = missing
    for name, unit in columns_in_other_units(table, channel).items():
        return UnitError(
            f"{channel.name}: column {name!r} is in {unit!r}, which is no known unit "
            f"of {channel.name}; expected one of {', '.join(channel.units)}",
            advise_unit(channel, [name], f"{channel.si_unit}:FACTOR"),
        )

    if not table.has_header:
        return _no_header(missing, table, request)

    also = ", ".join(f"{other.name} ({other.meaning})" for other in others)
    return ColumnError(
        f"no column found for {channel.name} ({channel.meaning}); usual names are "
        f"{', '.join(channel.spellings)}. {f'Nor for {also}. ' if also else ''}"
        f"Columns are: {table.describe()}{table.left_out()}",
        advise_column(channel),
    )


def _no_header(
    missing: list[Channel], table: Table, request: ChannelRequest
) -> ColumnError:
    """Return the error for required channels of a file whose columns have no names."""
    time = request.mapping.knowledge.channels["time"]
    named = [time, *(channel for channel in missing if channel is not time)]
    joint_count = max(len(request.mapping.joints or request.joints), 1)
    options: list[str] = []
    first = 1
    for channel in named:
        last = first + (joint_count if channel.per_joint else 1) - 1
        columns = f"column_{first}"
        if last > first:
            columns = f"column_{{{first}..{last}}}"

        value = shlex.quote(f"{columns}:{channel.usual_unit}")
        options.append(f"{channel.option} {value}")
        first = last + 1

    return ColumnError(
        f"no column is known to be {', '.join(each.name for each in missing)}: the "
        f"file has no header. Columns are: {table.describe()}{table.left_out()}",
        "Name columns by their number, with their units, in the `mapping`, or as in "
        + " ".join(options),
    )
