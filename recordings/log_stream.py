"""A recording whose channels are known, row by row as it comes."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from recordings.clock.time_channel import find_time
from recordings.clock.time_stamps import TimeStampWatch
from recordings.columns.channel import CHANNELS
from recordings.columns.finite_watch import FiniteWatch
from recordings.columns.mapping import ColumnMapping
from recordings.columns.si_channel import SiChannel, find_si_channel
from recordings.columns.spec import ColumnSpec
from recordings.columns.unit_hints import UnitWatch
from recordings.errors import LogError
from recordings.select_channels import check_sizes, find_channels, without_stamp
from recordings.tables.joined_tables import joined_tables
from recordings.tables.table import FloatArray, Table
from recordings.text.format import HEAD_ROWS


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LogChunk:
    """Consecutive rows of a log.

    Attributes:
        t_s: time stamps in s, shape (n,), finite; as in a `Log`.
        dt_s: time since the latest row that advanced, shape (n,), see `RowClock`.
        channels: as in a `Log`, shape (n,) or (n, joints); always the same.
    """

    t_s: FloatArray
    dt_s: FloatArray
    channels: Mapping[str, FloatArray]


class LogStream:
    """Iterates over the rows of a recording in SI units, a chunk at a time.

    Which columns are which channels is decided from the first rows. Rows and numbers are those of
    `read_log`, and what is wrong with them is told as there.

    Args:
        tables: from `stream_tables`.
        mapping: see `read_log`.
        required: see `read_log`.
        optional: see `read_log`.
    """

    def __init__(
        self,
        tables: Iterable[Table],
        mapping: ColumnMapping | None = None,
        *,
        required: Iterable[str] = (),
        optional: Iterable[str] = (),
    ) -> None:
        self._tables = iter(tables)
        self._mapping = mapping or ColumnMapping()
        self._required, self._optional = tuple(required), tuple(optional)
        self._told: dict[str, bool] = {}
        self._rows = self._lost = self._first_lost = self._clock_ns = 0
        self._stamps, self._units = TimeStampWatch(), UnitWatch()
        self._finite: dict[str, FiniteWatch] = {}
        self.start_ns = 0
        """The instant of t_s = 0, see `Table`; known after the first chunk."""

    def take_warnings(self) -> tuple[str, ...]:
        """Return what has been found wrong with the recording since the last call."""
        news = tuple(warning for warning, is_old in self._told.items() if not is_old)
        self._told |= dict.fromkeys(news, True)
        return news

    def __iter__(self) -> Iterator[LogChunk]:
        """Yield the rows; the first chunk has `HEAD_ROWS`, if there are so many.

        Raises:
            FileAccessError: see `stream_tables`.
            FormatError: see `stream_tables`.
            ColumnError: time, a required or a mapped channel was not found, or is ambiguous.
            MappingError: a channel name is unknown, or a scale does not fit its columns.
            LogError: the channels do not form a log; what only the end shows is told there.
        """
        head = joined_tables(self._tables, HEAD_ROWS)
        self._tell(head.warnings)
        self.start_ns = head.start_ns
        found, notes = find_channels(head, self._mapping, self._required, self._optional)
        self._tell(notes)
        self._finite = {key: FiniteWatch(key) for key in found}
        yield from self._chunk(head, found)
        for table in self._tables:
            self._tell(table.warnings)
            if any(map(len, table.columns.values())):
                channels = {
                    CHANNELS[name].key: find_si_channel(table, CHANNELS[name], spec)
                    for name, spec in self._mapping.channels.items()
                    if CHANNELS[name].key in found
                }
                yield from self._chunk(table, channels)
        self._finish()

    def _chunk(self, table: Table, channels: Mapping[str, SiChannel | None]) -> Iterator[LogChunk]:
        found = {key: channel for key, channel in channels.items() if channel is not None}
        rows = len(next(iter(found.values())).values)
        time, notes = find_time(
            table, self._mapping, rows, self._rows, self._clock_ns if self._rows else None
        )
        self._clock_ns = time.start_ns
        self.start_ns = self.start_ns or time.start_ns
        self._tell(notes)
        everything = {"t_s": time, **found}
        check_sizes(everything, is_part=True)
        self._units.update({k: f.values for k, f in everything.items() if not f.is_unit_stated})
        if not self._rows:
            self._tell(self._units.news())
            self._mapping = _settled(self._mapping, everything)
        keep = np.isfinite(time.values)
        if not keep.all():
            self._first_lost = self._first_lost if self._lost else self._rows + int(np.argmin(keep))
            self._lost += int(np.count_nonzero(~keep))
        self._rows += rows
        if not keep.any():
            return
        t_s = time.values[keep]
        chunk = LogChunk(
            t_s=t_s,
            dt_s=self._stamps.update(t_s),
            channels={key: f.values[keep] for key, f in found.items()},
        )
        for key, values in chunk.channels.items():
            self._finite[key].update(values)
        yield chunk

    def _finish(self) -> None:
        """Tell and refuse what only the whole log shows."""
        if self._lost:
            self._tell((without_stamp(self._lost, self._first_lost),))
        if self._lost == self._rows:
            raise LogError(f"of {self._rows} rows none has a time stamp")
        self._tell(self._units.news())
        self._tell(self._stamps.warnings())
        for watch in self._finite.values():
            self._tell(watch.warnings())

    def _tell(self, warnings: tuple[str, ...]) -> None:
        self._told |= {warning: False for warning in warnings if warning not in self._told}


def _settled(mapping: ColumnMapping, found: Mapping[str, SiChannel]) -> ColumnMapping:
    """Return a mapping that names the columns that were found, and no others."""
    specs = {}
    for name, channel in CHANNELS.items():
        if channel.key in found and (columns := found[channel.key].columns):
            given = mapping.channels.get(name, ColumnSpec(columns=columns))
            specs[name] = ColumnSpec(columns=columns, unit=given.unit, scale=given.scale)
    return ColumnMapping(channels=specs, rate_hz=mapping.rate_hz)
