"""One channel of a table, found and converted to SI units."""

from dataclasses import dataclass

import numpy as np

from recordings.columns.channel import Channel
from recordings.columns.detect import detect_columns
from recordings.columns.find import FoundColumn, find_columns
from recordings.columns.name import parse_column_name
from recordings.columns.spec import ColumnSpec
from recordings.errors import ColumnError, LogError, MappingError
from recordings.tables.table import FloatArray, Table


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SiChannel:
    """A channel's values.

    Attributes:
        values: SI, shape (n,), or (n, joints) for a channel of joints.
        is_unit_stated: whether mapping or column names say the unit, rather than SI assumed.
        columns: the names of its columns; none for a time that was made from a rate.
        factor: from the file's unit to SI, of the first column.
        start_ns: of time, the instant of zero, where it is not the table's; see `Table`.
    """

    values: FloatArray
    is_unit_stated: bool
    columns: tuple[str, ...] = ()
    factor: float = 1.0
    start_ns: int = 0


def find_si_channel(table: Table, channel: Channel, spec: ColumnSpec | None) -> SiChannel | None:
    """Find a channel in a table and convert it to SI units.

    The unit is the specification's, else the one in each column's name, else SI.

    Args:
        table: the file's columns.
        channel: what to find.
        spec: its columns; None to find them by their usual names.

    Returns:
        The channel, or None if it was to be found by name and there is none.

    Raises:
        ColumnError: a named column does not exist, or the choice is ambiguous.
        LogError: the channel's columns differ in length.
        MappingError: the number of scale factors does not fit the columns.
    """
    if spec is None:
        columns = detect_columns(table, channel)
        spec = ColumnSpec(columns=channel.name)
    else:
        columns = tuple(c for pattern in spec.patterns for c in find_columns(table, pattern))
    if not columns:
        return None
    values = _stack(columns, channel)
    units = [
        spec.unit or parse_column_name(column.name, channel.units).unit
        for column in columns
        for _ in range(column.width)
    ]
    factors = np.array([channel.units[unit or channel.si_unit] for unit in units])
    factors = factors * _scales(spec, len(units), channel)
    values = values * factors
    return SiChannel(
        values=values if channel.per_joint else values[:, 0],
        is_unit_stated=all(units),
        columns=tuple(column.name for column in columns),
        factor=float(factors[0]),
    )


def _stack(columns: tuple[FoundColumn, ...], channel: Channel) -> FloatArray:
    width = sum(column.width for column in columns)
    names = ", ".join(column.name for column in columns)
    if width != 1 and not channel.per_joint:
        raise ColumnError(f"{channel.name} is one column, but {names} gives {width}; choose one")
    if len({len(column.values) for column in columns}) > 1:
        raise LogError(f"{channel.name}: the columns {names} differ in length")
    return np.column_stack([column.values for column in columns])


def _scales(spec: ColumnSpec, width: int, channel: Channel) -> FloatArray:
    scales = np.atleast_1d(np.array(spec.scale, dtype=np.float64))
    if scales.size not in (1, width):
        raise MappingError(
            f"{channel.name}: {scales.size} scale factors for {width} columns; give one or {width}"
        )
    return scales
