"""In which unit a channel is read, and whence that is known."""

import re
import shlex
from collections.abc import Sequence
from itertools import groupby
from typing import NamedTuple

from needleforce.recordings.channels import Channel
from needleforce.recordings.column_names import parse_column_name, written_unit
from needleforce.recordings.errors import MappingError, UnitError
from needleforce.recordings.mapping import ColumnSpec
from needleforce.recordings.table import Table

ASSUMED = "assumed"
"""Origin of the SI unit of a column for which nothing states one."""


class ChannelUnit(NamedTuple):
    """The unit in which a channel is read.

    Attributes:
        channel: Its name, such as `q`.
        columns: Its columns, by joint.
        units: Of each column, as keys of the channel's units.
        origins: Whence the unit of each column is known: header, row of units, mapping,
            format of the file, or `ASSUMED`.
        scale: Factor or factors of the mapping, applied after the conversion to SI.
    """

    channel: str
    columns: tuple[str, ...]
    units: tuple[str, ...]
    origins: tuple[str, ...]
    scale: float | tuple[float, ...] = 1.0

    def __str__(self) -> str:
        """Return columns, units and their origin in one line."""
        parts: list[str] = []
        columns = zip(self.units, self.origins, self.columns, strict=True)
        for (unit, origin), group in groupby(columns, lambda column: column[:2]):
            names = [name for _, _, name in group]
            parts.append(f"{describe_columns(names)} in {unit} ({origin})")

        scales = self.scale if isinstance(self.scale, tuple) else (self.scale,)
        if any(scale != 1.0 for scale in scales):
            parts.append(f"times {', '.join(f'{scale:g}' for scale in scales)}")

        return "; ".join(parts)


def read_units(
    table: Table, channel: Channel, columns: Sequence[str], spec: ColumnSpec | None
) -> ChannelUnit:
    """Return in which unit each column of a channel is read.

    Args:
        table: With rows or without.
        channel: The channel.
        columns: Of the channel.
        spec: What the mapping says of them; None if nothing.

    Raises:
        MappingError: It has units for another number of columns.
        UnitError: The file contradicts itself or the mapping, or states a unit that is
            none of the channel's.
    """
    spec = spec or ColumnSpec(columns=tuple(columns))
    asked = spec.unit if isinstance(spec.unit, tuple) else (spec.unit,) * len(columns)
    if len(asked) != len(columns):
        raise MappingError(
            f"{channel.name}: {len(asked)} units for {len(columns)} columns, expected "
            "one for all or one for each"
        )

    has_factor = spec.scale != 1.0
    found = [
        _unit_of_column(table, channel, name, unit, has_factor=has_factor)
        for name, unit in zip(columns, asked, strict=True)
    ]
    units, origins = zip(*found, strict=True)
    return ChannelUnit(channel.name, tuple(columns), units, origins, spec.scale)


def _unit_of_column(
    table: Table, channel: Channel, name: str, asked: str | None, *, has_factor: bool
) -> tuple[str, str]:
    """Return the unit of one of a channel's columns, and whence it is known.

    It is the mapping's, else that in the row of units or in the name, else SI. A factor
    may stand for the conversion from a unit that no channel has, such as a percentage.
    """
    # Messages of a bag define their unit: joint states, and forces and torques.
    is_vector = re.search(r"/(?:force|torque)_xyz(?:\[\d\])?$", name) is not None
    is_typed = is_vector or name in table.joint_names
    if name in table.seconds or (is_typed and not asked):
        return channel.units.si, "format of the file"

    in_header = parse_column_name(name, channel.units).unit or written_unit(name)
    texts = {"row of units": table.units.get(name), "header": in_header}
    stated = {
        channel.units.find(text) or text: origin
        for origin, text in texts.items()
        if text is not None
    }
    are_known = stated.keys() <= channel.units.keys()
    if not are_known and has_factor:
        return asked or channel.units.si, "mapping"

    is_contradicted = asked not in stated if asked else len(stated) > 1
    if stated and (is_contradicted or not are_known):
        wanted = {asked: "mapping"} if asked else {}
        parts = [f"{unit!r} ({origin})" for unit, origin in (stated | wanted).items()]
        raise UnitError(
            f"{channel.name}: column {name!r} is in {' and '.join(parts)}; expected "
            f"one of {', '.join(channel.units)}",
            advise_unit(channel, [name]),
        )
    if asked:
        return asked, "mapping"

    return next(iter(stated.items()), (channel.units.si, ASSUMED))


def advise_unit(channel: Channel, columns: Sequence[str]) -> str:
    """Return how to say in which unit the columns of a channel are."""
    value = shlex.quote(f"{','.join(columns)}:UNIT")
    return (
        f"Give {channel.name} its `unit` in the `mapping`, as {value} does; a `scale` "
        "may stand for a unit that is not known."
    )


def describe_columns(columns: Sequence[str]) -> str:
    """Return the columns of a channel in words: one name, or the first and the last."""
    return columns[0] if len(columns) == 1 else f"{columns[0]} to {columns[-1]}"
