"""Which columns of a file are which channels: mappings in code, in TOML, as options."""

import sys
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import msgspec

from needleforce.recordings.channels import (
    KNOWLEDGE,
    Channel,
    Knowledge,
    Layout,
    load_knowledge,
    read_toml,
)
from needleforce.recordings.errors import FormatError, MappingError

LEFT_OUT = "none"
"""Stands in place of a channel's columns if the channel is not to be read."""


class ColumnSpec(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The columns of one channel.

    Attributes:
        columns: Name or pattern, as `q{1..7}` or `q_*`, or several, by joint; or
            `LEFT_OUT`.
        unit: In the file, of all columns or of each; None to take it from the column's
            name, else SI.
        scale: Factor for all columns, or one for each, applied after conversion to SI;
            a negative one turns a sign.
    """

    columns: str | tuple[str, ...]
    unit: str | tuple[str, ...] | None = None
    scale: float | tuple[float, ...] = 1.0

    def __post_init__(self) -> None:
        """Raise `MappingError` if a column is missing, or a scale is no factor."""
        if not self.columns or not all(self.patterns):
            raise MappingError(f"columns = {self.columns!r} names no column")

        scales = self.scale if isinstance(self.scale, tuple) else (self.scale,)
        # A whole number may exceed floats.
        if not scales or not all(0.0 < abs(s) <= sys.float_info.max for s in scales):
            raise MappingError(
                f"scale = {self.scale!r:.60} must be finite and not zero"
            )

    @property
    def patterns(self) -> tuple[str, ...]:
        """The column names and patterns in order."""
        return (self.columns,) if isinstance(self.columns, str) else self.columns


def parse_column_spec(text: str, channel: Channel) -> ColumnSpec:
    """Read the short form: `NAMES[:UNIT][:SCALE]`, as in `fz:N:-1`.

    `NAMES` is a name, a pattern or a list separated by commas, `SCALE` a number or one
    for each column, likewise separated. What follows a colon counts as scale or unit
    only if it is one, since column names may hold colons themselves. Time stamps may be
    a sum, as in `sec:s+nanosec:ns`.

    Raises:
        MappingError: No column is named, or the scale is zero or not finite.
    """
    if channel.name == "time" and "+" in text:
        terms = [parse_column_spec(term, channel) for term in text.split("+")]
        columns = tuple(name for term in terms for name in term.patterns)
        return ColumnSpec(
            columns=columns, unit=tuple(str(term.unit or "s") for term in terms)
        )

    unit = None
    scale: tuple[float, ...] = (1.0,)
    head, colon, tail = text.rpartition(":")
    if colon:
        with suppress(ValueError):
            scale = tuple(map(float, tail.split(",")))
            text = head

    head, colon, tail = text.rpartition(":")
    if colon and (unit := channel.units.find(tail)):
        text = head

    columns = tuple(name.strip() for name in text.split(","))
    return ColumnSpec(
        columns=columns[0] if len(columns) == 1 else columns,
        unit=unit,
        scale=scale[0] if len(scale) == 1 else scale,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class ColumnMapping:
    """Columns for some or all channels; others are found by their usual names.

    Attributes:
        channels: Columns by name of the channel.
        rate_hz: Samples/s of a file without time stamps; it replaces a time column.
        joints: Names of the robot's joints in the recording, in its order, by which
            signals are found and put in order; or one pattern that they fit, `left_*`.
        knowledge: Channels, units and layouts that are known.
        note: What else a user should hear of the recording.
    """

    channels: Mapping[str, ColumnSpec] = field(default_factory=dict)
    rate_hz: float | None = None
    joints: str | tuple[str, ...] = ()
    knowledge: Knowledge = field(default=KNOWLEDGE, repr=False, compare=False)
    note: str = ""

    def __post_init__(self) -> None:
        """Check names, units and the rate, and write units as channels do.

        Raises:
            MappingError: One is not known, or they contradict each other.
        """
        if self.rate_hz is not None and not 0.0 < self.rate_hz <= sys.float_info.max:
            raise MappingError(f"rate_hz = {self.rate_hz!r:.60} must be positive")
        if self.rate_hz is not None and "time" in self.channels:
            raise MappingError(
                "both rate_hz and a time column are given, expected one of them"
            )
        if isinstance(self.joints, str):
            names = tuple(name.strip() for name in self.joints.split(","))
            object.__setattr__(self, "joints", names)
        if len(set(self.joints)) < len(self.joints):
            raise MappingError(f"joints = {list(self.joints)} names a joint twice")

        channels: dict[str, ColumnSpec] = {}
        for name, spec in self.channels.items():
            units = known_channel(name, self.knowledge).units
            asked = (spec.unit,) if isinstance(spec.unit, str) else spec.unit or ()
            found = tuple(units.find(unit) for unit in asked)
            if None in found:
                raise MappingError(
                    f"unit {spec.unit!r} of channel {name!r} is not known, expected: "
                    f"{', '.join(units)}"
                )

            unit = found[0] if isinstance(spec.unit, str) else found or None
            channels[name] = msgspec.structs.replace(spec, unit=unit)

        object.__setattr__(self, "channels", MappingProxyType(channels))

    def updated(self, other: "ColumnMapping") -> "ColumnMapping":
        """Return what another mapping says, and of this one what that does not say."""
        channels = {**self.channels, **other.channels}
        rate_hz = other.rate_hz
        if rate_hz is not None:
            channels.pop("time", None)
        elif "time" not in other.channels:
            rate_hz = self.rate_hz
        return replace(
            other,
            channels=channels,
            rate_hz=rate_hz,
            joints=other.joints or self.joints,
            note=other.note or self.note,
        )

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
            name for name, spec in self.channels.items() if spec.patterns == (LEFT_OUT,)
        )


def known_channel(name: str, knowledge: Knowledge) -> Channel:
    """Return the channel of a name; `MappingError` if there is none."""
    if name not in knowledge.channels:
        raise MappingError(
            f"unknown channel {name!r}; channels are: {', '.join(knowledge.channels)}"
        )

    return knowledge.channels[name]


def load_mapping(path: str | Path, knowledge: Knowledge = KNOWLEDGE) -> ColumnMapping:
    """Read a column mapping from a TOML file.

    Each channel is a table with `columns` and, if needed, `unit` and `scale`, or only
    the columns (`depth = "z"`, also `depth = "z:mm:-1"`). At the top may stand
    `rate_hz` and `joints`, see `ColumnMapping`, and `payload`, which is for commands.

    Raises:
        FileAccessError: the file cannot be read.
        MappingError: it is not TOML, or a channel, key, unit or value in it is not
            valid.
    """
    try:
        content = read_toml(path, "mapping")
        content.pop("payload", None)
        return _mapping_of(content, knowledge)
    except (FormatError, MappingError) as error:
        raise MappingError(f"{path}: {error}") from error


def load_layouts(*paths: str | Path) -> Knowledge:
    """Return what is known of logs, with files of the form of `layouts.toml` added.

    Raises:
        FileAccessError: One cannot be read.
        MappingError: One is not TOML, or an entry in it is not valid.
    """
    knowledge = load_knowledge(*paths)
    for layout in knowledge.layouts:
        mapping_of_layout(layout, knowledge)

    return knowledge


def mapping_of_layout(layout: Layout, knowledge: Knowledge) -> ColumnMapping:
    """Return what the columns of a layout are; `MappingError` if that is not valid."""
    content = {**layout.channels, "rate_hz": layout.rate_hz, "joints": layout.joints}
    note = f"{layout.name}: {layout.note}" if layout.note else ""
    try:
        return replace(_mapping_of(content, knowledge), note=note)
    except MappingError as error:
        raise MappingError(f"layout {layout.name!r}: {error}") from error


def _mapping_of(content: Mapping[str, Any], knowledge: Knowledge) -> ColumnMapping:
    """Return a mapping from content of TOML; `MappingError` if that is not valid."""
    top_keys = {"rate_hz", "joints"}
    channels: dict[str, ColumnSpec] = {}
    name = "$"
    try:
        top = {key: content[key] for key in top_keys & content.keys()}
        mapping = msgspec.convert(top, ColumnMapping)
        for name, entry in content.items():
            if name in top_keys:
                continue

            channel = known_channel(name, knowledge)
            if isinstance(entry, str):
                channels[name] = parse_column_spec(entry, channel)
            else:
                spec = entry if isinstance(entry, dict) else {"columns": entry}
                channels[name] = msgspec.convert(spec, ColumnSpec)
    except (msgspec.ValidationError, OverflowError) as error:
        raise MappingError(f"{name}: {error}") from error

    return replace(mapping, channels=channels, knowledge=knowledge)
