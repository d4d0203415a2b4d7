"""Where the table of a text begins: below which lines, with which names and units.

Exports of testing machines and of LabVIEW have text, and tables of results, above the
header. The table is what most rows of numbers belong to: lines with as many cells as
a line of text above them, which is the header, or a row of units below it.
"""

import csv
import re
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from needleforce.recordings.channels import Knowledge, Layout, unit_in_brackets
from needleforce.recordings.column_names import known_names
from needleforce.recordings.errors import FormatError
from needleforce.recordings.table import StatedUnit
from needleforce.recordings.written_numbers import Commas, is_number, read_number

COMMENT = "#"
"""How a line begins that is none of the table."""

WHITE_SPACE = " "
"""Stands for cells that are separated by any number of spaces and tabs."""


class NumberedLine(NamedTuple):
    """A line of a text, and its number in the file, from 1."""

    number: int
    text: str

    @property
    def quoted(self) -> str:
        """How it begins, for a message."""
        return repr(self.text.strip()[:60])


@dataclass(frozen=True, slots=True)
class TableStart:
    """How a table of text begins.

    Attributes:
        delimiter: Between cells, or `WHITE_SPACE`.
        names: Of the columns, unique.
        first_row: Place of the first row among the lines that were looked at.
        row_count: Rows of the table among these lines.
        has_header: Whether the file has names; else columns are called by number.
        units: By name of a column, from a row of units.
        warnings: What is odd about the header.
        layout: Name of the layout whose first line fits; empty for none.
    """

    delimiter: str
    names: tuple[str, ...]
    first_row: int
    row_count: int
    has_header: bool = True
    units: Mapping[str, StatedUnit] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    layout: str = ""


@dataclass
class _Run:
    """Rows of numbers that belong to one header.

    Attributes:
        delimiter: Between cells.
        first_row: Place of the first.
        texts: Places of the header, which is the last, and of the lines of text
            directly above it that have as many cells.
        width: How many these are.
        row_count: Lines below that have as many cells, and numbers in them.
        filled: Sum over these lines of the fraction of their cells that are numbers.
    """

    delimiter: str
    first_row: int
    texts: list[int]
    width: int
    row_count: int = 0
    filled: float = 0.0


def find_table(
    lines: Sequence[NumberedLine],
    comments: Iterable[NumberedLine],
    knowledge: Knowledge,
) -> TableStart:
    """Find the table in the first lines of a text.

    Args:
        lines: Neither blank nor comments.
        comments: The last ones above the first of these lines; they may hold names and
            units, as those of `numpy.savetxt` do.
        knowledge: Names, units and layouts that are known.

    Raises:
        FormatError: There is none, or it has no row yet.
    """
    if not lines:
        raise FormatError("only comments; expected a header row and rows of numbers")

    layout = next(
        (
            layout
            for layout in knowledge.layouts
            if layout.first_line and re.search(layout.first_line, lines[0].text)
        ),
        Layout(name="", first_line="^"),
    )
    separator = re.match(r'^"?sep=([,;\t|])"?\s*$', lines[0].text, re.IGNORECASE)
    begin = 1 if separator else 0
    for place, line in enumerate(lines, 1):
        if layout.table_after and re.search(layout.table_after, line.text):
            begin = place

    delimiters = (separator[1],) if separator else knowledge.delimiters
    bare = [line._replace(text=line.text.lstrip(COMMENT)) for line in comments]
    above = [] if begin else bare
    first = begin + len(above)
    known = [*above, *lines]
    runs = [run for each in delimiters for run in _runs(known, above, first, each)]
    if not runs and not separator:
        runs = _runs(known, above, first, WHITE_SPACE)
    if runs:
        best = max(runs, key=lambda run: (run.filled, run.width))
        start = _start_with_header(known, best, layout, knowledge)
        return replace(start, first_row=start.first_row - len(above))

    start = _start_without_header(lines, begin, (*delimiters, WHITE_SPACE))
    if start is None:
        raise _no_table(lines, (*knowledge.delimiters, WHITE_SPACE))

    return start


def split_line(line: str, delimiter: str) -> list[str]:
    """Split a line into cells; a quoted cell ends with its line at the latest."""
    if delimiter == WHITE_SPACE:
        # In a header a unit belongs to the name before it.
        return re.sub(
            r"(?<=[^\s)\]])[ \t]+(?=[(\[][^\s()\[\]]+[)\]])", "", line
        ).split()

    if '"' in line:
        with suppress(csv.Error):
            return next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))

    return line.split(delimiter)


def _fits(cells: Sequence[str], width: int) -> bool:
    """Return whether a line has so many cells, apart from empty ones at its end."""
    return len(cells) >= width and not any(map(str.strip, cells[width:]))


