"""In which unit a channel is read, and whence that is known."""

import re
import shlex
from collections.abc import Sequence
from enum import StrEnum
from itertools import groupby
from typing import NamedTuple

from needleforce.recordings.channels import Channel
from needleforce.recordings.column_names import parse_column_name, written_unit
from needleforce.recordings.errors import UnitError
from needleforce.recordings.mapping import ColumnSpec
from needleforce.recordings.table import Table

_ROS_VECTOR = re.compile(r"/(?:force|torque)_xyz(?:\[\d\])?$")
"""Columns of a bag whose messages define their unit, as those of joint states do."""


class UnitOrigin(StrEnum):
    """Whence the unit of a column is known."""

    HEADER = "header"
    ROW = "row of units"
    MAPPING = "mapping"
    FORMAT = "format of the file"
    ASSUMED = "assumed"


class ColumnUnit(NamedTuple):
    """The unit in which a column is read.

    Attributes:
        column: Its name.
        unit: Key of the channel's units.
        origin: Whence it is known.
        line_number: Of the row of units; 0 where there is none.
    """

    column: str
    unit: str
    origin: UnitOrigin
    line_number: int = 0

    @property
    def source(self) -> str:
        """Whence the unit is known, in words, with the line of a row of units."""
        at = f", line {self.line_number}" if self.line_number else ""
        return f"{self.origin}{at}"


class ChannelUnit(NamedTuple):
    """The unit in which a channel is read, for a summary.

    Attributes:
        channel: Its name, such as `q`.
        columns: Its columns, by joint.
        units: Of each column.
        scale: Factor or factors of the mapping, applied after the conversion to SI.
    """

    channel: str
    columns: tuple[str, ...]
    units: tuple[ColumnUnit, ...]
    scale: float | tuple[float, ...] = 1.0

    def __str__(self) -> str:
        """Return columns, units and their origin in one line."""
        parts: list[str] = []
        for (unit, source), group in groupby(
            self.units, key=lambda column: (column.unit, column.source)
        ):
            names = [column.column for column in group]
            parts.append(f"{describe_columns(names)} in {unit} ({source})")

        scales = self.scale if isinstance(self.scale, tuple) else (self.scale,)
        if any(scale != 1.0 for scale in scales):
            parts.append(f"times {', '.join(f'{scale:g}' for scale in scales)}")

        return "; ".join(parts)

    def record(self) -> dict[str, object]:
        """Return the same as values that JSON can hold."""
        return {
            "channel": self.channel,
            "columns": list(self.columns),
            "units": [column.unit for column in self.units],
            "origins": [str(column.origin) for column in self.units],
            "lines": [column.line_number or None for column in self.units],
            "scale": self.scale,
        }


class _Statement(NamedTuple):
    """What a file says of the unit of a column.

    Attributes:
        text: As it is written.
        unit: Key of the channel's units; None if it is none of them.
        origin: Where it stands.
        line_number: Of the row of units; 0 for a name.
    """

    text: str
    unit: str | None
    origin: UnitOrigin
    line_number: int = 0

    @property
    def place(self) -> str:
        """Where it stands, in words."""
        if self.origin is UnitOrigin.HEADER:
            return "its name"

        return f"the row of units (line {self.line_number})"


def units_of_columns(
    table: Table, channel: Channel, columns: Sequence[str], spec: ColumnSpec | None
) -> tuple[ColumnUnit, ...]:
    """Return the unit of each column of a channel.

    It is the specification's, else that in the row of units or in the name, else SI. A
    factor other than 1 may stand for the conversion from a unit that no channel has,
    such as a percentage.

    Args:
        table: With rows or without.
        channel: The channel.
        columns: Names of its columns.
        spec: How they were chosen; None if by their usual names.

    Raises:
        UnitError: The file contradicts itself or the specification, or states a unit
            that is none of the channel's.
    """
    spec = spec or ColumnSpec(columns=channel.name)
    units: list[ColumnUnit] = []
    for name in columns:
        is_typed = name in table.joint_names or _ROS_VECTOR.search(name) is not None
        if name in table.seconds or (is_typed and spec.unit is None):
            units.append(ColumnUnit(name, channel.si_unit, UnitOrigin.FORMAT))
            continue

        statements = _statements(table, channel, name)
        others = [statement for statement in statements if statement.unit is None]
        if others and spec.scale != 1.0:
            unit = spec.unit or channel.si_unit
            units.append(ColumnUnit(name, unit, UnitOrigin.MAPPING))
            continue

        fault, advised = _contradiction(channel, name, statements, spec.unit)
        if fault:
            raise UnitError(
                f"{channel.name}: {fault}", advise_unit(channel, columns, advised)
            )

        units.append(_stated_unit(channel, name, statements, spec.unit))

    return tuple(units)


