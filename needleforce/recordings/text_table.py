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
from dataclasses import dataclass, field
from typing import NamedTuple

from needleforce.recordings.channels import Knowledge, Layout
from needleforce.recordings.column_names import known_names
from needleforce.recordings.errors import FormatError
from needleforce.recordings.table import StatedUnit
from needleforce.recordings.units import unit_in_brackets
from needleforce.recordings.written_numbers import Commas, is_number, read_number

COMMENT = "#"
"""How a line begins that is none of the table."""

WHITE_SPACE = " "
"""Stands for cells that are separated by any number of spaces and tabs."""

MAX_TEXTS = 4
"""So many lines of text directly above the rows may be names, descriptions, units."""


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


class _Text(NamedTuple):
    """A line without numbers: its place, negative for a comment above, and cells."""

    place: int
    line: NumberedLine
    cells: list[str]


@dataclass
class _Run:
    """Rows of numbers that belong to one header.

    Attributes:
        delimiter: Between cells.
        first_row: Place of the first.
        texts: Lines of text directly above.
        header: The lowest of these that has as many cells.
        width: How many these are.
        row_count: Lines below that have as many cells, and numbers in them.
        filled: Sum over these lines of the fraction of their cells that are numbers.
    """

    delimiter: str
    first_row: int
    texts: list[_Text]
    header: _Text
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

    layout = _layout_of(lines[0].text, knowledge)
    begin = _end_of_preamble(lines, layout)
    separator = re.match(r'^"?sep=([,;\t|])"?\s*$', lines[0].text, re.IGNORECASE)
    delimiters = (separator[1],) if separator else knowledge.delimiters
    begin = max(begin, 1 if separator else 0)
    bare = [line._replace(text=line.text.lstrip(COMMENT)) for line in comments]
    above = [_Text(place - len(bare), line, []) for place, line in enumerate(bare)]
    runs = [run for each in delimiters for run in _runs(lines, begin, above, each)]
    if not runs and not separator:
        runs = _runs(lines, begin, above, WHITE_SPACE)
    if not runs:
        start = _start_without_header(lines, begin, (*delimiters, WHITE_SPACE))
        if start is None:
            raise _no_table(lines, (*knowledge.delimiters, WHITE_SPACE))
        return start

    best = max(runs, key=lambda run: (run.filled, run.width))
    return _start_with_header(lines, best, layout, knowledge)


def _layout_of(first_line: str, knowledge: Knowledge) -> Layout:
    """Return the layout whose first line fits; one that says nothing if none does."""
    fitting = (
        layout
        for layout in knowledge.layouts
        if layout.first_line and re.search(layout.first_line, first_line)
    )
    return next(fitting, Layout(name="", first_line="^"))


def _end_of_preamble(lines: Sequence[NumberedLine], layout: Layout) -> int:
    """Return the place below the last line that ends the preamble of a layout."""
    if not layout.table_after:
        return 0

    ends = (
        i for i, line in enumerate(lines, 1) if re.search(layout.table_after, line.text)
    )
    return max(ends, default=0)


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
    lines: Sequence[NumberedLine], begin: int, above: Sequence[_Text], delimiter: str
) -> list[_Run]:
    """Return the runs of rows that have a header, for one delimiter."""
    # Lines without any delimiter would look the same with each of them.
    min_width = 1 if delimiter == "," else 2
    runs: list[_Run] = []
    texts = deque(
        (
            text._replace(cells=split_line(text.line.text, delimiter))
            for text in above
            if not begin
        ),
        maxlen=MAX_TEXTS,
    )
    for place, line in enumerate(lines[begin:], begin):
        if "\0" in line.text:
            continue

        cells = split_line(line.text, delimiter)
        number_count = sum(map(is_number, cells))
        if not number_count:
            texts.append(_Text(place, line, cells))
            continue

        header = _header_of(texts, cells, min_width)
        if header is not None:
            runs.append(_Run(delimiter, place, list(texts), *header))
        # A damaged row below a header does not part it from the others.
        if header is not None or (texts and place - texts[-1].place >= MAX_TEXTS):
            texts.clear()
        if runs and _fits(cells, runs[-1].width):
            runs[-1].row_count += 1
            runs[-1].filled += number_count / runs[-1].width

    return runs


def _header_of(
    texts: Iterable[_Text], row: Sequence[str], min_width: int
) -> tuple[_Text, int] | None:
    """Return the lowest text that has a row's cells, and how many; comments last."""
    for text in sorted(texts, key=lambda text: text.place, reverse=True):
        widths = [width for width in _header_widths(text.cells) if _fits(row, width)]
        if widths and max(widths) >= min_width:
            return text, max(widths)

    return None


