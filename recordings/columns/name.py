"""Taking a column's name apart: stem, joint number, unit."""

import re
from dataclasses import dataclass

from recordings.columns.units import Units, find_unit

_BRACKETED = re.compile(r"^(?P<stem>.*\S)\s*[\[(](?P<unit>[^\[\]()]+)[\])]$")
_NUMBERED = re.compile(r"^(?P<stem>.*?[^\d_.\[ ])(?P<mark>[_. ]?)\[?(?P<number>\d+)\]?$")


@dataclass(frozen=True, slots=True, kw_only=True)
class ColumnName:
    """A column name taken apart.

    Attributes:
        stem: lower case, without path, number and unit: `q` in `/robot/q_3_rad`.
        family: the name with its number blanked; the columns of one signal share it.
        number: the trailing number (a joint's), or None.
        unit: the unit the name carries, or None.
    """

    stem: str
    family: str
    number: int | None
    unit: str | None


def parse_column_name(name: str, units: Units) -> ColumnName:
    """Take a column name apart, reading as unit only a unit of the quantity looked for.

    Understands `q1`, `q_1`, `q[0]`, `q1_deg`, `q_deg_1`, `z [mm]`, `z (mm)`, `speed_mm_s` and a
    leading path such as `/joint_states/`.

    Args:
        name: the column name.
        units: units of the quantity looked for.

    Returns:
        The parts.
    """
    rest, unit = split_unit(name.strip(), units)
    number, family = None, name
    if match := _NUMBERED.match(rest):
        number = int(match["number"])
        start, end = match.span("number")
        family = name.replace(rest, f"{rest[:start]}#{rest[end:]}", 1)
        rest = match["stem"]
        if unit is None:
            rest, unit = split_unit(rest, units)
    return ColumnName(
        stem=rest.rsplit("/", 1)[-1].strip().lower(), family=family, number=number, unit=unit
    )


def split_unit(name: str, units: Units) -> tuple[str, str | None]:
    """Split a unit off the end of a name, as in `z [mm]` or `speed_mm_s`.

    Args:
        name: the name.
        units: units of the quantity looked for.

    Returns:
        The name without the unit, and the unit or None.
    """
    if (match := _BRACKETED.match(name)) and (unit := find_unit(match["unit"], units)):
        return match["stem"], unit
    parts = name.split("_")
    for first in range(1, len(parts)):
        if unit := find_unit("_".join(parts[first:]), units):
            return "_".join(parts[:first]), unit
    return name, None
