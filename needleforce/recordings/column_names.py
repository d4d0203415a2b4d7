"""How columns are found by name: parts of a name, patterns, and usual names.

No number in a name has more than nine digits: longer ones are no joint's, and counting
up to them would take all memory.
"""

import re
from collections.abc import Iterable, Iterator, Mapping
from difflib import get_close_matches
from itertools import islice
from typing import NamedTuple

import numpy as np

from needleforce.recordings.channels import Channel, Knowledge, normalised_name
from needleforce.recordings.errors import ColumnError, RecordingCode
from needleforce.recordings.table import Table
from needleforce.recordings.units import Units

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
_RANGE = re.compile(r"\{(?P<first>\d{1,9})\.\.(?P<last>\d{1,9})\}")
_ELEMENT = re.compile(r"^(?P<name>.+)\[(?P<index>\d{1,9})\]$")


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


class NamedValues(NamedTuple):
    """A column of a table.

    Attributes:
        name: Of the column, or of an element of it such as `wrench[2]`.
        values: In the file's unit, shape (n,) or (n, k).
    """

    name: str
    values: np.ndarray


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
        stem = match["stem"]
        stem = stem.rsplit(".", 1)[-1]
        if unit is None:
            stem, unit = split_unit(stem, units)
    elif match := _NUMBER_FIRST.match(stem.rsplit("/", 1)[-1]):
        number = int(match["number"])
        family = name.replace(match["mark"] + match["number"], match["mark"] + "#", 1)
        stem = match["stem"]

    return ColumnName(normalised_name(stem.rsplit("/", 1)[-1]), family, number, unit)


def split_unit(name: str, units: Units) -> tuple[str, str | None]:
    """Split a unit off the end of a name, as in `z [mm]`, `z/mm` or `speed_mm_s`.

    Returns:
        The name without its unit, and the unit; None without one.
    """
    match = _BRACKETED_UNIT.match(name)
    if match and (unit := units.find(match["unit"])):
        return match["stem"], unit

    for head, tail in _possible_units(name):
        if unit := units.find(tail):
            return re.sub(r"[\s,:]+(?:in)?[\s,:]*$", "", head), unit

    return name, None


def _possible_units(name: str) -> Iterator[tuple[str, str]]:
    """Yield the ways to split a name before a unit without brackets, the longest first.

    A path such as `/arm/m` is none of a quotient.
    """
    if not name.startswith("/"):
        for match in re.finditer("/", name):
            yield name[: match.start()], name[match.end() :]

    for separator in ("_", " "):
        for part_count in (3, 2, 1):  # the longest is mm_per_s
            head, *tail = name.rsplit(separator, part_count)
            if len(tail) == part_count and head.strip():
                yield head, separator.join(tail)


def written_unit(name: str) -> str | None:
    """Return what stands in brackets at the end of a name, whether it is a unit or not.

    `wrench[2]` has an element there, and no unit.
    """
    match = _BRACKETED_UNIT.match(name.strip())
    return None if match is None or match["unit"].isdigit() else match["unit"].strip()


def find_columns(table: Table, pattern: str) -> list[NamedValues]:
    """Return the columns that a name or pattern stands for.

    In this order: a column of exactly that name; `q{1..7}`, the numbers from 1 to 7;
    `q_*`, all columns with a number in that place; `wrench[2]`, one column (from 0) of
    a two-dimensional one; and `q_rad` for a family `q_rad_1`, `q_rad_2`, ... as this
    package writes it to CSV. Numbered ones come in the order of their numbers.

    Raises:
        ColumnError: There is no such column, or a number is missing in a family.
    """
    if pattern in table.columns:
        return [NamedValues(pattern, table.columns[pattern])]
    if match := _RANGE.search(pattern):
        return _find_range(table, pattern, match)

    escaped = re.escape(pattern)
    if "*" in pattern:
        return _find_numbered(table, pattern, escaped.replace(r"\*", r"(\d{1,9})", 1))
    if match := _ELEMENT.match(pattern):
        return [_find_element(table, pattern, match)]

    return _find_numbered(table, pattern, rf"{escaped}[_. ]?\[?(\d{{1,9}})\]?")


def _find_range(table: Table, pattern: str, match: re.Match[str]) -> list[NamedValues]:
    """Return the columns of a pattern such as `q{1..7}`, in its order."""
    first = match["first"]
    end = match["last"]
    step = 1 if int(first) <= int(end) else -1
    width = len(first) if first.startswith("0") else 0
    head = pattern[: match.start()]
    tail = pattern[match.end() :]

    columns: list[NamedValues] = []
    # One at a time: the first that is not there ends the search, however long the range
    # is.
    for number in range(int(first), int(end) + step, step):
        columns += find_columns(table, f"{head}{number:0{width}d}{tail}")

    return columns


