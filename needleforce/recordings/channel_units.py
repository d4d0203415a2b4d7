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
        # Messages of a bag define their unit: joint states, and forces and torques.
        is_vector = re.search(r"/(?:force|torque)_xyz(?:\[\d\])?$", name) is not None
        is_typed = is_vector or name in table.joint_names
        if name in table.seconds or (is_typed and spec.unit is None):
            units.append(ColumnUnit(name, channel.si_unit, UnitOrigin.FORMAT))
            continue

        said = _statements(table, channel, name)
        are_known = all(unit.unit in channel.units for unit, _ in said)
        if not are_known and spec.scale != 1.0:
            unit = spec.unit or channel.si_unit
            units.append(ColumnUnit(name, unit, UnitOrigin.MAPPING))
            continue

        fault, advised = _contradiction(channel, said, spec.unit)
        if fault:
            raise UnitError(
                f"{channel.name}: {fault}", advise_unit(channel, columns, advised)
            )

        unit = ColumnUnit(name, channel.si_unit, UnitOrigin.ASSUMED)
        if spec.unit is not None:
            unit = ColumnUnit(name, spec.unit, UnitOrigin.MAPPING)
        elif said:
            unit, _ = said[0]

        units.append(unit)

    return tuple(units)


def _statements(
    table: Table, channel: Channel, name: str
) -> list[tuple[ColumnUnit, str]]:
    """Return what the name and the row of units say, also as it is written there.

    What is none of the channel's units stands as it is written.
    """
    statements: list[tuple[ColumnUnit, str]] = []
    unit = parse_column_name(name, channel.units).unit or written_unit(name)
    if unit is not None:
        statements.append((ColumnUnit(name, unit, UnitOrigin.HEADER), unit))

    stated = table.units.get(name)
    if stated is not None:
        unit = channel.units.find(stated.text) or stated.text
        row_unit = ColumnUnit(name, unit, UnitOrigin.ROW, stated.line_number)
        statements.append((row_unit, stated.text))

    return statements


def _contradiction(
    channel: Channel, said: Sequence[tuple[ColumnUnit, str]], asked: str | None
) -> tuple[str, str]:
    """Return what contradicts what, and the unit that an advice names; or nothing.

    The mapping decides between two units of the file.

    Args:
        channel: The channel.
        said: What the file says of a column, see `_statements`.
        asked: The unit of the mapping; None without.
    """
    says: list[str] = []
    for unit, text in said:
        line = unit.line_number
        place = f"the row of units (line {line})" if line else "its name"
        says.append(f"{place} says {text}")
        if unit.unit not in channel.units:
            return (
                f"{place} says that column {unit.column!r} is in {text!r}, which is no "
                f"known unit of {channel.name}; expected one of "
                f"{', '.join(channel.units)}"
            ), f"{channel.si_unit}:FACTOR"

    units = [unit.unit for unit, _ in said]
    if asked is None and len(set(units)) > 1:
        return (
            f"of column {said[0][0].column!r} {' and '.join(says)}; the mapping may "
            "decide between them"
        ), "UNIT"
    if asked is None or not units or asked in units:
        return "", ""

    factor = channel.units[asked] / channel.units[units[0]]
    return (
        f"the mapping says {asked} for column {said[0][0].column!r}, and {says[0]}; if "
        f"the file is wrong, give its unit and the factor {factor:.6g}"
    ), units[0]


def advise_unit(channel: Channel, columns: Sequence[str], unit: str) -> str:
    """Return how to say in which unit the columns of a channel are."""
    patterns = {re.sub(r"\d+(?!.*\d)", "*", name) for name in columns}
    is_family = len(columns) > 1 and len(patterns) == 1
    value = shlex.quote(f"{','.join(patterns if is_family else columns)}:{unit}")
    return (
        f"Give {channel.name} its `unit` in the `mapping`, as {value} does; a `scale` "
        "may stand for a unit that is not known."
    )


def describe_columns(columns: Sequence[str]) -> str:
    """Return the columns of a channel in words: one name, or the first and the last."""
    return columns[0] if len(columns) == 1 else f"{columns[0]} to {columns[-1]}"
