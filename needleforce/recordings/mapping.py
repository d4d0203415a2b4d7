"""Which columns of a file are which channels of a log: mappings in code, in TOML, as
options.
"""

import json
import sys
import tomllib
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import msgspec

from needleforce.recordings.channels import (
    CHANNELS,
    Channel,
    Found,
    detect_columns,
    find_columns,
    find_unit,
    parse_column_name,
)
from needleforce.recordings.errors import (
    ColumnError,
    FileAccessError,
    FormatError,
    MappingError,
    file_errors,
    readable_path,
)
from needleforce.recordings.table import Table

_LONGEST_TOML = 1 << 22  # bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class ColumnSpec:
    """The columns of one channel.

    The scale, one for all columns or one each, is applied after conversion to SI; a
    negative one turns a sign.

    Attributes:
        columns: Name or pattern, as `q{1..7}` or `q_*`, or several, by joint.
    """

    columns: str | tuple[str, ...]
    unit: str | None = (
        None  # in the file; None to take it from the column's name, else SI
    )
    scale: float | tuple[float, ...] = 1.0

    def __post_init__(self) -> None:
        """Check columns and scale; `MappingError` if one is missing, zero or not
        finite.
        """
        if not self.columns or not all(self.patterns):
            raise MappingError(f"columns = {self.columns!r} names no column")
        scales = self.scale if isinstance(self.scale, tuple) else (self.scale,)
        if not scales or not all(
            _is_finite(factor) and factor != 0.0 for factor in scales
        ):
            raise MappingError(
                f"scale = {self.scale!r:.60} must be finite and not zero"
            )

    @property
    def patterns(self) -> tuple[str, ...]:
        """The column names and patterns in order."""
        return (self.columns,) if isinstance(self.columns, str) else self.columns


