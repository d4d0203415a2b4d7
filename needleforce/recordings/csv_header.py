"""Where the table of a text begins: below which lines, with which names and units.

Exports of testing machines and of LabVIEW have text, and tables of results, above the
header. The table is what most rows of numbers belong to: lines with as many cells as
a line of text above them, which is the header, or a row of units below it.
"""

import csv
import re
from collections import deque
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from needleforce.recordings.channels import KNOWLEDGE
from needleforce.recordings.column_names import parse_column_name
from needleforce.recordings.errors import FormatError
from needleforce.recordings.table import StatedUnit
from needleforce.recordings.units import unit_in_brackets
from needleforce.recordings.written_numbers import (
    Commas,
    is_number,
    read_number,
    read_with_commas,
)

COMMENT = "#"
"""How a line begins that is none of the table."""

WHITE_SPACE = " "
"""Stands for cells that are separated by any number of spaces and tabs."""

MAX_QUOTED_CHARACTERS = 60
"""A message shows so much of a line."""

_DELIMITERS = (",", ";", "\t")
_SEPARATOR_LINE = re.compile(r'^"?sep=(?P<delimiter>[,;\t|])"?\s*$', re.IGNORECASE)
_SPACE_BEFORE_UNIT = re.compile(r"(?<=[^\s)\]])[ \t]+(?=[(\[][^\s()\[\]]+[)\]])")
_EXPECTED = (
    "expected a line of names and below it rows of numbers with as many cells, "
    "separated by commas, semicolons, tabs or spaces"
)
_LABVIEW_UNITS = "Y_Unit_Label"
"""Begins the line of units in the header of LabVIEW."""

_LABVIEW_TIME = "X_Dimension"
"""Begins the line that says whether the first column is time, which is in seconds."""

_LABVIEW_STEP = "Delta_X"
"""Begins the line with the time from row to row, in seconds."""

_LABVIEW_COMMENT = "comment"
"""The last name in the header of LabVIEW, below which cells may be missing."""

MAX_LINES_BELOW_HEADER = 3
"""So many lines of text that are no names may stand between header and rows."""

MIN_COLUMNS_WITHOUT_HEADER = 2
"""Rows of one number without a header are no table."""

MIN_NUMBERS_WITHOUT_HEADER = 0.5
"""At least this fraction of the cells of a row without a header are numbers."""


class NumberedRow(NamedTuple):
    """A row of a table as text.

    Attributes:
        line_number: In the file, from 1.
        text: The line.
    """

    line_number: int
    text: str


@dataclass(frozen=True, slots=True)
class TableStart:
    """How a table of text begins.

    Attributes:
        delimiter: Between cells, or `WHITE_SPACE`.
        names: Of the columns, unique.
        first_row: Place of the first row among the lines that were looked at.
        row_count: Rows of the table among these lines.
        header_line: Number of the line of names; 0 without.
        units: By name of a column, from a row of units.
        warnings: What is odd about the header.
    """

    delimiter: str
    names: tuple[str, ...]
    first_row: int
    row_count: int
    header_line: int = 0
    units: dict[str, StatedUnit] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()


class _Candidate(NamedTuple):
    """A place where a table may begin.

    Attributes:
        first_row: Place of its first row among the lines.
        header: Place of the lowest line of text that has as many cells.
        width: Cells of its header.
        row_count: Lines below that have as many cells, and numbers in them.
        filled: Sum over these lines of the fraction of their cells that are numbers.
    """

    first_row: int
    header: int
    width: int
    row_count: int
    filled: float


def find_table(
    lines: Sequence[NumberedRow], comments: Sequence[NumberedRow]
) -> TableStart:
    """Find the table in the first lines of a text.

    Args:
        lines: Neither blank nor comments.
        comments: The last ones above the first of these lines.

    Raises:
        FormatError: There is none, or it has no row yet.
    """
    if not lines:
        raise FormatError("only comments; expected a header row and rows of numbers")

    separator = _SEPARATOR_LINE.match(lines[0].text)
    if separator:
        delimiters: tuple[str, ...] = (separator["delimiter"],)
    else:
        delimiters = _DELIMITERS

    starts = [
        start
        for delimiter in delimiters
        if (start := _start_with_header(lines, delimiter)) is not None
    ]
    if not starts and not separator:
        starts = [
            start
            for start in (_start_with_header(lines, WHITE_SPACE),)
            if start is not None
        ]

    if starts:
        delimiter, candidate = max(starts, key=_rank)
        return _with_header(lines, delimiter, candidate)

    rows = lines[1:] if separator else lines
    start = _start_without_header(rows, comments, (*delimiters, WHITE_SPACE))
    if start is None:
        raise _no_table(lines)

    return start


