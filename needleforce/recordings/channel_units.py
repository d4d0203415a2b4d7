"""In which unit a channel is read, and whence that is known."""

import re
import shlex
from collections.abc import Sequence
from enum import StrEnum
from itertools import groupby
from typing import NamedTuple

from needleforce.recordings.channels import Channel
from needleforce.recordings.column_names import parse_column_name, written_unit
from needleforce.recordings.errors import RecordingCode, UnitError
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
    return tuple(
        _unit_of_column(table, channel, name, columns, spec) for name in columns
    )


def _unit_of_column(
    table: Table,
    channel: Channel,
    name: str,
    columns: Sequence[str],
    spec: ColumnSpec | None,
) -> ColumnUnit:
    """Return the unit of one column, see `units_of_columns`."""
    asked = spec.unit if spec is not None else None
    is_typed = name in table.joint_names or _ROS_VECTOR.search(name) is not None
    if name in table.seconds or (is_typed and asked is None):
        return ColumnUnit(name, channel.si_unit, UnitOrigin.FORMAT)

    statements = _statements(table, channel, name)
    others = [statement for statement in statements if statement.unit is None]
    if others and spec is not None and spec.scale != 1.0:
        return ColumnUnit(name, asked or channel.si_unit, UnitOrigin.MAPPING)
    if others:
        raise _other_unit(channel, columns, name, others[0])

    _require_agreement(channel, columns, name, statements, asked)
    if asked is not None:
        return ColumnUnit(name, asked, UnitOrigin.MAPPING)
    if statements:
        said = statements[0]
        unit = said.unit or channel.si_unit
        return ColumnUnit(name, unit, said.origin, said.line_number)

    return ColumnUnit(name, channel.si_unit, UnitOrigin.ASSUMED)


def _require_agreement(
    channel: Channel,
    columns: Sequence[str],
    name: str,
    statements: Sequence[_Statement],
    asked: str | None,
) -> None:
    """Raise `UnitError` if the file contradicts itself or the mapping.

    The mapping decides between two units of the file.
    """
    units = {statement.unit for statement in statements}
    if asked is not None and len(units) > 1 and asked in units:
        return

    for statement in statements:
        if asked is not None and statement.unit != asked:
            raise _contradiction(channel, columns, name, statement, asked)
        if statement.unit != statements[0].unit:
            raise _disagreement(channel, columns, name, statements)


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


def _other_unit(
    channel: Channel, columns: Sequence[str], name: str, statement: _Statement
) -> UnitError:
    """Return the error for a unit that is none of the channel's."""
    return UnitError(
        f"{channel.name}: {statement.place} says that column {name!r} is in "
        f"{statement.text!r}, which is no known unit of {channel.name}; expected one "
        f"of {', '.join(channel.units)}",
        RecordingCode.UNIT,
        **advice_places(channel, columns, f"{channel.si_unit}:FACTOR"),
    )


def _disagreement(
    channel: Channel,
    columns: Sequence[str],
    name: str,
    statements: Sequence[_Statement],
) -> UnitError:
    """Return the error for a name and a row of units that say different units."""
    said = " and ".join(
        f"{statement.place} says {statement.text}" for statement in statements
    )
    return UnitError(
        f"{channel.name}: of column {name!r} {said}; the mapping may "
        "decide between them",
        RecordingCode.UNIT,
        **advice_places(channel, columns, "UNIT"),
    )


def _contradiction(
    channel: Channel,
    columns: Sequence[str],
    name: str,
    statement: _Statement,
    asked: str,
) -> UnitError:
    """Return the error for a mapping that says another unit than the file."""
    stated = statement.unit or channel.si_unit
    factor = channel.units[asked] / channel.units[stated]
    return UnitError(
        f"{channel.name}: the mapping says {asked} for column {name!r}, and "
        f"{statement.place} says {stated}; if the file is wrong, give its unit and the "
        f"factor {factor:.6g}",
        RecordingCode.UNIT,
        **advice_places(channel, columns, stated),
    )


def advice_places(
    channel: Channel, columns: Sequence[str], unit: str
) -> dict[str, str]:
    """Return what an advice on a channel's unit names: the option and its value."""
    value = f"{column_pattern(columns)}:{unit}"
    return {**channel.places, "value": shlex.quote(value), "unit": unit}


def column_pattern(columns: Sequence[str]) -> str:
    """Return how an option names columns: one name, `q_*`, or a list with commas."""
    patterns = {re.sub(r"\d+(?!.*\d)", "*", name) for name in columns}
    if len(columns) > 1 and len(patterns) == 1:
        return patterns.pop()

    return ",".join(columns)


def describe_columns(columns: Sequence[str]) -> str:
    """Return the columns of a channel in words: one name, or the first and the last."""
    return columns[0] if len(columns) == 1 else f"{columns[0]} to {columns[-1]}"