def parse_column_spec(text: str, channel: Channel) -> ColumnSpec:
    """Read the short form of the command line: `NAMES[:UNIT][:SCALE]`, as in `fz:N:-1`.

    `NAMES` is a name, a pattern or a list separated by commas. What follows a colon
    counts as scale or unit only if it is one, since column names may hold colons
    themselves. `MappingError` if no column is named, or the scale is zero or not
    finite.
    """
    names = text
    unit = None
    scale = 1.0
    head, colon, tail = names.rpartition(":")
    if colon:
        with suppress(ValueError):
            scale = float(tail)
            names = head
    head, colon, tail = names.rpartition(":")
    if colon and (unit := find_unit(tail, channel.units)):
        names = head
    columns = tuple(name.strip() for name in names.split(","))
    return ColumnSpec(
        columns=columns[0] if len(columns) == 1 else columns, unit=unit, scale=scale
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class ColumnMapping:
    """Columns for some or all channels; channels not listed are found by their usual
    names.

    The last three are for a bag, whose joint signals are put into the order of `joints`
    by name, and for the command that needs to know what hangs on the robot.

    Attributes:
        channels: By keys of `CHANNELS`.
        joints: The robot's, in its order.
        reference_topic: Whose messages are the rows of the log.
    """

    channels: Mapping[str, ColumnSpec] = field(default_factory=dict)
    rate_hz: float | None = (
        None  # of a file without time stamps; it replaces a time column
    )
    joints: tuple[str, ...] = ()
    reference_topic: str | None = None
    payload: Any = None

    def __post_init__(self) -> None:
        """Check names, units and the rate; `MappingError` if they contradict each
        other.
        """
        channels = {}
        for name, spec in self.channels.items():
            if name not in CHANNELS:
                raise MappingError(
                    f"unknown channel {name!r}; channels are: {', '.join(CHANNELS)}"
                )
            units = CHANNELS[name].units
            unit = spec.unit
            known = None if unit is None else find_unit(unit, units)
            if known is None and unit is not None:
                listed = ", ".join(units)
                raise MappingError(
                    f"unit {unit!r} of channel {name!r} is not known; use one of: {listed}"
                )
            channels[name] = replace(spec, unit=known)
        object.__setattr__(self, "channels", MappingProxyType(channels))
        if len(set(self.joints)) < len(self.joints):
            raise MappingError(f"joints = {list(self.joints)} names a joint twice")
        if self.rate_hz is None:
            return
        if not (_is_finite(self.rate_hz) and self.rate_hz > 0.0):
            raise MappingError(
                f"rate_hz = {self.rate_hz!r:.60} must be a positive number of samples/s"
            )
        if "time" in channels:
            raise MappingError(
                "both rate_hz and a time column are given; keep one of them"
            )


def _is_finite(value: float) -> bool:
    # A whole number may be larger than any float.
    return abs(value) <= sys.float_info.max


def load_mapping(path: str | Path) -> ColumnMapping:
    """Read a column mapping from a TOML file.

    Each channel is a table with `columns` and, if needed, `unit` and `scale`, or just
    the columns (`depth = "z"`). At the top may stand `rate_hz`, `joints`,
    `reference_topic` and `payload`, see `ColumnMapping`.

    Raises:
        FileAccessError: the file cannot be read.
        MappingError: it is not TOML, or a channel, key, unit or value in it is not
            valid.
    """
    place = "$"
    try:
        content = read_toml(path, "mapping")
        names = {"rate_hz", "joints", "reference_topic", "payload"} & content.keys()
        mapping = msgspec.convert(
            {name: content.pop(name) for name in names}, ColumnMapping
        )
        channels: dict[str, ColumnSpec] = {}
        for name, entry in content.items():
            place = f"$.{name}"
            spec = entry if isinstance(entry, dict) else {"columns": entry}
            if unknown := spec.keys() - {"columns", "unit", "scale"}:
                keys = ", ".join(map(repr, sorted(unknown)))
                raise MappingError(
                    f"[{name}] has {keys}; a channel has columns, unit and scale"
                )
            channels[name] = msgspec.convert(spec, ColumnSpec)
        return replace(mapping, channels=channels)
    except FormatError as error:
        raise MappingError(str(error)) from error
    except (msgspec.ValidationError, OverflowError) as error:
        what = str(error).replace("`$", f"`{place}")
        what += "" if f"`{place}" in what else f" - at `{place}`"
        raise MappingError(
            f"{path}: {what}; a channel has columns, unit and scale"
        ) from error
    except MappingError as error:
        raise MappingError(f"{path}: {error}") from error


def read_toml(path: str | Path, what: str) -> dict[str, Any]:
    """Return the content of a TOML file, at least one key; `what` it is stands in
    messages.

    `FileAccessError` if it cannot be read, `FormatError` if it is not TOML, or is
    empty.
    """
    try:
        with file_errors(path), readable_path(path).open("rb") as stream:
            data = stream.read(_LONGEST_TOML + 1)
    except FileAccessError as error:
        message = str(error).replace("cannot read", f"cannot read the {what}")
        raise FileAccessError(message) from error
    if len(data) > _LONGEST_TOML:
        raise FormatError(f"the {what} {path} is longer than {_LONGEST_TOML} bytes")
    try:
        content = tomllib.loads(data.decode())
    except (ValueError, RecursionError) as error:
        raise FormatError(f"the {what} {path} is not valid TOML: {error}") from error
    if not content:
        raise FormatError(f"the {what} {path} is empty")
    return content


@dataclass(frozen=True, slots=True)
class ChannelRequest:
    """Channels, and which columns they are, see `read_log`; a bag is read only for
    that.

    A recording that has all of the robot's joints by name is put into their order, or
    into that of `mapping.joints`, if it has some.
    """

    mapping: ColumnMapping = field(default_factory=ColumnMapping)
    required: tuple[str, ...] = ()
    optional: tuple[str, ...] = ()
    joints: tuple[str, ...] = ()

    def columns(self, table: Table) -> frozenset[str] | None:
        """Return the names of the columns that the channels need; values are not looked
        at.

        None if a required channel is not there; `ColumnError` if a mapped channel was
        not found, or is ambiguous.
        """
        names = (*self.required, *self.optional) or tuple(CHANNELS)
        needed: set[str] = set()
        mapped = [name for name in (*names, "time") if name in self.mapping.channels]
        # Mapped channels first: the topics they choose decide where others would be
        # ambiguous.
        for name in dict.fromkeys((*mapped, *names)):
            if (spec := self.mapping.channels.get(name)) is not None:
                found = channel_columns(table, CHANNELS[name], spec)
            else:
                found = self._detected(table, name, needed)
            if not found and name in self.required:
                return None
            # An element such as `force_xyz[2]` is found under its own name.
            needed |= {
                c if c in table.columns else c.rpartition("[")[0] for c, _ in found
            }
        return frozenset(needed)

    def _detected(self, table: Table, name: str, chosen: set[str]) -> Found:
        """Find a channel by usual names: of several one beside chosen columns, else
        by joints.
        """
        try:
            return detect_columns(table, CHANNELS[name])
        except ColumnError:
            parents = {column.rpartition("/")[0] for column in chosen}
            beside = {
                n: v
                for n, v in table.columns.items()
                if n.rpartition("/")[0] in parents
            }
            joints = {*(self.mapping.joints or self.joints)}
            if not beside and joints:
                named = table.joint_names
                beside = {n: table.columns[n] for n in named if joints <= set(named[n])}
            if beside and (
                found := detect_columns(Table(columns=beside), CHANNELS[name])
            ):
                return found
            raise


def channel_columns(table: Table, channel: Channel, spec: ColumnSpec | None) -> Found:
    """Return the columns that a specification names, else those of usual names;
    `ColumnError`.
    """
    if spec is None:
        return detect_columns(table, channel)
    return [
        column for pattern in spec.patterns for column in find_columns(table, pattern)
    ]


def mapping_text(
    table: Table, channels: Iterable[str], known: ColumnMapping
) -> list[str]:
    """Return a table's mapping as lines of TOML; the known one stays, unused columns
    are named.
    """
    lines: list[str] = []
    used: set[str] = set()
    for name in channels:
        lines += [
            *_channel_text(table, CHANNELS[name], known.channels.get(name), used),
            "",
        ]
    if left := [name for name in table.columns if name not in used]:
        lines.append("# Columns that are not used:")
        for name in left:
            values = table.columns[name]
            span = f"[0] to [{values.shape[1] - 1}]" if values.ndim == 2 else ""
            lines.append(comment_line(f"  {name}{span}"))
        lines.append("")
    return lines


def comment_line(text: str) -> str:
    """Return a comment for TOML; names in it come from files and must not end its
    line.
    """
    return "# " + "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


def _channel_text(
    table: Table, channel: Channel, spec: ColumnSpec | None, used: set[str]
) -> list[str]:
    reason = f"not found; {channel.meaning}"
    try:
        found = channel_columns(table, channel, spec)
    except ColumnError as error:
        if spec is not None:
            raise
        found = []
        reason = " ".join(str(error).split(";")[0].split())
    if not found:
        lines = [f"[{channel.name}]", 'columns = ""', f'unit = "{channel.si_unit}"']
        return [comment_line(reason), *(f"# {line}" for line in lines)]
    names = [name for name, _ in found]
    used |= set(names)
    units = {
        (spec and spec.unit) or parse_column_name(name, channel.units).unit
        for name in names
    }
    unit = units.pop() if len(units) == 1 else None
    of = f"{'of' if unit else 'assumed; of'} {', '.join(channel.units)}"
    unit_line = f"unit = {json.dumps(unit or channel.si_unit)}  # {of}"
    return [
        f"[{channel.name}]  # {channel.meaning}",
        f"columns = {json.dumps(names[0] if len(names) == 1 else names)}",
        "# No unit for all: they are those of the names." if units else unit_line,
        f"scale = {json.dumps(spec.scale if spec else 1.0)}  # -1.0 turns the sign"
        + (", or one for each joint" * channel.per_joint),
    ]