def _rank(start: tuple[str, _Candidate]) -> tuple[float, int]:
    """Return what the best of several possible tables has most of."""
    _, candidate = start
    return candidate.filled, candidate.width


def split_line(line: str, delimiter: str) -> list[str]:
    """Split a line into cells; a quoted cell ends with its line at the latest."""
    if delimiter == WHITE_SPACE:
        # In a header a unit belongs to the name before it.
        return _SPACE_BEFORE_UNIT.sub("", line).split()

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
    if cells[filled - 1].strip().lower() == _LABVIEW_COMMENT and filled > 1:
        widths.add(filled - 1)

    return widths


def _start_with_header(
    lines: Sequence[NumberedRow], delimiter: str
) -> tuple[str, _Candidate] | None:
    """Return the table with most rows that has a header, for one delimiter."""
    # Lines without any delimiter would look the same with each of them.
    min_width = 1 if delimiter == "," else 2
    best: _Candidate | None = None
    current: _Candidate | None = None
    texts: deque[tuple[int, list[str]]] = deque(maxlen=MAX_LINES_BELOW_HEADER + 1)
    for place, line in enumerate(lines):
        if "\0" in line.text:
            continue

        cells = split_line(line.text, delimiter)
        number_count = sum(map(is_number, cells))
        if not number_count:
            texts.append((place, cells))
            continue

        header = _header_of(texts, cells, min_width)
        if header is not None:
            current = _Candidate(place, *header, 0, 0.0)

        # A damaged row below a header does not part it from the others.
        if header is not None or (
            texts and place - texts[-1][0] > MAX_LINES_BELOW_HEADER
        ):
            texts.clear()

        if current is not None and _fits(cells, current.width):
            current = current._replace(
                row_count=current.row_count + 1,
                filled=current.filled + number_count / current.width,
            )
            if best is None or current.filled > best.filled:
                best = current

    return None if best is None else (delimiter, best)


def _header_of(
    texts: Iterable[tuple[int, list[str]]], row: Sequence[str], min_width: int
) -> tuple[int, int] | None:
    """Return the place and the width of the lowest text that has a row's cells.

    Args:
        texts: Places and cells of lines of text directly above the row.
        row: Its cells.
        min_width: The fewest cells that a header may have.
    """
    for place, cells in reversed(list(texts)):
        widths = [width for width in _header_widths(cells) if _fits(row, width)]
        if widths and max(widths) >= min_width:
            return place, max(widths)

    return None


def _with_header(
    lines: Sequence[NumberedRow], delimiter: str, candidate: _Candidate
) -> TableStart:
    """Return a table with the names and units above its first row."""
    width = candidate.width
    names_place = candidate.header
    units_place: int | None = None
    texts = _texts_above(lines, delimiter, candidate)
    if len(texts) > 1 and _are_units(lines, delimiter, texts):
        units_place = names_place
        texts = texts[:-1]

    names_place = max(
        texts, key=lambda place: (_known_names(lines[place], delimiter), place)
    )
    header = lines[names_place]
    names, warnings = _unique_names(
        header, delimiter, width, lines[candidate.first_row :]
    )
    units: dict[str, StatedUnit] = {}
    if units_place is None:
        cells_of = {
            place: split_line(lines[place].text, delimiter)
            for place in texts
            if place != names_place
        }
        units_place = next(
            (place for place, cells in cells_of.items() if KNOWLEDGE.is_row_of_units(cells)), None
        )

    if units_place is not None:
        line = lines[units_place]
        units = _stated_units(names, split_line(line.text, delimiter), line.line_number)
    else:
        above = lines[:names_place]
        units = _labview_units(above, delimiter, names)
        first_cells = split_line(lines[candidate.first_row].text, delimiter)
        if not first_cells[0].strip():
            warnings = (*warnings, *_labview_rate(above, delimiter))

    # A damaged row is counted by the reader.
    lowest = max(names_place, candidate.header)
    first_row = next(
        (
            place
            for place in range(lowest + 1, candidate.first_row)
            if _is_damaged_row(lines[place], delimiter)
        ),
        candidate.first_row,
    )
    return TableStart(
        delimiter=delimiter,
        names=names,
        first_row=first_row,
        row_count=candidate.row_count,
        header_line=header.line_number,
        units=units,
        warnings=warnings,
    )