def _start_with_header(
    lines: Sequence[NumberedLine], run: _Run, layout: Layout, knowledge: Knowledge
) -> TableStart:
    """Return a table with the names and units above its first row."""
    is_above = [run.width in _header_widths(text.cells) for text in run.texts]
    first = run.texts.index(run.header)
    while first > 0 and is_above[first - 1]:
        first -= 1

    texts = run.texts[first : run.texts.index(run.header) + 1]
    units_line = _find_units(texts, knowledge)
    named = [text for text in texts if text is not units_line]
    header = max(
        named, key=lambda text: (known_names(text.cells, knowledge), text.place)
    )
    rows = lines[run.first_row :]
    names, warnings = _unique_names(header, run, rows)
    units: dict[str, StatedUnit] = {}
    if units_line is not None:
        units = _stated_units(names, units_line.cells, units_line.line.number)
    elif header.place >= 0:
        above = lines[: header.place]
        units = _units_above(above, run.delimiter, names, layout)
        if not split_line(rows[0].text, run.delimiter)[0].strip():
            warnings += _rate_above(above, run.delimiter, layout)

    # A damaged row is counted by the reader.
    lowest = max(-1, *(text.place for text in texts))
    first_row = next(
        (
            place
            for place in range(lowest + 1, run.first_row)
            if "\0" in lines[place].text
            or any(map(is_number, split_line(lines[place].text, run.delimiter)))
        ),
        run.first_row,
    )
    return TableStart(
        delimiter=run.delimiter,
        names=names,
        first_row=first_row,
        row_count=run.row_count,
        units=units,
        warnings=tuple(warnings),
        layout=layout.name,
    )


def _find_units(texts: Sequence[_Text], knowledge: Knowledge) -> _Text | None:
    """Return the row of units among lines of text above a table; None without one.

    The lowest may hold some units that are not known, if the line above names channels
    and it none.
    """
    *others, last = texts
    if not others:
        return None
    if knowledge.is_row_of_units(last.cells):
        return last

    filled = [cell for cell in last.cells if cell.strip()]
    known = sum(knowledge.is_unit(unit_in_brackets(cell) or cell) for cell in filled)
    if (
        2 * known >= len(filled)
        and known_names(others[-1].cells, knowledge)
        and not known_names(last.cells, knowledge)
    ):
        return last

    return next(
        (text for text in others if knowledge.is_row_of_units(text.cells)), None
    )


def _unique_names(
    header: _Text, run: _Run, rows: Sequence[NumberedLine]
) -> tuple[tuple[str, ...], list[str]]:
    """Return the names in a header, and what is odd about them.

    Those that stand twice are called by their number; where equal names have equal
    cells below, the first keeps its name.
    """
    texts = [cell.strip() for cell in header.cells[: run.width]]
    names = [text or f"column_{number}" for number, text in enumerate(texts, 1)]
    warnings: list[str] = []
    for text in dict.fromkeys(filter(None, texts)):
        places = [place for place, other in enumerate(texts) if other == text]
        if len(places) < 2:
            continue

        are_equal = _are_equal(rows, run.delimiter, places)
        renamed = places[1:] if are_equal else places
        for place in renamed:
            names[place] = f"column_{place + 1}"

        listed = " and ".join(names[place] for place in renamed)
        which = "; the others, equal in the first rows," if are_equal else "; these"
        warnings.append(
            f"the header, line {header.line.number}, names {text!r} twice{which} are "
            f"called {listed}"
        )

    return tuple(names), warnings


def _are_equal(
    rows: Iterable[NumberedLine], delimiter: str, places: Sequence[int]
) -> bool:
    """Return whether some columns have equal cells in all rows."""
    all_cells = (split_line(row.text, delimiter) for row in rows)
    return all(
        len({cells[place] for place in places if place < len(cells)}) <= 1
        for cells in all_cells
    )


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


def _units_above(
    lines: Sequence[NumberedLine], delimiter: str, names: Sequence[str], layout: Layout
) -> dict[str, StatedUnit]:
    """Return the units that a layout has above the header, by name of the column."""
    units: dict[str, StatedUnit] = {}
    for line in lines:
        if layout.units_line and re.search(layout.units_line, line.text):
            cells = [layout.first_unit, *split_line(line.text, delimiter)[1:]]
            units |= _stated_units(names, cells, line.number)

    return units


def _rate_above(
    lines: Sequence[NumberedLine], delimiter: str, layout: Layout
) -> list[str]:
    """Return what a layout says of the rate, where there are no stamps."""
    for line in lines:
        if not (layout.step_line and re.search(layout.step_line, line.text)):
            continue

        word, *cells = split_line(line.text, delimiter)
        steps_s = [read_number(cell, Commas.DECIMAL) for cell in cells]
        step_s = next((step_s for step_s in steps_s if step_s and step_s > 0.0), None)
        if step_s is not None:
            return [
                f"line {line.number} says {word} {step_s:g}, which is a rate of "
                f"{1.0 / step_s:g} Hz; the first column is empty"
            ]

    return []


def _start_without_header(
    lines: Sequence[NumberedLine], begin: int, delimiters: Iterable[str]
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
