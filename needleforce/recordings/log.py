"""A log: channels in SI units, with one time stamp per row."""

import fnmatch
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import prod
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foundation.arrays import Array
from needleforce.recordings.channel_request import (
    ASSUMED,
    ChannelRequest,
    ChannelUnit,
    describe_columns,
)
from needleforce.recordings.channels import Channel
from needleforce.recordings.errors import (
    ColumnError,
    LogError,
    MappingError,
    UnitError,
)
from needleforce.recordings.table import Table
from needleforce.recordings.time_stamps import (
    NS_PER_S,
    OrderedRows,
    aligned,
    rows_in_order,
    start_of_clock,
    to_seconds,
    with_own_clocks,
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
        t_s = _read_only("t_s", self.t_s)
        channels = {
            name: _read_only(name, values) for name, values in self.channels.items()
        }
        if t_s.ndim != 1 or not t_s.size or not np.isfinite(t_s).all() or not channels:
            raise LogError(
                f"t_s, shape {t_s.shape}, and {list(channels)}: a log needs at least "
                "one channel, and time stamps that are finite, shape (n,), n > 0"
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


def _read_only(name: str, values: ArrayLike) -> Array:
    """Return a read-only copy as float64; `LogError` if values are no numbers."""
    try:
        copy = np.array(values, dtype=np.float64, order="C")
    except (TypeError, ValueError) as error:
        raise LogError(f"{name} is not an array of numbers: {error}") from error

    copy.setflags(write=False)
    return copy


def log_of_table(table: Table, request: ChannelRequest) -> Log:
    """Return the channels of a table in SI units, in the order of time.

    Raises:
        RecordingError: As `read_log` does.
    """
    request = request.with_layout(table)
    note = request.mapping.note
    try:
        found = _find_channels(table, request)
    except ColumnError as error:
        joints = ", ".join(request.robot)
        wanted = joints and f"The robot's joints are {joints}"
        text = ". ".join(filter(None, [str(error), note, wanted]))
        raise error.reworded(text) from error

    table, time = _with_time(table, request, found)
    notes = [*table.warnings, *filter(None, [note])]
    measured = _read_channels(table, request, found, notes)
    joint_counts = {key: v.shape[1] for key, v in measured.items() if v.ndim == 2}
    if len({*joint_counts.values()}) > 1:
        raise LogError(
            f"channels differ in their numbers of joints: {joint_counts}",
            "Name the columns of all joints under each channel of the `mapping`.",
        )

    first = next(iter(measured.values()))
    rows, t_s, said = ordered_rows(
        table.columns["t_s"], first, request.channels["time"], time
    )
    read = [found[name] for name in measured]
    channels = {request.channels[name].key: v[rows] for name, v in measured.items()}
    warnings = [*notes, *said, *_report_invalid(channels, rows)]
    return Log(
        t_s=t_s,
        channels=channels,
        start_ns=table.start_ns,
        units=tuple(unit for unit in (time, *read) if unit.columns),
        left_out=len(first) - len(rows),
        warnings=tuple(dict.fromkeys(warnings)),
    )


def _find_channels(table: Table, request: ChannelRequest) -> dict[str, ChannelUnit]:
    """Return channels by name.

    Raises:
        ColumnError: A required one is not there, or none; or no joint has a name that
            fits the pattern of the mapping.
    """
    found = request.find_all(table)
    missing = [request.channels[name] for name in request.required if name not in found]
    if missing:
        names = ", ".join(f"{each.name} ({each.meaning})" for each in missing)
        raise ColumnError(
            f"no column found for {names}; usual names of {missing[0].name} are "
            f"{', '.join(missing[0].spellings)}. Columns are: {table.describe()}"
            f"{table.left_out()}"
        )
    if not found:
        raise ColumnError(f"no channel was recognised. Columns are: {table.describe()}")

    pattern = request.mapping.joint_pattern
    columns = {column for unit in found.values() for column in unit.columns}
    if pattern and not table.joint_names and not fnmatch.filter(columns, pattern):
        raise ColumnError(
            f"joints = {pattern!r} chooses joints by name, and neither columns nor "
            "messages of the recording have names of joints; leave it out"
        )

    return found


def _with_time(
    table: Table, request: ChannelRequest, found: Mapping[str, ChannelUnit]
) -> tuple[Table, ChannelUnit]:
    """Return a table with one row for each time stamp, these in s as `t_s`.

    Returns:
        The table, and what the stamps were read from: no column where a rate is given.

    Raises:
        ColumnError: There is no time stamp.
        LogError: Columns differ in length.
    """
    columns = {name: unit.columns for name, unit in found.items()}
    used = [column for names in columns.values() for column in names]
    rate_hz = request.mapping.rate_hz
    time = ChannelUnit("time", ("t_s",), ("s",), ("format of the file",))
    if rate_hz is not None:
        time = ChannelUnit("time", (), (), ())
    elif not table.clocks:
        time = request.find_time(table)
        t_s, start_ns = read_times(table, request, time, used)
        timed = {**table.columns, "t_s": t_s}
        table = with_own_clocks(
            replace(table, start_ns=start_ns, columns=timed), columns
        )
    if table.clocks:
        # The rows are those of the torques or the force.
        usual = [found[name] for name in ("tau", "tau_ext", "force") if name in found]
        column, *_ = next(iter([*usual, *found.values()])).columns
        clock = table.clocks.get(column) or table.clocks[column.rpartition("[")[0]]
        table = aligned(table, clock)
    if rate_hz is not None:
        t_s = np.arange(count_rows(table, used)) / rate_hz
        table = replace(table, columns={**table.columns, "t_s": t_s})

    return table, time


def count_rows(table: Table, names: Iterable[str]) -> int:
    """Return how many rows columns have; `LogError` if one has more or fewer."""
    counts = {name: len(table.values(name)) for name in names}
    first, *_ = counts
    if odd := {n: count for n, count in counts.items() if count != counts[first]}:
        raise LogError(
            f"columns have other numbers of rows than {first}, {counts[first]}: {odd}"
        )

    return counts[first]


def read_times(
    table: Table, request: ChannelRequest, unit: ChannelUnit, columns: Iterable[str]
) -> tuple[Array, int]:
    """Return time stamps in s, shape (n,), and the instant in ns that they count from.

    Whole nanoseconds too large for float64, and sums of columns, are counted from the
    first.

    Args:
        table: The columns.
        request: Knows the units.
        unit: The column of the time stamps, or those whose sum they are.
        columns: Names of those that have the stamps.

    Raises:
        LogError: A column has more or fewer rows than there are stamps.
    """
    count_rows(table, [*unit.columns, *columns])
    channel = request.channels["time"]
    stamps = [table.values(name) for name in unit.columns]
    factors = [channel.units[each] * NS_PER_S for each in unit.units]
    if len(stamps) > 1:
        terms = zip(stamps, factors, strict=True)
        parts_ns = np.array([values * factor for values, factor in terms])
        known = np.isfinite(parts_ns).all(axis=0)
        stamps_ns = np.rint(parts_ns[:, known]).astype(np.int64).sum(axis=0)
    elif stamps[0].dtype.kind in "iu" and factors == [1.0] and unit.scale == 1.0:
        known = np.full(len(stamps[0]), fill_value=True)
        stamps_ns = stamps[0].astype(np.int64) + table.start_ns
    else:
        return _values_in_si(stamps, channel, unit), table.start_ns

    start_ns = start_of_clock(stamps_ns)
    t_s = np.full(known.shape, np.nan)
    t_s[known] = to_seconds(stamps_ns, start_ns)
    return t_s, start_ns


def ordered_rows(
    t_s: Array, values: Array, channel: Channel, unit: ChannelUnit
) -> OrderedRows:
    """Return rows in the order of time, as `rows_in_order` does.

    Raises:
        LogError: Stamps do not tell the times of the samples.
        UnitError: They lie so far apart that the unit that was assumed is wrong.
    """
    ordered = rows_in_order(t_s, values)
    _check_sizes(channel, unit, np.median(np.diff(ordered.t_s), keepdims=True))
    return ordered


def _read_channels(
    table: Table,
    request: ChannelRequest,
    found: Mapping[str, ChannelUnit],
    notes: list[str],
) -> dict[str, Array]:
    """Return channels in SI units by name; notes on what is odd are added.

    Raises:
        LogError: A required or mapped channel has a column without a finite value.
        UnitError: Values are too large for a unit that was assumed.
    """
    measured: dict[str, Array] = {}
    for name, unit in found.items():
        channel = request.channels[name]
        raw = [table.values(column) for column in unit.columns]
        for number in request.mapping.knowledge.missing_values:
            with_number = [values for values in raw if (values == number).any()]
            if any(_is_far_outside(values, number) for values in with_number):
                notes.append(f"{name}: {number:g}, far from all else, is no value")
                raw = [np.where(values == number, np.nan, values) for values in raw]
            elif with_number:
                notes.append(
                    f"{name}: {number:g} was kept as a number; many loggers write it "
                    "where a value is missing"
                )

        values = _values_in_si(raw, channel, unit)
        is_known = np.isfinite(values).any(axis=0)
        if is_known.all() or not len(values):
            notes += _check_sizes(channel, unit, np.abs(values))
            measured[name] = values
            continue

        joints = ", ".join(str(i + 1) for i in np.flatnonzero(~is_known).tolist())
        place = f" at joint {joints}" if is_known.any() else ""
        fault = f"{channel.key} has no finite value{place} in {len(values)} rows"
        if name in (*request.required, *request.mapping.channels):
            raise LogError(fault)

        notes.append(f"{fault} and was left out")

    return measured


def _is_far_outside(values: Array, number: float) -> bool:
    """Return whether a number is further from all others than most of these spread.

    So far lies what a logger writes where it has no value; a force or a depth that
    really has such a value passes through those between.
    """
    others = values[np.isfinite(values) & (values != number)]
    # What lies beyond nine tenths may be spikes.
    spread = np.ptp(np.quantile(others, (0.05, 0.95))) if others.size else 0.0
    return bool(np.abs(others - number).min(initial=np.inf) > spread)


def _values_in_si(
    columns: Sequence[np.ndarray], channel: Channel, unit: ChannelUnit
) -> Array:
    """Return a channel in SI units, shape (n,) or (n, joints).

    Args:
        columns: Values in the file, shape (n,) or (n, k) each.
        channel: The channel.
        unit: The units of the columns.

    Raises:
        ColumnError: There are too many columns.
        MappingError: There are more or fewer scale factors than columns.
    """
    values = np.column_stack(columns)
    width = values.shape[1]
    if width != 1 and not channel.per_joint:
        listed = ", ".join(unit.columns)
        raise ColumnError(f"{channel.name} is one column, but {listed} are {width}")

    scales = np.atleast_1d(np.array(unit.scale, dtype=np.float64))
    if scales.size not in (1, width):
        raise MappingError(
            f"{channel.name}: {scales.size} scale factors for {width} columns, "
            "expected one for all or one for each"
        )

    widths = [prod(each.shape[1:]) for each in columns]
    to_si = np.repeat([channel.units[each] for each in unit.units], widths)
    values = values * (to_si * scales)
    return values if channel.per_joint else values[:, 0]


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
    if ASSUMED not in unit.origins:
        return []

    sizes = np.nan_to_num(sizes, posinf=0.0)
    largest = sizes.max(initial=0.0)
    size = f"is up to {largest:.4g} {channel.units.si}"
    names = describe_columns(unit.columns)
    # A needle that meets tissue feels more [N]; a file in kN holds such numbers.
    if channel.key == "force_N" and 0.0 < largest < 0.05:
        return [f"force: {names} {size}; the file states no unit, and may be in kN"]

    is_large = (sizes > channel.at_most).reshape(len(sizes), -1).any(axis=1)
    large_count = np.count_nonzero(is_large)
    text = f"{channel.name}: {names} {size}, expected at most {channel.at_most:.3g}"
    if large_count > 0.05 * len(sizes):  # fewer may be spikes
        raise UnitError(
            f"{text}. The file states no unit of {', '.join(channel.units)}"
        )

    return [f"{text}; rows beyond it: {large_count}"] if large_count else []


def _report_invalid(channels: Mapping[str, Array], rows: NDArray[np.intp]) -> list[str]:
    """Return a note on each channel that has rows which are not finite.

    Args:
        channels: By key, shape (n,) or (n, joints).
        rows: Their numbers in the file, from 0, shape (n,).
    """
    notes: list[str] = []
    for key, values in channels.items():
        is_finite = np.isfinite(values).reshape(len(rows), -1).all(axis=1)
        if not is_finite.all():
            row = rows[np.argmin(is_finite)] + 1
            count = np.count_nonzero(~is_finite)
            notes.append(
                f"{key}: rows with NaN or infinity: {count} (first: row {row})"
            )

    return notes