def _is_damaged_row(line: NumberedRow, delimiter: str) -> bool:
    """Return whether a line between header and rows is a row that cannot be read."""
    return "\0" in line.text or any(map(is_number, split_line(line.text, delimiter)))


def _labview_units(
    lines: Sequence[NumberedRow], delimiter: str, names: Sequence[str]
) -> dict[str, StatedUnit]:
    """Return the units that the header of LabVIEW states, by name of the column."""
    units: dict[str, StatedUnit] = {}
    for line in lines:
        first, *others = split_line(line.text, delimiter) or [""]
        if first.strip() == _LABVIEW_UNITS:
            units |= _stated_units(names, ["", *others], line.line_number)
        elif first.strip() == _LABVIEW_TIME and "Time" in others:
            units[names[0]] = StatedUnit("s", line.line_number)

    return units


def _labview_rate(lines: Sequence[NumberedRow], delimiter: str) -> tuple[str, ...]:
    """Return what the header of LabVIEW says of the rate, where there are no stamps."""
    for line in lines:
        first, *others = split_line(line.text, delimiter) or [""]
        steps_s = [
            step_s
            for cell in others
            if (
                step_s := read_with_commas(cell.strip(), Commas.DECIMAL)
                or read_number(cell.strip())
            )
        ]
        if first.strip() == _LABVIEW_STEP and steps_s and steps_s[0] > 0.0:
            return (
                f"line {line.line_number} says {_LABVIEW_STEP} {steps_s[0]:g}, which "
                f"is a rate of {1.0 / steps_s[0]:g} Hz; the first column is empty",
            )

    return ()


def _texts_above(
    lines: Sequence[NumberedRow], delimiter: str, candidate: _Candidate
) -> list[int]:
    """Return the places of the lines of text above a table that are as wide as it."""
    places = [candidate.header]
    while places[0] > 0:
        cells = split_line(lines[places[0] - 1].text, delimiter)
        is_text = not any(map(is_number, cells))
        if not (is_text and candidate.width in _header_widths(cells)):
            break

        places.insert(0, places[0] - 1)

    return places


def _known_names(line: NumberedRow, delimiter: str) -> int:
    """Return how many cells of a line name a channel."""
    return sum(
        parse_column_name(cell, channel.units).stem
        in (*channel.spellings, *channel.machine_words)
        for cell in split_line(line.text, delimiter)
        for channel in KNOWLEDGE.channels.values()
    )


def _are_units(
    lines: Sequence[NumberedRow], delimiter: str, texts: Sequence[int]
) -> bool:
    """Return whether the last of several lines of text holds units.

    It may hold some that are not known, if the line above names channels and it none.
    """
    line = lines[texts[-1]]
    cells = split_line(line.text, delimiter)
    if KNOWLEDGE.is_row_of_units(cells):
        return True

    filled = [cell for cell in cells if cell.strip()]
    known = sum(KNOWLEDGE.is_unit(unit_in_brackets(cell) or cell) for cell in filled)
    names_above = _known_names(lines[texts[-2]], delimiter)
    return 2 * known >= len(filled) and bool(
        names_above and not _known_names(line, delimiter)
    )


class _Names(NamedTuple):
    """Names of columns, each once, and what is odd about them."""

    names: tuple[str, ...]
    warnings: tuple[str, ...]


def _unique_names(
    line: NumberedRow, delimiter: str, width: int, rows: Sequence[NumberedRow]
) -> _Names:
    """Return the names in a header; those that stand twice are called by their number.

    Where equal names have equal cells below, the first keeps its name.

    Args:
        line: The header.
        delimiter: Between cells.
        width: How many columns there are.
        rows: The first lines below the header.
    """
    texts = [cell.strip() for cell in split_line(line.text, delimiter)[:width]]
    names = [text or f"column_{number}" for number, text in enumerate(texts, 1)]
    warnings: list[str] = []
    for text in dict.fromkeys(texts):
        places = [place for place, other in enumerate(texts) if text and other == text]
        if len(places) < 2:
            continue

        are_equal = _are_equal(rows, delimiter, places)
        renamed = places[1:] if are_equal else places
        for place in renamed:
            names[place] = f"column_{place + 1}"

        listed = " and ".join(names[place] for place in renamed)
        which = "; the others, equal in the first rows," if are_equal else "; these"
        warnings.append(
            f"the header, line {line.line_number}, names {text!r} twice{which} are "
            f"called {listed}"
        )

    return _Names(tuple(names), tuple(warnings))


