"""Which columns of a file are which channels: mappings in code, in TOML, as options."""

import sys
import tomllib
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import msgspec

from needleforce.recordings.channels import CHANNELS, Channel
from needleforce.recordings.errors import (
    FileAccessError,
    FormatError,
    MappingError,
    file_errors,
    readable_path,
)
from needleforce.recordings.units import find_unit

MAX_SORT_WITHIN_S = 3600.0
"""In a wider window too many rows would have to be held to be sorted."""

MAX_TOML_BYTES = 1 << 22
"""No mapping is longer; a file named by mistake may be."""

LEFT_OUT = "none"
"""Stands in place of a channel's columns if the channel is not to be read."""

_TOP_KEYS = frozenset(
    {"rate_hz", "joints", "reference_topic", "sort_within_s", "payload"}
)
"""What a mapping in TOML may have beside channels."""

_CHANNEL_KEYS = frozenset({"columns", "unit", "scale"})
"""What a channel in TOML may have."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ColumnSpec:
    """The columns of one channel.

    Attributes:
        columns: Name or pattern, as `q{1..7}` or `q_*`, or several, by joint; or
            `LEFT_OUT`.
        unit: In the file; None to take it from the column's name, else SI.
        scale: Factor for all columns, or one for each, applied after conversion to SI;
            a negative one turns a sign.
    """

    columns: str | tuple[str, ...]
    unit: str | None = None
    scale: float | tuple[float, ...] = 1.0

    def __post_init__(self) -> None:
        """Check the columns and the scale.

        Raises:
            MappingError: One is missing, or a scale is zero or not finite.
        """
        if not self.columns or not all(self.patterns):
            raise MappingError(f"columns = {self.columns!r} names no column")

        scales = self.scale if isinstance(self.scale, tuple) else (self.scale,)
        are_valid = (_is_finite(factor) and factor != 0.0 for factor in scales)
        if not scales or not all(are_valid):
            raise MappingError(
                f"scale = {self.scale!r:.60} must be finite and not zero"
            )

    @property
    def patterns(self) -> tuple[str, ...]:
        """The column names and patterns in order."""
        return (self.columns,) if isinstance(self.columns, str) else self.columns


def parse_column_spec(text: str, channel: Channel) -> ColumnSpec:
    """Read the short form of the command line: `NAMES[:UNIT][:SCALE]`, as in `fz:N:-1`.

    `NAMES` is a name, a pattern or a list separated by commas, `SCALE` a number or one
    for each column, likewise separated. What follows a colon
    counts as scale or unit only if it is one, since column names may hold colons
    themselves.

    Raises:
        MappingError: No column is named, or the scale is zero or not finite.
    """
    names = text
    unit = None
    scale: float | tuple[float, ...] = 1.0
    head, colon, tail = names.rpartition(":")
    if colon:
        with suppress(ValueError):
            scales = tuple(float(factor) for factor in tail.split(","))
            scale = scales[0] if len(scales) == 1 else scales
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
    """Columns for some or all channels; others are found by their usual names.

    Attributes:
        channels: Columns by keys of `CHANNELS`.
        rate_hz: Samples/s of a file without time stamps; it replaces a time column.
        joints: Names of the robot's joints in the recording, in its order, by which
            signals are found and put in order; or one pattern that they fit, `left_*`.
        reference_topic: Topic of a bag whose messages are the rows of the log.
        sort_within_s: Rows are sorted that come no later than this after newer ones;
            None for the usual time.
        payload: What hangs on the robot, for the command that needs to know it.
    """

    channels: Mapping[str, ColumnSpec] = field(default_factory=dict)
    rate_hz: float | None = None
    joints: str | tuple[str, ...] = ()
    reference_topic: str | None = None
    sort_within_s: float | None = None
    payload: Any = None

    @property
    def joint_pattern(self) -> str:
        """The pattern that the joints' names fit; empty without one."""
        return self.joints[0] if len(self.joints) == 1 and "*" in self.joints[0] else ""

    @property
    def joint_order(self) -> tuple[str, ...]:
        """The joints, each by name; none where a pattern stands for them."""
        return () if self.joint_pattern else tuple(self.joints)

    @property
    def left_out(self) -> frozenset[str]:
        """The channels that are not to be read, although the file may have them."""
        return frozenset(
            name for name, spec in self.channels.items() if spec.columns == LEFT_OUT
        )

    def __post_init__(self) -> None:
        """Check names, units and the rate, and write units as `CHANNELS` does.

        Raises:
            MappingError: One is not known, or they contradict each other.
        """
        sort_within_s = self.sort_within_s
        if sort_within_s is not None and not 0.0 <= sort_within_s <= MAX_SORT_WITHIN_S:
            raise MappingError(
                f"sort_within_s = {sort_within_s!r:.60} must be a time in s from 0 to "
                f"{MAX_SORT_WITHIN_S:g}"
            )

        if isinstance(self.joints, str):
            names = tuple(name.strip() for name in self.joints.split(","))
            object.__setattr__(self, "joints", names)

        channels = {
            name: _with_known_unit(name, spec) for name, spec in self.channels.items()
        }
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
                "both rate_hz and a time column are given, expected one of them"
            )


