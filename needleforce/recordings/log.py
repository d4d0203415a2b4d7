"""A log: channels in SI units, with one time stamp per row."""

import re
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from foundation.arrays import Array
from needleforce.recordings.channel_request import ChannelRequest
from needleforce.recordings.channel_units import ChannelUnit, advise_unit
from needleforce.recordings.channels import Channel
from needleforce.recordings.column_names import advise_column, columns_in_other_units
from needleforce.recordings.errors import (
    ColumnError,
    LogError,
    RecordingError,
    UnitError,
)
from needleforce.recordings.log_signal import (
    Signal,
    require_equal_sizes,
    velocity_warnings,
)
from needleforce.recordings.table import Table, ToolMass, read_only, tool_mass_in
from needleforce.recordings.time_stamps import (
    NS_PER_S,
    first_valid_stamp,
    rows_in_order,
    start_of_clock,
    to_seconds,
)

SORTED_WITHIN_S = 1.0
"""Rows of a file are sorted if they come no later than this after newer ones."""


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
        units: In which unit of the file each channel was read, and whence that is
            known.
        tool_mass: What the recording says hangs on the flange; None if it does not.
        left_out: Rows without a usable time stamp.
    """

    t_s: Array
    channels: Mapping[str, Array]
    warnings: tuple[str, ...] = ()
    start_ns: int = 0
    units: tuple[ChannelUnit, ...] = ()
    tool_mass: ToolMass | None = None
    left_out: int = 0

    def __post_init__(self) -> None:
        """Copy, freeze and check the data.

        Raises:
            LogError: There is no channel, something is no array of numbers of the right
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

        invalid_rows = np.flatnonzero(~np.isfinite(t_s))
        if invalid_rows.size:
            raise LogError(
                f"t_s: rows that are not finite: {invalid_rows.size} "
                f"(first: row {invalid_rows[0] + 1})"
            )

        for name, values in channels.items():
            if values.ndim not in (1, 2) or values.shape[0] != t_s.size:
                raise LogError(
                    f"{name} has shape {values.shape}; expected ({t_s.size},) or "
                    f"({t_s.size}, k), as t_s has {t_s.size} stamps"
                )

        object.__setattr__(self, "t_s", t_s)
        object.__setattr__(self, "channels", MappingProxyType(channels))

    def __len__(self) -> int:
        """Return the number of rows."""
        return self.t_s.size

    def __contains__(self, name: object) -> bool:
        """Return whether there is a channel of this name."""
        return name in self.channels

    def __getitem__(self, name: str) -> Array:
        """Return a channel's values; `ColumnError` if the log has no such channel."""
        if name in self.channels:
            return self.channels[name]

        raise ColumnError(
            f"the log has no channel {name!r}; it has: {', '.join(self.channels)}"
        )

    @property
    def dt_s(self) -> Array:
        """Time since the row before, infinite for the first, shape (n,)."""
        return np.diff(self.t_s, prepend=-np.inf)

    def parts(self, row_count: int = 1 << 14) -> Iterator["Log"]:
        """Yield consecutive rows, so many at a time; each overlaps no other."""
        for start in range(0, len(self), row_count):
            rows = slice(start, start + row_count)
            yield LogRows(
                t_s=self.t_s[rows],
                dt_s=self.dt_s[rows],
                channels={name: v[rows] for name, v in self.channels.items()},
            )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LogRows:
    """Consecutive rows of a log: stamps, time since the row before, and channels."""

    t_s: Array
    dt_s: Array
    channels: Mapping[str, Array]


def log_of_table(table: Table, request: ChannelRequest) -> Log:
    """Return the channels of a table in SI units, in the order of time.

    Raises:
        RecordingError: As `read_log` does.
    """
    request = request.with_layout(table)
    layout = request.find_layout(table)
    note = f"{layout.name}: {layout.note}" if layout and layout.note else ""
    try:
        signals, warnings = _find_channels(table, request)
    except RecordingError as error:  # the note may say why
        raise (error.reworded(f"{error}. {note}") if note else error) from error

    rate_hz = request.mapping.rate_hz
    time = None if rate_hz is not None else _find_time(table, request)
    measured = {"t_s": time, **signals} if time is not None else signals
    require_equal_sizes(table, measured)
    values = {key: signal.read(table) for key, signal in signals.items()}
    row_count = len(next(iter(values.values())))
    start_ns = table.start_ns
    if time is None:
        rows = np.arange(row_count)
        t_s = rows / rate_hz
        notes: list[str] = []
    else:
        stamps_s, start_ns = _time_s(table, time)
        within_s = request.mapping.sort_within_s
        rows, t_s, notes = rows_in_order(
            stamps_s,
            next(iter(values.values())),
            SORTED_WITHIN_S if within_s is None else within_s,
        )
        time.watch_step(t_s)

    channels = {key: array[rows] for key, array in values.items()}
    for key, signal in measured.items():
        if key != "t_s":
            signal.watch(channels[key], rows + 1)

        signal.require_plausible()

    return Log(
        t_s=t_s,
        channels=channels,
        start_ns=start_ns,
        units=tuple(signal.source for signal in measured.values()),
        tool_mass=table.tool_mass or tool_mass_in(table),
        left_out=row_count - len(rows),
        warnings=tuple(
            dict.fromkeys(
                (
                    *table.warnings,
                    *([note] if note else []),
                    *warnings,
                    *notes,
                    *(
                        w
                        for each in measured.values()
                        for w in each.report_implausible()
                    ),
                    *velocity_warnings(channels),
                    *(w for each in signals.values() for w in each.report_not_finite()),
                )
            )
        ),
    )