def _header_widths(cells: Sequence[str]) -> set[int]:
    """Return how many cells the rows below a header may have."""
    filled = len(cells)
    while filled > 1 and not cells[filled - 1].strip():
        filled -= 1

    widths = {len(cells), filled}
    # The last name in the header of LabVIEW; cells below it may be missing.
    if cells[filled - 1].strip().lower() == "comment" and filled > 1:
        widths.add(filled - 1)

    return widths


def _runs(
    lines: Sequence[NumberedLine],
    above: Sequence[NumberedLine],
    begin: int,
    delimiter: str,
) -> list[_Run]:
    """Return the runs of rows that have a header, for one delimiter.

    Args:
        lines: Of the text.
        above: The first of these, comments that may hold names, but no rows.
        begin: Place of the first that is looked at.
        delimiter: Between cells.
    """
    max_texts = 4  # so many lines directly above rows may be names, descriptions, units
    runs: list[_Run] = []
    texts = deque(range(len(above)), maxlen=max_texts)
    for place, line in enumerate(lines[begin:], begin):
        if "\0" in line.text:
            continue

        cells = split_line(line.text, delimiter)
        number_count = sum(map(is_number, cells))
        if not number_count:
            texts.append(place)
            continue

        named, width = _texts_of_width(lines, texts, delimiter, cells)
        if named:
            runs.append(_Run(delimiter, place, named, width))
        # A damaged row below a header does not part it from the others.
        if named or (texts and place - texts[-1] >= max_texts):
            texts.clear()
        if runs and _fits(cells, runs[-1].width):
            runs[-1].row_count += 1
            runs[-1].filled += number_count / runs[-1].width

    return runs


def _texts_of_width(
    lines: Sequence[NumberedLine],
    texts: Sequence[int],
    delimiter: str,
    row: Sequence[str],
) -> tuple[list[int], int]:
    """Return the places of the texts that have a row's cells, and how many these are.

    They follow each other, down to the lowest that has them.
    """
    # Lines without any delimiter would look the same with each of them.
    min_width = 1 if delimiter == "," else 2
    widths_of = [_header_widths(split_line(lines[i].text, delimiter)) for i in texts]
    for end in range(len(texts), 0, -1):
        width = max((n for n in widths_of[end - 1] if _fits(row, n)), default=0)
        if width >= min_width:
            first = end - 1
            while first > 0 and width in widths_of[first - 1]:
                first -= 1

            return list(texts)[first:end], width

    return [], 0


def _start_with_header(
    lines: Sequence[NumberedLine], run: _Run, layout: Layout, knowledge: Knowledge
) -> TableStart:
    """Return a table with the names and units above its first row."""
    cells_of = {
        place: split_line(lines[place].text, run.delimiter) for place in run.texts
    }
    units_place = _find_units(cells_of, knowledge)
    header = max(
        (place for place in run.texts if place != units_place),
        key=lambda place: (known_names(cells_of[place], knowledge), place),
    )
    rows = [split_line(line.text, run.delimiter) for line in lines[run.first_row :]]
    names, warnings = _unique_names(
        cells_of[header][: run.width], lines[header].number, rows
    )
    units: dict[str, StatedUnit] = {}
    if units_place is not None:
        units = _stated_units(names, cells_of[units_place], lines[units_place].number)

    rates: list[str] = []
    for line in lines[:header] if units_place is None else ():
        cells = split_line(line.text, run.delimiter)
        if layout.units_line and re.search(layout.units_line, line.text):
            units |= _stated_units(names, [layout.first_unit, *cells[1:]], line.number)
        if layout.step_line and re.search(layout.step_line, line.text):
            rates += _rate_of_step(cells, line.number, rows[0])

    # A damaged row is counted by the reader.
    is_row = (
        "\0" in line.text or any(map(is_number, split_line(line.text, run.delimiter)))
        for line in lines[run.texts[-1] + 1 : run.first_row]
    )
    damaged = next(
        (i for i, found in enumerate(is_row, run.texts[-1] + 1) if found), None
    )
    return TableStart(
        delimiter=run.delimiter,
        names=names,
        first_row=run.first_row if damaged is None else damaged,
        row_count=run.row_count,
        units=units,
        warnings=(*warnings, *rates[:1]),
        layout=layout.name,
    )


def _find_units(texts: Mapping[int, Sequence[str]], knowledge: Knowledge) -> int | None:
    """Return the place of the row of units among texts above a table; None without one.

    The lowest may hold some units that are not known, if the line above names channels
    and it none.
    """
    *others, last = texts
    if not others:
        return None

    filled = [cell for cell in texts[last] if cell.strip()]
    known = sum(knowledge.is_unit(unit_in_brackets(cell) or cell) for cell in filled)
    names_above = known_names(texts[others[-1]], knowledge)
    if knowledge.is_row_of_units(texts[last]) or (
        2 * known >= len(filled)
        and names_above
        and not known_names(texts[last], knowledge)
    ):
        return last

    return next((i for i in others if knowledge.is_row_of_units(texts[i])), None)