def _with_known_unit(name: str, spec: ColumnSpec) -> ColumnSpec:
    """Return a channel's columns with the unit as `CHANNELS` spells it.

    Raises:
        MappingError: The channel or its unit is not known.
    """
    if name not in CHANNELS:
        raise MappingError(
            f"unknown channel {name!r}; channels are: {', '.join(CHANNELS)}"
        )

    if spec.unit is None:
        return spec

    units = CHANNELS[name].units
    unit = find_unit(spec.unit, units)
    if unit is None:
        raise MappingError(
            f"unit {spec.unit!r} of channel {name!r} is not known, expected: "
            f"{', '.join(units)}"
        )

    return replace(spec, unit=unit)


def _is_finite(value: float) -> bool:
    """Return whether a number is finite; a whole one may exceed any float."""
    return abs(value) <= sys.float_info.max


def load_mapping(path: str | Path) -> ColumnMapping:
    """Read a column mapping from a TOML file.

    Each channel is a table with `columns` and, if needed, `unit` and `scale`, or just
    the columns (`depth = "z"`). At the top may stand `rate_hz`, `joints`,
    `reference_topic`, `sort_within_s` and `payload`, see `ColumnMapping`.

    Raises:
        FileAccessError: the file cannot be read.
        MappingError: it is not TOML, or a channel, key, unit or value in it is not
            valid.
    """
    entry_path = "$"  # as msgspec names a place in the file
    try:
        content = read_toml(path, "mapping")
        top = {name: content.pop(name) for name in _TOP_KEYS & content.keys()}
        mapping = msgspec.convert(top, ColumnMapping)
        channels: dict[str, ColumnSpec] = {}
        for name, entry in content.items():
            entry_path = f"$.{name}"
            channels[name] = _convert_channel(name, entry)

        return replace(mapping, channels=channels)
    except FormatError as error:
        raise MappingError(str(error)) from error
    except (msgspec.ValidationError, OverflowError) as error:
        message = str(error).replace("`$", f"`{entry_path}")
        if f"`{entry_path}" not in message:
            message += f" - at `{entry_path}`"

        raise MappingError(f"{path}: {message}") from error
    except MappingError as error:
        raise MappingError(f"{path}: {error}") from error


def _convert_channel(name: str, entry: Any) -> ColumnSpec:
    """Return a channel's columns from its entry in TOML: a table, or only columns."""
    spec = entry if isinstance(entry, dict) else {"columns": entry}
    if unknown := spec.keys() - _CHANNEL_KEYS:
        keys = ", ".join(map(repr, sorted(unknown)))
        raise MappingError(
            f"[{name}] has {keys}, expected only columns, unit and scale"
        )

    return msgspec.convert(spec, ColumnSpec)


def read_toml(path: str | Path, subject: str) -> dict[str, Any]:
    """Return the content of a TOML file, at least one key.

    Args:
        path: Of the file.
        subject: What it is, for messages.

    Raises:
        FileAccessError: It cannot be read.
        FormatError: It is not TOML, is empty, or is longer than `MAX_TOML_BYTES`.
    """
    try:
        with file_errors(path), readable_path(path).open("rb") as stream:
            data = stream.read(MAX_TOML_BYTES + 1)
    except FileAccessError as error:
        message = str(error).replace("cannot read", f"cannot read the {subject}")
        raise error.reworded(message) from error

    if len(data) > MAX_TOML_BYTES:
        raise FormatError(f"the {subject} {path} is longer than {MAX_TOML_BYTES} bytes")

    try:
        content = tomllib.loads(data.decode())
    except (ValueError, RecursionError) as error:
        raise FormatError(f"the {subject} {path} is not valid TOML: {error}") from error

    if not content:
        raise FormatError(f"the {subject} {path} is empty")

    return content
