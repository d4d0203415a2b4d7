"""From tables to a log: channels in SI units, one time stamp per row, whole or as
they come.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import chain
from math import prod
from types import MappingProxyType

import numpy as np

from needleforce.recordings.channels import (
    CHANNELS,
    Channel,
    find_columns,
    parse_column_name,
)
from needleforce.recordings.errors import (
    MAX_BYTES,
    ColumnError,
    LogError,
    MappingError,
    require_size,
)
from needleforce.recordings.mapping import ChannelRequest, ColumnSpec, channel_columns
from needleforce.recordings.table import (
    HEAD_ROWS,
    NS_PER_S,
    Faults,
    FloatArray,
    RowClock,
    Table,
    read_only,
    start_of_clock,
    to_seconds,
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Log:
    """Time stamps and named channels of equal length.

    Rows are kept as recorded. Backward or repeated stamps and non-finite values are
    reported in the `warnings` of a log that was read; the online steps skip them.
    Channels have names with their SI unit: `q_rad`, `dq_rad_s`, `tau_Nm`, `tau_ext_Nm`,
    `depth_m`, `speed_m_s`, `force_N`. Arrays are read-only.

    Attributes:
        t_s: Time stamps, shape (n,), finite; on the file's clock, not rebased.
        channels: By name, shape (n,) or (n, joints).
        warnings: What is wrong with the recording, one sentence each.
        start_ns: The instant of t_s = 0, see `Table`.
    """

    t_s: FloatArray
    channels: Mapping[str, FloatArray]
    warnings: tuple[str, ...] = ()
    start_ns: int = 0

    def __post_init__(self) -> None:
        """Copy, freeze and check the data.

        `LogError` if there is no channel, something is no array of numbers of the right
        shape, or time is not finite.
        """
        t_s = read_only("t_s", self.t_s)
        channels = {
            name: read_only(name, values) for name, values in self.channels.items()
        }
        if not channels:
            raise LogError("a log needs at least one channel beside time")
        if t_s.ndim != 1 or not t_s.size:
            raise LogError(f"t_s has shape {t_s.shape}; expected (n,) with n > 0")
        bad = np.flatnonzero(~np.isfinite(t_s))
        if bad.size:
            raise LogError(
                f"t_s: rows that are not finite: {bad.size} (first: row {bad[0] + 1})"
            )
        for name, values in channels.items():
            if values.ndim not in (1, 2) or values.shape[0] != t_s.size:
                raise LogError(
                    f"{name} has shape {values.shape}; expected ({t_s.size},) or ({t_s.size}, k), "
                    f"as t_s has {t_s.size} stamps"
                )
        object.__setattr__(self, "t_s", t_s)
        object.__setattr__(self, "channels", MappingProxyType(channels))

    def __len__(self) -> int:
        return self.t_s.size

    def __contains__(self, name: object) -> bool:
        return name in self.channels

    def __getitem__(self, name: str) -> FloatArray:
        """Return a channel's values; `ColumnError` if the log has no such channel."""
        if name in self.channels:
            return self.channels[name]
        raise ColumnError(
            f"the log has no channel {name!r}; it has: {', '.join(self.channels)}"
        )


# Beyond these an SI value is implausible for a robot or a needle: two turns of a joint,
# a torque of no arm that leads a needle, a needle of a metre, a force that buckles any
# needle. For time it is the median step: ten samples a second are not a force log.
_LIMITS = {
    "t_s": ("time", 0.1, "ms"),
    "q_rad": ("q", 4.0 * np.pi, "deg"),
    "tau_Nm": ("tau", 2000.0, "mNm"),
    "depth_m": ("depth", 1.0, "mm"),
    "speed_m_s": ("speed", 1.0, "mm/s"),
    "force_N": ("force", 200.0, "mN"),
}
_STEPS = ((1e5, "ns"), (200.0, "us"))  # so many units belong to logs of 10 Hz to 10 kHz