def _are_equal(
    rows: Iterable[NumberedRow], delimiter: str, places: Sequence[int]
) -> bool:
    """Return whether some columns have equal cells in all rows."""
    for row in rows:
        cells = split_line(row.text, delimiter)
        if len({cells[place] for place in places if place < len(cells)}) > 1:
            return False

    return True


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


def _start_without_header(
    rows: Sequence[NumberedRow],
    comments: Sequence[NumberedRow],
    delimiters: Iterable[str],
) -> TableStart | None:
    """Return a table whose names stand in a comment (`numpy.savetxt`), or nowhere."""
    starts: list[TableStart] = []
    fractions: list[float] = []
    for delimiter in delimiters:
        for place, line in enumerate(rows):
            cells = split_line(line.text, delimiter)
            fraction = sum(map(is_number, cells)) / len(cells)
            if fraction >= MIN_NUMBERS_WITHOUT_HEADER and "\0" not in line.text:
                above = () if place else comments
                starts.append(_nameless_start(line, place, above, delimiter))
                fractions.append(fraction)
                break

    usable = [
        (fraction, start)
        for fraction, start in zip(fractions, starts, strict=True)
        if start.header_line or len(start.names) >= MIN_COLUMNS_WITHOUT_HEADER
    ]
    if not usable:
        return None

    best = max(fraction for fraction, _ in usable)
    start = next(start for fraction, start in usable if fraction == best)
    damaged = [line for line in rows[: start.first_row] if "\0" in line.text]
    notes = tuple(
        f"line {line.line_number}, above the table, has NUL bytes and was left out"
        for line in damaged[-1:]
    )
    return replace(
        start,
        row_count=len(rows) - start.first_row,
        warnings=(*notes, *start.warnings),
    )


def _nameless_start(
    line: NumberedRow, place: int, comments: Sequence[NumberedRow], delimiter: str
) -> TableStart:
    """Return a table that begins with a row, named by a comment or by numbers."""
    width = len(split_line(line.text, delimiter))
    texts = [
        NumberedRow(comment.line_number, comment.text.lstrip(COMMENT))
        for comment in comments
    ]
    headers = [
        text
        for text in texts
        if _fits(split_line(text.text, delimiter), width)
        and not any(map(is_number, split_line(text.text, delimiter)))
    ]
    if headers and texts[-1] in headers:
        header = headers[-1]
        units: dict[str, StatedUnit] = {}
        unit_cells = split_line(header.text, delimiter)
        if len(headers) > 1 and KNOWLEDGE.is_row_of_units(unit_cells):
            header = headers[-2]

        names, warnings = _unique_names(header, delimiter, width, [line])
        if header is not headers[-1]:
            units = _stated_units(names, unit_cells, headers[-1].line_number)

        return TableStart(
            delimiter, names, place, 1, header.line_number, units, warnings
        )

    return TableStart(
        delimiter=delimiter,
        names=tuple(f"column_{number}" for number in range(1, width + 1)),
        first_row=place,
        row_count=1,
        warnings=(
            f"there is no header: line {line.line_number} ({_quoted(line)}) is a row "
            "of numbers without names above it; its columns are called column_1 to "
            f"column_{width}",
        ),
    )


def _no_table(lines: Sequence[NumberedRow]) -> FormatError:
    """Return the error for lines in which no table begins, naming a line."""
    first = lines[0]
    if 2 * sum("\0" in line.text for line in lines) > len(lines):
        return FormatError(
            f"it is not text: line {first.line_number} holds NUL bytes; expected a "
            "header row and rows of numbers"
        )

    numbers = _first_with_number(lines)
    if numbers is None and len(lines) == 1:
        return FormatError(
            f"a header but no rows; the header is line {first.line_number}: "
            f"{first.text.strip()[:200]}"
        )
    if numbers is None:
        return FormatError(
            f"no row of numbers in lines {first.line_number} to "
            f"{lines[-1].line_number}, which begin with {_quoted(first)}; {_EXPECTED}"
        )

    return FormatError(
        f"no table: line {numbers.line_number} ({_quoted(numbers)}) is the first with "
        f"numbers, and no line above it has as many cells; {_EXPECTED}"
    )


def _first_with_number(lines: Sequence[NumberedRow]) -> NumberedRow | None:
    """Return the first line that has a number in any way to separate its cells."""
    for line in lines:
        for delimiter in (*_DELIMITERS, WHITE_SPACE):
            cells = split_line(line.text, delimiter)
            if any(map(is_number, cells)):
                return line

    return None


def _quoted(line: NumberedRow) -> str:
    """Return how a line begins, for a message."""
    return repr(line.text.strip()[:MAX_QUOTED_CHARACTERS])