def _stated_unit(
    channel: Channel, name: str, statements: Sequence[_Statement], asked: str | None
) -> ColumnUnit:
    """Return the unit of a column of which nothing contradicts anything."""
    if asked is not None:
        return ColumnUnit(name, asked, UnitOrigin.MAPPING)
    if not statements:
        return ColumnUnit(name, channel.si_unit, UnitOrigin.ASSUMED)

    said = statements[0]
    return ColumnUnit(name, said.unit or channel.si_unit, said.origin, said.line_number)


def _statements(table: Table, channel: Channel, name: str) -> list[_Statement]:
    """Return what the name and the row of units say of a column's unit."""
    statements: list[_Statement] = []
    unit = parse_column_name(name, channel.units).unit
    bracketed = written_unit(name)
    if unit is not None:
        statements.append(_Statement(unit, unit, UnitOrigin.HEADER))
    elif bracketed is not None:
        statements.append(_Statement(bracketed, None, UnitOrigin.HEADER))

    stated = table.units.get(name)
    if stated is not None:
        row_unit = channel.units.find(stated.text)
        statements.append(
            _Statement(stated.text, row_unit, UnitOrigin.ROW, stated.line_number)
        )

    return statements


def _contradiction(
    channel: Channel, name: str, statements: Sequence[_Statement], asked: str | None
) -> tuple[str, str]:
    """Return what contradicts what, and the unit that an advice names; or nothing.

    The mapping decides between two units of the file.

    Args:
        channel: The channel.
        name: Of the column.
        statements: What the file says.
        asked: The unit of the mapping; None without.
    """
    units = {statement.unit for statement in statements}
    for statement in statements:
        if statement.unit is None:
            return (
                f"{statement.place} says that column {name!r} is in "
                f"{statement.text!r}, which is no known unit of {channel.name}; "
                f"expected one of {', '.join(channel.units)}"
            ), f"{channel.si_unit}:FACTOR"

    if asked is None and len(units) > 1:
        said = " and ".join(f"{each.place} says {each.text}" for each in statements)
        return f"of column {name!r} {said}; the mapping may decide between them", "UNIT"
    if asked is None or not units or asked in units:
        return "", ""

    stated = statements[0].unit or channel.si_unit
    factor = channel.units[asked] / channel.units[stated]
    return (
        f"the mapping says {asked} for column {name!r}, and {statements[0].place} says "
        f"{stated}; if the file is wrong, give its unit and the factor {factor:.6g}"
    ), stated


def advise_unit(channel: Channel, columns: Sequence[str], unit: str) -> str:
    """Return how to say in which unit the columns of a channel are."""
    value = shlex.quote(f"{column_pattern(columns)}:{unit}")
    return (
        f"Give {channel.name} its `unit` in the `mapping`, as {value} does; a `scale` "
        "may stand for a unit that is not known."
    )


def column_pattern(columns: Sequence[str]) -> str:
    """Return how an option names columns: one name, `q_*`, or a list with commas."""
    patterns = {re.sub(r"\d+(?!.*\d)", "*", name) for name in columns}
    if len(columns) > 1 and len(patterns) == 1:
        return patterns.pop()

    return ",".join(columns)


def describe_columns(columns: Sequence[str]) -> str:
    """Return the columns of a channel in words: one name, or the first and the last."""
    return columns[0] if len(columns) == 1 else f"{columns[0]} to {columns[-1]}"