@dataclass(slots=True, eq=False)
class _Signal:
    """A channel: where in a table it stands, how its values become SI, and what is
    odd in them.

    Attributes:
        factors: To SI, one for each value of a row.
        is_sure: The unit is stated, or was doubted before.
        rows: Looked at so far.
        size: The largest value, of time the median step.
    """

    channel: Channel
    columns: tuple[str, ...]
    factors: FloatArray
    is_sure: bool
    rows: int = 0
    size: float = 0.0
    any_finite: bool = False
    faults: Faults = field(default_factory=Faults)

    def read(self, table: Table) -> FloatArray:
        """Return the values of a table's rows, shape (n,) or (n, joints)."""
        found = [
            values for name in self.columns for _, values in find_columns(table, name)
        ]
        values = np.column_stack(found) * self.factors
        return values if self.channel.per_joint else values[:, 0]

    def watch(self, values: FloatArray) -> None:
        """Look at rows; the step of time is that of the first ones."""
        finite = np.isfinite(values)
        if not finite.all():
            bad = np.flatnonzero(~finite.all(axis=tuple(range(1, values.ndim))))
            here = f"row {self.rows + int(bad[0]) + 1}"
            self.faults.note(
                f"{self.channel.key}: rows with NaN or infinity", here, bad.size
            )
        self.any_finite = self.any_finite or bool(finite.any())
        if not self.is_sure:
            sizes = np.abs(values[finite])
            if self.channel.key != "t_s":
                self.size = max(self.size, float(np.max(sizes, initial=0.0)))
            elif not self.rows and sizes.size > 1:
                self.size = float(np.median(np.abs(np.diff(values[finite]))))
        self.rows += len(values)

    def not_finite(self) -> tuple[str, ...]:
        """Report rows that are not finite; `LogError` if there was no finite value
        at all.
        """
        if self.faults and not self.any_finite:
            raise LogError(
                f"{self.channel.key} has no finite value in {self.rows} rows"
            )
        return self.faults.lines()

    def hardly_si(self) -> tuple[str, ...]:
        """Report, once, values whose unit was assumed and that hardly are in SI
        units.
        """
        name, limit, unit = _LIMITS.get(self.channel.key, ("", np.inf, ""))
        if self.is_sure or self.size <= limit:
            return ()
        self.is_sure = True
        is_time = self.channel.key == "t_s"
        unit = next((u for least, u in _STEPS if is_time and self.size >= least), unit)
        return (
            f"{name}: {'its median step' if is_time else 'it'} reaches {self.size:.4g} in SI; if "
            f"the file is in {unit}, say unit = {unit!r}, or --{name} COLUMN:{unit}",
        )


def _find_signal(
    table: Table, channel: Channel, spec: ColumnSpec | None
) -> _Signal | None:
    """Find a channel in a table; None if no name looks like it."""
    found = channel_columns(table, channel, spec)
    spec = spec or ColumnSpec(columns=channel.name)
    if not found:
        return None
    columns = tuple(name for name, _ in found)
    widths = [prod(v.shape[1:]) for _, v in found]
    width = sum(widths)
    names = ", ".join(columns)
    if width != 1 and not channel.per_joint:
        raise ColumnError(
            f"{channel.name} is one column, but {names} gives {width}; choose one"
        )
    if len({len(values) for _, values in found}) > 1:
        raise LogError(f"{channel.name}: the columns {names} differ in length")
    scales = np.atleast_1d(np.array(spec.scale, dtype=np.float64))
    if scales.size not in (1, width):
        raise MappingError(
            f"{channel.name}: {scales.size} scale factors for {width} columns; give one or {width}"
        )
    # The unit is the specification's, else that in each column's name, else SI.
    named = (
        spec.unit or parse_column_name(name, channel.units).unit for name in columns
    )
    units = [
        "s" if c in table.seconds else unit
        for c, unit in zip(columns, named, strict=True)
    ]
    si = np.array([channel.units[unit or channel.si_unit] for unit in units])
    return _Signal(channel, columns, np.repeat(si, widths) * scales, all(units))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LogChunk:
    """Consecutive rows of a log, `t_s` and `channels` as in a `Log`.

    Attributes:
        dt_s: Since the latest row that advanced, shape (n,), see `RowClock`.
    """

    t_s: FloatArray
    dt_s: FloatArray
    channels: Mapping[str, FloatArray]


