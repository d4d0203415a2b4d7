"""How columns are found by name: parts of a name, patterns, and usual names.

No number in a name has more than nine digits: longer ones are no joint's, and counting
up to them would take all memory.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from difflib import get_close_matches
from itertools import islice, product
from typing import NamedTuple

from needleforce.recordings.channels import Channel, Knowledge, Units, normalised_name
from needleforce.recordings.errors import ColumnError
from needleforce.recordings.table import Table

_BRACKETED_UNIT = re.compile(
    r"^(?P<stem>.*\S)\s*[\[({<](?P<unit>[^\[\](){}<>]+)[\])}>]$"
)
_NUMBERED_NAME = re.compile(
    r"^(?P<stem>.*?[^\d_.\[ ])(?P<mark>[_. ]?)\[?(?P<number>\d{1,9})\]?$"
)
_NUMBER_FIRST = re.compile(
    r"^(?P<mark>(?:joint|axis|actuator|motor|ax|j|a)[_. ]?)(?P<number>\d{1,2})[_./ ]+"
    r"(?P<stem>[^\d\W].*)$",
    re.IGNORECASE,
)


class ColumnName(NamedTuple):
    """The parts of a column name.

    Attributes:
        stem: Lower case, without path, number and unit: `q` in `/robot/q_3_rad`.
        family: The name with its number blanked, the same for the columns of a signal.
        number: The trailing one (a joint's); None without one.
        unit: That the name carries; None without one.
    """

    stem: str
    family: str
    number: int | None
    unit: str | None


def parse_column_name(name: str, units: Units) -> ColumnName:
    """Split a column name into its parts.

    Only a unit of the quantity looked for is read as one. Understands `q1`, `q_1`,
    `q[0]`, `q1_deg`, `q_deg_1`, `joint 1 position`, `z [mm]`, `z (mm)`, `z/mm`, `z mm`,
    `z in mm`, `speed_mm_s` and a leading path such as `/joint_states/`; before a number
    also one with dots, as in `state.q[0]`.
    """
    stem, unit = split_unit(name.strip(), units)
    number = None
    family = name
    if match := _NUMBERED_NAME.match(stem):
        number = int(match["number"])
        start, end = match.span("number")
        family = name.replace(stem, f"{stem[:start]}#{stem[end:]}", 1)
        stem = match["stem"].rsplit(".", 1)[-1]
        if unit is None:
            stem, unit = split_unit(stem, units)
    elif match := _NUMBER_FIRST.match(stem.rsplit("/", 1)[-1]):
        number = int(match["number"])
        family = name.replace(match["mark"] + match["number"], match["mark"] + "#", 1)
        stem = match["stem"]

    return ColumnName(normalised_name(stem.rsplit("/", 1)[-1]), family, number, unit)


def split_unit(name: str, units: Units) -> tuple[str, str | None]:
    """Split a unit, if there is one, off the end of a name such as `speed_mm_s`."""
    parts: list[Sequence[str]] = []
    if match := _BRACKETED_UNIT.match(name):
        parts.append(match.groups())
    if not name.startswith("/"):  # a path such as /arm/m is no quotient
        places = [match.span() for match in re.finditer("/", name)]
        parts += [(name[:start], name[end:]) for start, end in places]
    for separator, count in product("_ ", (3, 2, 1)):  # the longest is mm_per_s
        head, *tail = name.rsplit(separator, count)
        if len(tail) == count and head.strip():
            parts.append((head, separator.join(tail)))
    for head, tail in parts:
        if unit := units.find(tail):
            return re.sub(r"[\s,:]+(?:in)?[\s,:]*$", "", head), unit

    return name, None


def written_unit(name: str) -> str | None:
    """Return what stands in brackets at the end of a name, whether it is a unit or not.

    `wrench[2]` has an element there, and no unit.
    """
    match = _BRACKETED_UNIT.match(name.strip())
    return None if match is None or match["unit"].isdigit() else match["unit"].strip()


def known_names(cells: Iterable[str], knowledge: Knowledge) -> int:
    """Return how many cells of a line name a channel."""
    return sum(
        parse_column_name(cell, channel.units).stem
        in (*channel.spellings, *channel.machine_words)
        for cell in cells
        for channel in knowledge.channels.values()
    )


def find_columns(table: Table, pattern: str) -> list[str]:
    """Return the names of the columns that a name or pattern stands for.

    In this order: a column of exactly that name; `q{1..7}`, the numbers from 1 to 7;
    `q_*`, all columns with a number in that place; `wrench[2]`, one column (from 0) of
    a two-dimensional one; and `q_rad` for a family `q_rad_1`, `q_rad_2`, ... as this
    package writes it to CSV. Numbered ones come in the order of their numbers.

    Raises:
        ColumnError: There is no such column, or a number is missing in a family.
    """
    if pattern in table.columns:
        return [pattern]
    if match := re.search(r"\{(\d{1,9})\.\.(\d{1,9})\}", pattern):
        first, last = match.groups()
        step = 1 if int(first) <= int(last) else -1
        width = len(first) if first.startswith("0") else 0
        # One at a time: the first that is not there ends the search, however long the
        # range is.
        columns: list[str] = []
        for number in range(int(first), int(last) + step, step):
            numbered = f"{number:0{width}d}".join(pattern.split(match[0], 1))
            columns += find_columns(table, numbered)

        return columns

    escaped = re.escape(pattern)
    if "*" in pattern:
        return _find_numbered(table, pattern, escaped.replace(r"\*", r"(\d{1,9})", 1))
    if match := re.match(r"^(.+)\[(\d{1,9})\]$", pattern):
        values = table.columns.get(match[1])
        if values is None or values.ndim != 2:
            raise _not_found(table, pattern)
        if int(match[2]) >= values.shape[1]:
            raise ColumnError(
                f"{pattern!r}: column {match[1]!r} has the elements [0] to "
                f"[{values.shape[1] - 1}]"
            )

        return [pattern]

    return _find_numbered(table, pattern, rf"{escaped}[_. ]?\[?(\d{{1,9}})\]?")


def _find_numbered(table: Table, pattern: str, expression: str) -> list[str]:
    """Return columns whose names match an expression, by the number that it captures.

    Raises:
        ColumnError: There is none, two have the same number, or a number is missing.
    """
    numbered: dict[int, str] = {}
    for name in table.columns:
        match = re.fullmatch(expression, name)
        if match and (other := numbered.setdefault(int(match[1]), name)) != name:
            raise ColumnError(f"{pattern!r} fits both {other!r} and {name!r}")

    if not numbered:
        raise _not_found(table, pattern)

    return _in_order(numbered, pattern)


def _in_order(numbered: Mapping[int, str], pattern: str) -> list[str]:
    """Return a family of columns in the order of their numbers.

    Raises:
        ColumnError: The numbers do not follow each other.
    """
    ordered = sorted(numbered)
    missing = (n for n in range(ordered[0], ordered[-1]) if n not in numbered)
    if listed := list(islice(missing, 5)):
        raise ColumnError(
            f"{pattern!r}: found the numbers {ordered[0]} to {ordered[-1]}, but not "
            f"{', '.join(map(str, listed))}"
        )

    return [numbered[number] for number in ordered]


def _not_found(table: Table, pattern: str) -> ColumnError:
    """Return the error for a pattern that fits no column, with what may be meant."""
    notes = [note for note in table.warnings if repr(pattern) in note]
    reported = "".join(f" ({note})" for note in notes)
    names = list(table.columns)
    head, colon, unit = pattern.rpartition(":")
    bracketed = rf"{re.escape(pattern)}\s*[\[(]\D"
    with_unit = [name for name in names if re.match(bracketed, name)]
    close = with_unit or get_close_matches(pattern, names[:1000], n=1)
    hint = f" Did you mean {close[0]!r}?" if close else ""
    if "*" in pattern:
        hint = " The * stands for one number; all the rest of the name must be "
        hint += "written out."
    elif colon and any(name.startswith(head) for name in names):
        hint = f" The unit {unit!r} is none of this channel's."

    return ColumnError(
        f"no column {pattern!r}{reported}.{hint} Columns are: {table.describe()}"
    )


def detect_columns(table: Table, channel: Channel) -> list[str]:
    """Return the columns whose names say that they are this channel, in joint order.

    Usual names come before the words of testing machines, and these before names that
    say it only beside a unit. A column whose unit is none of the channel's is left out.

    Returns:
        Their names; none if no name says so.

    Raises:
        ColumnError: Several would fit, or a joint's column is missing.
    """
    fitting = {
        name: parse_column_name(
            # In brackets a column of times may say how they are written.
            re.sub(r"(?<=\S)\s*\([^()]*\)$", "", name.strip())
            if name in table.seconds
            else name,
            channel.units,
        )
        for name in table.columns
        if states_other_unit(table, name, channel) is None
    }
    with_unit = {
        name: parts
        for name, parts in fitting.items()
        if parts.unit or name in table.units
    }
    for names, words in (
        (fitting, channel.spellings),
        (fitting, channel.machine_words),
        (with_unit, channel.words_with_unit),
    ):
        parsed = {name: parts for name, parts in names.items() if parts.stem in words}
        if parsed:
            return _only_candidate(table, channel, parsed)

    return []


def _only_candidate(
    table: Table, channel: Channel, parsed: Mapping[str, ColumnName]
) -> list[str]:
    """Return the columns of a channel among those whose names say that they are it.

    They are one array, or a family of numbered columns; for a channel of one value a
    preferred column, or one without a number.

    Raises:
        ColumnError: Several would fit, or a joint's column is missing.
    """
    families: dict[str, dict[int, str]] = {}
    candidates: dict[str, list[str]] = {}
    for name, parts in parsed.items():
        width = table.width(name)
        is_numbered = parts.number is not None and table.columns[name].ndim == 1
        if channel.per_joint and is_numbered:
            families.setdefault(parts.family, {})[parts.number or 0] = name
        elif channel.per_joint or width == 1:
            candidates[name] = [name]

    candidates |= {name: _in_order(each, name) for name, each in families.items()}
    if not channel.per_joint:
        plain = [name for name in candidates if parsed[name].number is None]
        candidates = {name: [name] for name in plain} or candidates
        best = [name for name in candidates if parsed[name].stem in channel.preferred]
        candidates = {name: [name] for name in best} or candidates
    if len(candidates) > 1:
        raise several_fit(channel, candidates)

    return next(iter(candidates.values()), [])


def advise_column(channel: Channel) -> str:
    """Return how to say which columns a channel is."""
    return (
        f"Name it under `{channel.name}` in the `mapping`: "
        "`ColumnMapping(channels=...)`."
    )


def several_fit(channel: Channel, names: Iterable[str]) -> ColumnError:
    """Return the error for a channel that several columns would fit."""
    return ColumnError(
        f"{channel.name}: several columns would fit ({', '.join(names)})",
        advise_column(channel),
    )


def states_other_unit(table: Table, name: str, channel: Channel) -> str | None:
    """Return the unit that the row of units states, if it is none of the channel's."""
    stated = table.units.get(name)
    if stated is None or channel.units.find(stated.text) is not None:
        return None

    return stated.text


def columns_in_other_units(table: Table, channel: Channel) -> dict[str, str]:
    """Return columns that have a channel's name and no unit of it, with their units."""
    words = {*channel.spellings, *channel.machine_words, *channel.words_with_unit}
    columns: dict[str, str] = {}
    for name in table.columns:
        unit = states_other_unit(table, name, channel)
        stem = parse_column_name(name, channel.units).stem
        bracketed = _BRACKETED_UNIT.match(name.strip())
        if unit is None and bracketed and stem not in words:
            unit = bracketed["unit"]
            stem = parse_column_name(bracketed["stem"], channel.units).stem

        if unit is not None and stem in words:
            columns[name] = unit

    return columns
