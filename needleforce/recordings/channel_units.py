"""In which unit a channel is read, and whence that is known."""

import re
import shlex
from collections.abc import Sequence
from itertools import groupby
from typing import NamedTuple

from needleforce.recordings.channels import Channel
from needleforce.recordings.column_names import parse_column_name, written_unit
from needleforce.recordings.errors import UnitError
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

    def record(self) -> dict[str, object]:
        """Return the same as values that JSON can hold."""
        return self._asdict()


def unit_of_column(
    table: Table, channel: Channel, name: str, spec: ColumnSpec
) -> tuple[str, str]:
    """Return the unit of one of a channel's columns, and whence it is known.

    It is the specification's, else that in the row of units or in the name, else SI. A
    factor other than 1 may stand for the conversion from a unit that no channel has,
    such as a percentage.

    Args:
        table: With rows or without.
        channel: The channel.
        name: Of the column.
        spec: How it was chosen.

    Raises:
        UnitError: The file contradicts itself or the specification, or states a unit
            that is none of the channel's.
    """
    # Messages of a bag define their unit: joint states, and forces and torques.
    is_vector = re.search(r"/(?:force|torque)_xyz(?:\[\d\])?$", name) is not None
    is_typed = is_vector or name in table.joint_names
    if name in table.seconds or (is_typed and spec.unit is None):
        return channel.si_unit, "format of the file"

    stated: dict[str, str] = {}
    row = table.units.get(name)
    if row is not None:
        stated[channel.units.find(row) or row] = "row of units"
    text = parse_column_name(name, channel.units).unit or written_unit(name)
    if text is not None:
        stated[text] = "header"

    are_known = stated.keys() <= channel.units.keys()
    is_decided = len(stated) == 0 or spec.unit in stated
    if spec.unit is None:
        is_decided = len(stated) < 2
    if not are_known and spec.scale != 1.0:
        return spec.unit or channel.si_unit, "mapping"
    if not are_known or not is_decided:
        asked = {spec.unit: "mapping"} if spec.unit else {}
        parts = [f"{unit!r} ({origin})" for unit, origin in (stated | asked).items()]
        raise UnitError(
            f"{channel.name}: column {name!r} is in {' and '.join(parts)}; expected "
            f"one of {', '.join(channel.units)}",
            advise_unit(channel, [name]),
        )
    if spec.unit is not None:
        return spec.unit, "mapping"

    return next(iter(stated.items()), (channel.si_unit, ASSUMED))


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