def _find_element(table: Table, pattern: str, match: re.Match[str]) -> NamedValues:
    """Return one column of a two-dimensional one, named as in `wrench[2]`."""
    name = match["name"]
    index = int(match["index"])
    values = table.columns.get(name)
    if values is None or values.ndim != 2:
        raise _not_found(table, pattern)

    if index >= values.shape[1]:
        raise ColumnError(
            f"{pattern!r}: column {name!r} has the elements [0] to "
            f"[{values.shape[1] - 1}]"
        )

    return NamedValues(pattern, values[:, index])


def _find_numbered(table: Table, pattern: str, expression: str) -> list[NamedValues]:
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

    return _in_order(table, numbered, pattern)


def _in_order(
    table: Table, numbered: Mapping[int, str], pattern: str
) -> list[NamedValues]:
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

    names = [numbered[number] for number in ordered]
    return [NamedValues(name, table.columns[name]) for name in names]


def _not_found(table: Table, pattern: str) -> ColumnError:
    """Return the error for a pattern that fits no column, with what may be meant."""
    notes = [note for note in table.warnings if repr(pattern) in note]
    reported = "".join(f" ({note})" for note in notes)
    hint = _hint(list(table.columns), pattern)
    return ColumnError(
        f"no column {pattern!r}{reported}.{hint} Columns are: {table.describe()}"
    )


def _hint(names: list[str], pattern: str) -> str:
    """Return a sentence on what a pattern that fits no name may be meant to say."""
    if "*" in pattern:
        return (
            " The * stands for one number; all the rest of the name must be written "
            "out."
        )

    head, colon, unit = pattern.rpartition(":")
    if colon and any(name.startswith(head) for name in names):
        return f" The unit {unit!r} is none of this channel's."

    bracketed = rf"{re.escape(pattern)}\s*[\[(]\D"
    with_unit = [name for name in names if re.match(bracketed, name)]
    close = with_unit or get_close_matches(pattern, names[:1000], n=1)
    return f" Did you mean {close[0]!r}?" if close else ""


def detect_columns(table: Table, channel: Channel) -> list[NamedValues]:
    """Return the columns whose names say that they are this channel, in joint order.

    Usual names come before the words of testing machines, and these before names that
    say it only beside a unit. A column whose unit is none of the channel's is left out.

    Returns:
        The columns; none if no name says so.

    Raises:
        ColumnError: Several would fit, or a joint's column is missing.
    """
    fitting = {
        name: parse_column_name(_known_form(table, name), channel.units)
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


def _known_form(table: Table, name: str) -> str:
    """Return a name without what it says in brackets of how its times are written."""
    is_clock = name in table.seconds
    return re.sub(r"(?<=\S)\s*\([^()]*\)$", "", name.strip()) if is_clock else name


def _only_candidate(
    table: Table, channel: Channel, parsed: Mapping[str, ColumnName]
) -> list[NamedValues]:
    """Return the columns of a channel among those whose names say that they are it.

    Raises:
        ColumnError: Several would fit, or a joint's column is missing.
    """
    if channel.per_joint:
        candidates = _joint_candidates(table, parsed)
    else:
        candidates = _single_candidates(table, parsed, channel)

    if len(candidates) > 1:
        raise ColumnError(
            f"{channel.name}: several columns would fit ({', '.join(candidates)})",
            RecordingCode.COLUMN,
            **channel.places,
        )

    return next(iter(candidates.values()), [])


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


def _joint_candidates(
    table: Table, parsed: Mapping[str, ColumnName]
) -> dict[str, list[NamedValues]]:
    """Return arrays of all joints by name, then families of numbered columns."""
    candidates: dict[str, list[NamedValues]] = {}
    families: dict[str, dict[int, str]] = {}
    for name, parts in parsed.items():
        values = table.columns[name]
        if parts.number is not None and values.ndim == 1:
            families.setdefault(parts.family, {})[parts.number] = name
        else:
            candidates[name] = [NamedValues(name, values)]

    for family, numbered in families.items():
        candidates[family] = _in_order(table, numbered, family)

    return candidates


def _single_candidates(
    table: Table, parsed: Mapping[str, ColumnName], channel: Channel
) -> dict[str, list[NamedValues]]:
    """Return columns of one value a row: preferred ones, those without a number."""
    fitting = [name for name in parsed if table.columns[name].shape[1:] in ((), (1,))]
    plain = [name for name in fitting if parsed[name].number is None]
    fitting = plain or fitting
    preferred = [name for name in fitting if parsed[name].stem in channel.preferred]
    return {
        name: [NamedValues(name, table.columns[name])] for name in preferred or fitting
    }


def known_names(cells: Iterable[str], knowledge: Knowledge) -> int:
    """Return how many cells of a line name a channel."""
    return sum(
        parse_column_name(cell, channel.units).stem
        in (*channel.spellings, *channel.machine_words)
        for cell in cells
        for channel in knowledge.channels.values()
    )