class LogStream:
    """Iterates over the rows of a recording in SI units, a chunk at a time.

    Which columns are which channels is decided from the first rows. Rows and numbers
    are those of `read_log`, and what is wrong with them is reported as there.

    Args:
        tables: From `stream_tables`, with the same request.
        request: Which channels are read, and which columns they are; by default all
            that look like one.
    """

    def __init__(
        self, tables: Iterable[Table], request: ChannelRequest | None = None
    ) -> None:
        self._tables = iter(tables)
        self._request = request or ChannelRequest()
        self._found: dict[
            str, None
        ] = {}  # warnings, in order, of which so many were taken
        self._taken = 0
        self._rows = self._kept = self._clock_ns = 0
        self._faults = Faults()
        self._stamps = RowClock()
        self._signals: dict[str, _Signal] = {}
        self.start_ns = (
            0  # the instant of t_s = 0, see `Table`; known after the first chunk
        )

    def take_warnings(self) -> tuple[str, ...]:
        """Return what has been found wrong with the recording since the last call."""
        news = tuple(self._found)[self._taken :]
        self._taken += len(news)
        return news

    def __iter__(self) -> Iterator[LogChunk]:
        """Yield the rows; the first chunk has 200, if there are so many.

        Raises as `read_log`; what only the end shows is reported there.
        """
        head = next(self._tables)
        self._report(head.warnings)
        self.start_ns = head.start_ns
        self._find_channels(head)
        mapping = self._request.mapping
        if mapping.rate_hz is None:
            time = _find_signal(head, CHANNELS["time"], mapping.channels.get("time"))
            if time is None:
                raise ColumnError(
                    "no time column found; say which one with --time, or the sample rate with "
                    "--rate (rate_hz in the mapping). "
                    f"Columns are: {head.describe()}{head.left_out()}"
                )
            self._signals = {"t_s": time, **self._signals}
        for table in chain([head], self._tables):
            self._report(table.warnings)
            if len(table) or table is head:
                yield from self._chunk(table)
        # What only the whole log shows.
        self._report(self._faults.lines())
        if not self._kept:
            raise LogError(f"of {self._rows} rows none has a time stamp")
        self._report(chain(*(signal.hardly_si() for signal in self._signals.values())))
        self._report(self._stamps.warnings())
        for key, signal in self._signals.items():
            self._report(() if key == "t_s" else signal.not_finite())

    def _find_channels(self, table: Table) -> None:
        """Decide from the first table which columns are read."""
        names = tuple(name for name in CHANNELS if name != "time")
        required = self._request.required
        optional = self._request.optional
        for name in (*required, *optional):
            if name not in names:
                raise MappingError(
                    f"unknown channel {name!r}; channels are: {', '.join(names)}"
                )
        optional = optional if required or optional else names
        missing: list[Channel] = []
        for name in (*required, *optional):
            channel = CHANNELS[name]
            spec = self._request.mapping.channels.get(name)
            signal = _find_signal(table, channel, spec)
            is_wanted = name in required or spec is not None
            if signal is None:
                missing += [channel] * (name in required)
            elif is_wanted or np.isfinite(signal.read(table)[:HEAD_ROWS]).any():
                self._signals[channel.key] = signal
            else:
                what = "hold no finite value in the first rows and were left out"
                self._report((f"{name}: its columns {what}",))
        if missing:
            channel, *others = missing
            also = ", ".join(f"{other.name} ({other.meaning})" for other in others)
            raise ColumnError(
                f"no column found for {channel.name} ({channel.meaning}); usual names are "
                f"{', '.join(channel.spellings)}. Say which one {channel.where}. "
                f"{f'Nor for {also}. ' if also else ''}"
                f"Columns are: {table.describe()}{table.left_out()}"
            )
        if not self._signals:
            raise ColumnError(
                f"no channel was recognised. Columns are: {table.describe()}"
            )

    def _chunk(self, table: Table) -> Iterator[LogChunk]:
        values = {key: signal.read(table) for key, signal in self._signals.items()}
        rows = len(next(iter(values.values())))
        values["t_s"] = self._time_s(table, values, rows)
        if not self._rows:
            _check_sizes(values, self._signals)
        keep = np.isfinite(values["t_s"])
        if not keep.all():
            here = f"row {self._rows + int(np.argmin(keep)) + 1}"
            lost = int(np.count_nonzero(~keep))
            self._faults.note("time: rows without a stamp, left out", here, lost)
        kept = (
            values if keep.all() else {key: each[keep] for key, each in values.items()}
        )
        for key, signal in self._signals.items():
            signal.watch(kept[key])
        if not self._rows:
            self._report(
                chain(*(signal.hardly_si() for signal in self._signals.values()))
            )
        t_s = kept.pop("t_s")
        self._kept = self._kept + len(t_s)
        self._rows = self._rows + rows
        if len(t_s):
            yield LogChunk(t_s=t_s, dt_s=self._stamps.update(t_s), channels=kept)

    def _time_s(
        self, table: Table, values: Mapping[str, FloatArray], rows: int
    ) -> FloatArray:
        """Return stamps in s: of the mapping's rate, or those of a column."""
        rate_hz = self._request.mapping.rate_hz
        if rate_hz is not None:
            return np.arange(self._rows, self._rows + rows) / rate_hz
        found_s = values["t_s"]
        signal = self._signals["t_s"]
        if table.start_ns or signal.factors[0] * NS_PER_S != 1.0:
            return found_s
        raw = table.columns.get(signal.columns[0], found_s)
        # Whole nanoseconds too large for float64 are counted from the first, so that
        # none is lost.
        if not self._rows and raw.dtype.kind == "i":
            self._clock_ns = self.start_ns = start_of_clock(int(raw[0]))
        if raw.dtype.kind == "i" and self._clock_ns:
            return to_seconds(raw, self._clock_ns)
        return found_s - self._clock_ns / NS_PER_S

    def _report(self, warnings: Iterable[str]) -> None:
        self._found |= dict.fromkeys(warnings)

    def joined(self, max_bytes: int = MAX_BYTES) -> Log:
        """Return all rows as one log; `FormatError` if they take more bytes than
        allowed.
        """
        parts = list[dict[str, FloatArray]]()
        size = 0
        for chunk in self:
            parts.append({"t_s": chunk.t_s, **chunk.channels})
            size += sum(values.nbytes for values in parts[-1].values())
            require_size(size, max_bytes, "what is read of it")
        whole = {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}
        t_s = whole.pop("t_s")
        warnings = self.take_warnings()
        return Log(t_s=t_s, channels=whole, warnings=warnings, start_ns=self.start_ns)


def _check_sizes(
    values: Mapping[str, FloatArray], signals: Mapping[str, _Signal]
) -> None:
    shapes = {key: each.shape for key, each in values.items()}
    if len({shape[0] for shape in shapes.values()}) > 1:
        lengths = ", ".join(f"{key} {shape[0]}" for key, shape in shapes.items())
        turned = [
            f"; {key} has {shape[0]} rows of {shape[1]}: is it transposed?"
            for key, shape in shapes.items()
            if len(shape) == 2 and shape[0] < shape[1]
        ]
        raise LogError(
            f"channels differ in length, in rows: {lengths}{''.join(turned)}"
        )
    joints = {key: shape[1] for key, shape in shapes.items() if len(shape) == 2}
    if len(set(joints.values())) > 1:
        listed = "; ".join(
            f"{signals[key].channel.name} has {count} ({', '.join(signals[key].columns)})"
            for key, count in joints.items()
        )
        raise LogError(
            f"channels differ in the number of joints: {listed}. Name the columns of all joints, "
            "as in --q COLUMNS --tau COLUMNS, or in a mapping"
        )