def _unique_names(
    cells: Sequence[str], line_number: int, rows: Sequence[Sequence[str]]
) -> tuple[tuple[str, ...], list[str]]:
    """Return the names in a header, and what is odd about them.

    Those that stand twice are called by their number; where equal names have equal
    cells below, the first keeps its name.
    """
    texts = [cell.strip() for cell in cells]
    names = [text or f"column_{number}" for number, text in enumerate(texts, 1)]
    warnings: list[str] = []
    for text in dict.fromkeys(filter(None, texts)):
        places = [place for place, other in enumerate(texts) if other == text]
        if len(places) < 2:
            continue

        are_equal = all(
            len({row[place] for place in places if place < len(row)}) <= 1
            for row in rows
        )
        renamed = places[1:] if are_equal else places
        for place in renamed:
            names[place] = f"column_{place + 1}"

        listed = " and ".join(names[place] for place in renamed)
        which = "; the others, equal in the first rows," if are_equal else "; these"
        warnings.append(
            f"the header, line {line_number}, names {text!r} twice{which} are called "
            f"{listed}"
        )

    return tuple(names), warnings


def _stated_units(
    names: Sequence[str], cells: Sequence[str], line_number: int
) -> dict[str, StatedUnit]:
    """Return what a row of units says, by name of the column."""
    units: dict[str, StatedUnit] = {}
    for name, cell in zip(names, cells, strict=False):
        text = cell.strip()
        bracketed = unit_in_brackets(text)
        unit = text if bracketed is None else bracketed
        if unit.strip("- "):
            units[name] = StatedUnit(unit, line_number)

    return units


def _rate_of_step(
    cells: Sequence[str], line_number: int, row: Sequence[str]
) -> list[str]:
    """Return what a line above says of the rate, if a row has no time stamp."""
    word, *others = cells
    steps_s = [read_number(cell, Commas.DECIMAL) for cell in others]
    step_s = next((step_s for step_s in steps_s if step_s and step_s > 0.0), None)
    if step_s is None or row[0].strip():
        return []

    return [
        f"line {line_number} says {word} {step_s:g}, which is a rate of "
        f"{1.0 / step_s:g} Hz; the first column is empty"
    ]


def _start_without_header(
    lines: Sequence[NumberedLine], begin: int, delimiters: Sequence[str]
) -> TableStart | None:
    """Return a table of two columns or more without names, half of them numbers."""
    best: TableStart | None = None
    best_fraction = 0.0
    for delimiter in delimiters:
        for place, line in enumerate(lines[begin:], begin):
            cells = split_line(line.text, delimiter)
            fraction = sum(map(is_number, cells)) / max(len(cells), 1)
            if fraction < 0.5 or "\0" in line.text:
                continue
            if len(cells) >= 2 and fraction > best_fraction:
                best = _nameless(lines, place, len(cells), delimiter)
                best_fraction = fraction
            break

    return best


def _nameless(
    lines: Sequence[NumberedLine], place: int, width: int, delimiter: str
) -> TableStart:
    """Return a table without names that begins at a place among lines."""
    damaged = [line for line in lines[:place] if "\0" in line.text]
    notes = [
        f"line {line.number}, above the table, has NUL bytes and was left out"
        for line in damaged[-1:]
    ]
    first = lines[place]
    notes.append(
        f"there is no header: line {first.number} ({first.quoted}) is a row of numbers "
        f"without names above it; its columns are called column_1 to column_{width}"
    )
    return TableStart(
        delimiter=delimiter,
        names=tuple(f"column_{number}" for number in range(1, width + 1)),
        first_row=place,
        row_count=len(lines) - place,
        has_header=False,
        warnings=tuple(notes),
    )


def _no_table(lines: Sequence[NumberedLine], delimiters: Iterable[str]) -> FormatError:
    """Return the error for lines in which no table begins, naming a line."""
    expected = (
        "expected a line of names and below it rows of numbers with as many cells, "
        "separated by commas, semicolons, tabs or spaces"
    )
    first = lines[0]
    if 2 * sum("\0" in line.text for line in lines) > len(lines):
        return FormatError(
            f"it is not text: line {first.number} holds NUL bytes; expected a header "
            "row and rows of numbers"
        )

    numbers = next(
        (
            line
            for line in lines
            for delimiter in delimiters
            if any(map(is_number, split_line(line.text, delimiter)))
        ),
        None,
    )
    if numbers is None and len(lines) == 1:
        return FormatError(
            f"a header but no rows; the header is line {first.number}: "
            f"{first.text.strip()[:200]}"
        )
    if numbers is None:
        return FormatError(
            f"no row of numbers in lines {first.number} to {lines[-1].number}, which "
            f"begin with {first.quoted}; {expected}"
        )

    return FormatError(
        f"no table: line {numbers.number} ({numbers.quoted}) is the first with "
        f"numbers, and no line above it has as many cells; {expected}"
    )
