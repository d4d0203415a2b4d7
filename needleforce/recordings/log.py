"""A log: channels in SI units, with one time stamp per row."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from foundation.arrays import Array
from needleforce.recordings.channel_request import ChannelRequest
from needleforce.recordings.channel_units import (
    ASSUMED,
    ChannelUnit,
    advise_unit,
    describe_columns,
    unit_of_column,
)
from needleforce.recordings.channels import Channel
from needleforce.recordings.column_names import advise_column
from needleforce.recordings.errors import (
    ColumnError,
    LogError,
    MappingError,
    RecordingError,
    UnitError,
)
from needleforce.recordings.mapping import ColumnSpec
from needleforce.recordings.table import Table, read_only
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
        left_out: Rows without a usable time stamp.
    """

    t_s: Array
    channels: Mapping[str, Array]
    warnings: tuple[str, ...] = ()
    start_ns: int = 0
    units: tuple[ChannelUnit, ...] = ()
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

    def parts(self, row_count: int = 1 << 14) -> Iterator["LogRows"]:
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
        found, notes = _find_channels(table, request)
    except RecordingError as error:  # the note may say why
        raise (error.reworded(f"{error}. {note}") if note else error) from error

    units: dict[str, ChannelUnit] = {}
    measured: dict[str, Array] = {}
    start_ns = table.start_ns
    if request.mapping.rate_hz is None:
        columns = _find_time(table, request)
        units["time"] = _units_of(table, request, "time", columns)
        measured["t_s"], start_ns = _time_s(table, request, units["time"])

    for name, columns in found.items():
        channel = request.channels[name]
        units[name] = _units_of(table, request, name, columns)
        values = _values_of(table, channel, units[name])
        if _is_used(channel, values, request):
            measured[channel.key] = values
        else:
            del units[name]
            notes.append(f"{name}: its columns hold no finite value and were left out")

    _require_equal_sizes(measured)
    t_s = measured.pop("t_s", None)
    first = next(iter(measured.values()))
    rows = np.arange(len(first))
    if t_s is None:
        t_s = rows / (request.mapping.rate_hz or 1.0)
    else:
        within_s = request.mapping.sort_within_s
        within_s = SORTED_WITHIN_S if within_s is None else within_s
        rows, t_s, time_notes = rows_in_order(t_s, first, within_s)
        notes += time_notes

    channels = {key: values[rows] for key, values in measured.items()}
    for name, unit in units.items():
        channel = request.channels[name]
        is_time = name == "time"
        sizes = (
            np.median(np.diff(t_s), keepdims=True) if is_time else channels[channel.key]
        )
        notes += _check_sizes(channel, unit, np.abs(sizes))

    for key, values in channels.items():
        notes += _report_invalid(key, values, rows)

    return Log(
        t_s=t_s,
        channels=channels,
        start_ns=start_ns,
        units=tuple(units.values()),
        left_out=len(first) - len(rows),
        warnings=tuple(
            dict.fromkeys((*table.warnings, *([note] * bool(note)), *notes))
        ),
    )


def _find_channels(
    table: Table, request: ChannelRequest
) -> tuple[dict[str, list[str]], list[str]]:
    """Return columns by channel, and what was assumed of them."""
    found: dict[str, list[str]] = {}
    by_joint: list[str] = []
    for name in request.requested:
        channel = request.channels[name]
        if columns := request.find(table, channel):
            found[name] = columns
            if columns == request.find_by_joints(table, channel):
                by_joint.append(f"{name}: {columns[0]}, ...")

    pattern = request.mapping.joint_pattern
    if pattern and not by_joint and not table.joint_names:
        raise ColumnError(
            f"joints = {pattern!r} chooses joints by name, and neither columns nor "
            "messages of the recording have names of joints; leave it out"
        )

    missing = [request.channels[name] for name in request.required if name not in found]
    if not found and not missing:
        raise ColumnError(f"no channel was recognised. Columns are: {table.describe()}")
    for channel in missing:
        names = ", ".join(f"{each.name} ({each.meaning})" for each in missing)
        raise ColumnError(
            f"no column found for {names}; usual names of {channel.name} are "
            f"{', '.join(channel.spellings)}. Columns are: {table.describe()}"
            f"{table.left_out()}",
            advise_column(channel),
        )

    listed = "; ".join(by_joint)
    return found, [f"columns found by the names of the joints: {listed}"] * bool(
        by_joint
    )