def _find_time(table: Table, request: ChannelRequest) -> Signal:
    """Find the column of time stamps; `ColumnError` if there is none."""
    time = request.channels["time"]
    columns = request.find(table, time)
    _require_whole_stamp(table, columns)
    if columns:
        return Signal(table, time, columns, request.mapping.channels.get("time"))
    if not table.has_header:
        raise _no_header([time], table, request)

    raise ColumnError(
        f"no time column found. Columns are: {table.describe()}{table.left_out()}",
        "Name it under `time` in the `mapping`, or give `rate_hz`.",
    )


def _require_whole_stamp(table: Table, chosen: Sequence[str]) -> None:
    """Refuse stamps of which seconds and their fraction stand in two columns.

    Args:
        table: Of the log.
        chosen: Columns of time that were found; none if there are none.

    Raises:
        ColumnError: Such a pair, and no other column of time.
    """
    for fraction in table.columns:
        match = re.fullmatch(r"(?i)(.*?)(n|nano|u|micro)s(ec(ond)?s?)?", fraction)
        if match is None:
            continue

        whole = rf"(?i){re.escape(match[1])}s(ec(ond)?s?)?"
        seconds = next(
            (name for name in table.columns if re.fullmatch(whole, name)), ""
        )
        if seconds and (not chosen or {seconds, fraction} & {*chosen}):
            factor = 1e-9 if match[2].lower().startswith("n") else 1e-6
            raise ColumnError(
                f"time: the stamp stands in two columns, {seconds!r} and "
                f"{fraction!r}; expected one",
                f"Write a column of their sum, {seconds} + {factor:g} * {fraction}, "
                "and name it as time.",
            )


def _find_channels(
    table: Table, request: ChannelRequest
) -> tuple[dict[str, Signal], list[str]]:
    """Return the signals by their key, and what was assumed of them."""
    signals: dict[str, Signal] = {}
    warnings: list[str] = []
    missing: list[Channel] = []
    by_joint: list[str] = []
    for name in request.requested:
        channel = request.channels[name]
        columns = request.find(table, channel)
        if columns and columns == request.find_by_joints(table, channel):
            by_joint.append(f"{name}: {columns[0]}, ...")
        if not columns:
            missing += [channel] if name in request.required else []
            continue

        spec = request.mapping.channels.get(name)
        signal = Signal(table, channel, columns, spec)
        head = signal.read(table)[:200]
        is_required = name in request.required
        if not is_required and len(head):
            _require_all_joints(channel, head)
        if is_required or spec is not None or np.isfinite(head).any():
            signals[channel.key] = signal
        else:
            warnings.append(
                f"{name}: its columns hold no finite value in the first rows and were "
                "left out"
            )

    _require_names(request.mapping.joint_pattern, table, by_joint)
    if missing or not signals:
        raise _not_found(missing, table, request)

    if by_joint:
        listed = "; ".join(by_joint)
        warnings.append(f"columns found by the names of the joints: {listed}")
    return signals, warnings


def _time_s(table: Table, time: Signal) -> tuple[Array, int]:
    """Return time stamps in s, shape (n,), and the instant in ns that they count from.

    Whole nanoseconds too large for float64 are counted from the first.
    """
    stamps = table.values(time.source.columns[0])
    if stamps.dtype.kind != "i" or table.start_ns or time.factors[0] * NS_PER_S != 1.0:
        return time.read(table), table.start_ns

    start_ns = start_of_clock(first_valid_stamp(stamps))
    return to_seconds(stamps, start_ns), start_ns


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
    """Return the error for required channels that no column is, or for no channel."""
    if not missing:
        return ColumnError(
            f"no channel was recognised. Columns are: {table.describe()}"
        )

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