def _find_time(table: Table, request: ChannelRequest) -> list[str]:
    """Return the column of time stamps.

    Raises:
        ColumnError: There is none, or seconds and their fraction stand in two.
    """
    columns = request.find(table, request.channels["time"])
    for fraction in table.columns:
        match = re.fullmatch(r"(?i)(.*?)(n|nano|u|micro)s(ec(ond)?s?)?", fraction)
        whole = rf"(?i){re.escape(match[1])}s(ec(ond)?s?)?" if match else "(?!)"
        seconds = next(filter(re.compile(whole).fullmatch, table.columns), "")
        if match and seconds and (not columns or {seconds, fraction} & {*columns}):
            factor = 1e-9 if match[2].lower().startswith("n") else 1e-6
            raise ColumnError(
                f"time: the stamp stands in two columns, {seconds!r} and "
                f"{fraction!r}; expected one",
                f"Write a column of their sum, {seconds} + {factor:g} * {fraction}, "
                "and name it as time.",
            )

    if not columns:
        raise ColumnError(
            f"no time column found. Columns are: {table.describe()}{table.left_out()}",
            "Name it under `time` in the `mapping`, or give `rate_hz`.",
        )

    return columns


def _units_of(
    table: Table, request: ChannelRequest, name: str, columns: Sequence[str]
) -> ChannelUnit:
    """Return in which unit each column of a channel is read; raises `UnitError`."""
    spec = request.mapping.channels.get(name) or ColumnSpec(columns=tuple(columns))
    channel = request.channels[name]
    found = [unit_of_column(table, channel, each, spec) for each in columns]
    units, origins = zip(*found, strict=True)
    return ChannelUnit(name, tuple(columns), units, origins, spec.scale)


def _values_of(table: Table, channel: Channel, unit: ChannelUnit) -> Array:
    """Return a channel in SI units, shape (n,) or (n, joints).

    Raises:
        ColumnError: There are too many columns.
        LogError: They differ in length.
        MappingError: There are more or fewer scale factors than columns.
    """
    listed = ", ".join(unit.columns)
    columns = [table.values(name) for name in unit.columns]
    widths = [table.width(name) for name in unit.columns]
    if len({len(values) for values in columns}) > 1:
        raise LogError(f"{channel.name}: the columns {listed} differ in length")
    if sum(widths) != 1 and not channel.per_joint:
        raise ColumnError(
            f"{channel.name} is one column, but {listed} are {sum(widths)}"
        )

    scales = np.atleast_1d(np.array(unit.scale, dtype=np.float64))
    if scales.size not in (1, sum(widths)):
        raise MappingError(
            f"{channel.name}: {scales.size} scale factors for {sum(widths)} columns, "
            "expected one for all or one for each"
        )

    to_si = [channel.units[each] for each in unit.units]
    values = np.column_stack(columns) * (np.repeat(to_si, widths) * scales)
    return values if channel.per_joint else values[:, 0]


def _time_s(
    table: Table, request: ChannelRequest, unit: ChannelUnit
) -> tuple[Array, int]:
    """Return time stamps in s, shape (n,), and the instant in ns that they count from.

    Whole nanoseconds too large for float64 are counted from the first.
    """
    channel = request.channels["time"]
    stamps = table.values(unit.columns[0])
    is_ns = channel.units[unit.units[0]] * NS_PER_S == 1.0 and unit.scale == 1.0
    if stamps.dtype.kind != "i" or table.start_ns or not is_ns:
        return _values_of(table, channel, unit), table.start_ns

    start_ns = start_of_clock(first_valid_stamp(stamps))
    return to_seconds(stamps, start_ns), start_ns


def _is_used(channel: Channel, values: Array, request: ChannelRequest) -> bool:
    """Return whether a channel is required, mapped, or holds values.

    Raises:
        ColumnError: Some joints of a channel that is not required have no value: every
            row would be rejected.
        LogError: A required or mapped channel has no finite value.
    """
    is_known = np.isfinite(values).any(axis=0)
    is_needed = channel.name in (*request.required, *request.mapping.channels)
    if is_needed and len(values) and not is_known.any():
        raise LogError(f"{channel.key} has no finite value in {len(values)} rows")
    if channel.name not in request.required and is_known.any() and not is_known.all():
        numbers = ", ".join(str(i + 1) for i in np.flatnonzero(~is_known).tolist())
        raise ColumnError(
            f"{channel.name} has no finite value at joint {numbers}",
            "Leave it out with `ColumnSpec(columns=LEFT_OUT)` under "
            f"`{channel.name}` in the `mapping`, or name its columns there.",
        )

    return is_needed or bool(is_known.any())


def _require_equal_sizes(measured: Mapping[str, Array]) -> None:
    """Raise `LogError` if channels differ in length, or in the number of joints."""
    shapes = {key: values.shape for key, values in measured.items()}
    lengths = {shape[0] for shape in shapes.values()}
    joint_counts = {shape[1] for shape in shapes.values() if len(shape) == 2}
    if len(lengths) > 1 or len(joint_counts) > 1:
        listed = ", ".join(f"{key} {shape}" for key, shape in shapes.items())
        raise LogError(
            f"channels differ in their numbers of rows or joints: {listed}",
            "Name the columns of all joints under each channel of the `mapping`.",
        )


def _check_sizes(channel: Channel, unit: ChannelUnit, sizes: Array) -> list[str]:
    """Check that values can be in a unit that was assumed.

    Args:
        channel: The channel.
        unit: In which it was read.
        sizes: Of the values, shape (n,) or (n, joints); of time the median step.

    Returns:
        A note on values that are too large and few enough to be spikes, or too small.

    Raises:
        UnitError: More rows than spikes would be are too large for the unit.
    """
    max_fraction = 0.05  # fewer may be spikes
    if ASSUMED not in unit.origins:
        return []

    largest = np.nan_to_num(sizes, posinf=0.0).reshape(len(sizes), -1).max(axis=1)
    large_count = np.count_nonzero(largest > channel.at_most)
    size = f"is up to {largest.max():.4g} {channel.si_unit}"
    names = describe_columns(unit.columns)
    # A needle that meets tissue feels more [N]; a file in kN holds such numbers.
    if channel.key == "force_N" and 0.0 < largest.max() < 0.05:
        return [f"force: {names} {size}; the file states no unit, and may be in kN"]
    if not large_count:
        return []

    quantity = "median step" if channel.key == "t_s" else "size"
    text = (
        f"{channel.name}: the {quantity} of {names} {size}, expected at most "
        f"{channel.at_most:.3g}"
    )
    if large_count > max_fraction * len(sizes):
        listed = ", ".join(channel.units)
        raise UnitError(
            f"{text}. The file states no unit of {listed}",
            advise_unit(channel, unit.columns),
        )

    return [f"{text}; rows beyond it: {large_count}"]


def _report_invalid(key: str, values: Array, rows: NDArray[np.intp]) -> list[str]:
    """Return a note on rows that are not finite, or nothing.

    Args:
        key: Of the channel.
        values: Of it, shape (n,) or (n, joints).
        rows: Their numbers in the file, from 0, shape (n,).
    """
    is_finite = np.isfinite(values).reshape(len(rows), -1).all(axis=1)
    if is_finite.all():
        return []

    first = rows[np.argmin(is_finite)] + 1
    count = np.count_nonzero(~is_finite)
    return [f"{key}: rows with NaN or infinity: {count} (first: row {first})"]
