"""CSV and its kin, plain or compressed with gzip: read whole or as it comes."""

import csv
import re
from collections.abc import Iterable, Iterator
from contextlib import suppress
from math import nan
from typing import NamedTuple

import numpy as np

from needleforce.recordings.errors import (
    MAX_BYTES,
    FaultCount,
    FaultCounts,
    FormatError,
    require_size,
)
from needleforce.recordings.follow import FollowOptions
from needleforce.recordings.table import HEAD_ROWS, START_KEY, Table
from needleforce.recordings.text_lines import TextLines
from needleforce.recordings.time_stamps import exceed_float64

CSV_SUFFIXES = (".csv", ".csv.gz", ".tsv", ".tsv.gz", ".txt")

ROW_BYTES = 100
"""Memory that Python adds to the text of a row."""

MAX_LINES_WITHOUT_ROW = 1_000_000
"""A megabyte of gzip can hold a thousand million line ends, which take minutes to
look at."""

_DELIMITERS = (",", ";", "\t")
_COMMENT = "#"
_START_COMMENT = re.compile(rf"{_COMMENT}\s*{START_KEY}\s*=\s*(-?\d{{1,19}})\s*$")
_EXPECTED = (
    "cells are separated by commas, semicolons or tabs, and what stands above the "
    "header begins with #"
)


class NumberedRow(NamedTuple):
    """A row of a table as text.

    Attributes:
        line_number: In the file, from 1.
        text: The line.
    """

    line_number: int
    text: str


class _CsvRows:
    """Sorts lines into header, comments and rows, and turns rows into columns.

    Lines starting with `#` are comments. Rows with another number of cells than the
    header are left out, and so are columns without any number in the first rows read;
    which these are does not depend on how the lines come.

    Attributes:
        names: Of the columns, unique; one without a name is `column_N`.
        waiting: Rows that wait to be read.
        omitted: Which columns are left out, by their place, and why.
        faults: What is wrong with rows and cells.
    """

    def __init__(self) -> None:
        self.names: tuple[str, ...] = ()
        self.waiting: list[NumberedRow] = []
        self.omitted: dict[int, str] = {}
        self.faults = FaultCounts()
        self._delimiter = ","
        self._latest_comment = ""
        self._header = ""
        self._line_count = 0
        self._latest_row_line = 0
        self._start_ns = 0
        self._is_chosen = False  # which columns are left out
        self._has_number: set[int] = set()

    def add(self, lines: list[str]) -> None:
        """Add whole lines.

        Raises:
            FormatError: The header is none, or names a column twice; or no row has come
                for very many lines.
        """
        for line_number, line in enumerate(lines, self._line_count + 1):
            if _is_row(line):
                if self.names or self._read_header(line, line_number):
                    self.waiting.append(NumberedRow(line_number, line))
            elif not self.names and line.strip():
                self._latest_comment = line
                if match := _START_COMMENT.match(line):
                    self._start_ns = int(match[1])

        self._line_count += len(lines)
        if self.waiting:
            self._latest_row_line = self.waiting[-1].line_number

        if self._line_count - self._latest_row_line > MAX_LINES_WITHOUT_ROW:
            raise FormatError(
                f"{MAX_LINES_WITHOUT_ROW} lines after line {self._latest_row_line} are "
                "blank or comments; it is damaged, or no table"
            )

    def end(self, tail: str, *, is_growing: bool) -> None:
        """Add what stands behind the last line end.

        It is a row if it has the header's cells: whether its last number is cut cannot
        be known, unless the file was still being written.

        Raises:
            FormatError: There was no header, or no row.
        """
        if self._latest_row_line and _is_row(tail):
            cell_count = tail.count(self._delimiter) + 1
            if cell_count < len(self.names) or is_growing:
                self.faults.note(
                    f"line {self._line_count + 1}, the last, is cut short "
                    f"({cell_count} of {len(self.names)} cells) and was left out",
                    "",
                )
                tail = ""

        self.add([tail])
        if not self.names:
            raise FormatError(
                "only comments; expected a header row and rows of numbers"
            )

        if not self._latest_row_line:
            header = self._header.strip()[:200]
            raise FormatError(f"a header but no rows; the header is: {header}")

    def _read_header(self, line: str, line_number: int) -> bool:
        """Read the header from the first line that is no comment.

        A comment just before it counts as the header if that line holds numbers and the
        comment has as many cells (`numpy.savetxt` writes its header so).

        Returns:
            Whether the line is a row.
        """
        self._delimiter = max(_DELIMITERS, key=line.count)
        self._header = line
        cells = self._split(line)
        names = cells
        is_row = _has_number(cells)
        if is_row:
            comment = self._latest_comment
            names = self._split(comment.lstrip(_COMMENT))
            is_header = not _has_number(names) and len(names) == len(cells)
            if not (comment and is_header):
                raise FormatError(
                    f"no header row: line {line_number} already holds numbers "
                    f"({line[:60]!r})"
                )

        places: dict[str, int] = {}
        for place, text in enumerate(names, 1):
            name = text.strip() or f"column_{place}"
            if places.setdefault(name, place) != place:
                raise FormatError(
                    f"the header names {name!r} twice, in columns {places[name]} and "
                    f"{place}"
                )

        self.names = tuple(places)
        return is_row

    def _split(self, line: str) -> list[str]:
        """Split a line into cells; a quoted cell ends with its line at the latest."""
        if '"' in line:
            with suppress(csv.Error):
                return next(
                    csv.reader([line], delimiter=self._delimiter, skipinitialspace=True)
                )

        return line.split(self._delimiter)

    def _split_row(self, line: str) -> list[str]:
        """Split a row into cells, without empty ones behind the header's."""
        cells = self._split(line)
        while len(cells) > len(self.names) and not cells[-1].strip():
            cells.pop()

        return cells

    def read_waiting(self) -> Table:
        """Return waiting rows as a table, at first `HEAD_ROWS` of them.

        The first ones say which columns are left out.
        """
        rows = self.waiting if self._is_chosen else self.waiting[:HEAD_ROWS]
        values = self._read_fast(rows)
        if values is None:
            values = self._read_by_cell(rows)
            if not self._is_chosen:
                self._choose_columns(len(values))

        warnings = () if self._is_chosen else tuple(self.omitted.values())
        self._is_chosen = True

        columns: dict[str, np.ndarray] = {
            name: values[:, i]
            for i, name in enumerate(self.names)
            if i not in self.omitted
        }
        self._restore_large_integers(columns, rows)
        self.waiting = self.waiting[len(rows) :]
        return Table(columns=columns, start_ns=self._start_ns, warnings=warnings)

    def _read_fast(self, rows: list[NumberedRow]) -> np.ndarray | None:
        """Return the numbers in rows, shape (n, k), if all cells hold numbers."""
        lines = [row.text for row in rows]
        try:
            values = np.loadtxt(
                lines, delimiter=self._delimiter, comments=None, ndmin=2
            )
        except ValueError:
            return None

        return values if values.shape[1] == len(self.names) else None

    def _read_by_cell(self, rows: list[NumberedRow]) -> np.ndarray:
        """Return the numbers in rows, shape (n, k), and note what is wrong."""
        width = len(self.names)
        numbers = []
        for line_number, line in rows:
            cells = self._split_row(line)
            if len(cells) == width:
                numbers.append(self._read_cells(line_number, cells))
            else:
                self.faults.note(
                    f"rows without the header's {width} cells, left out",
                    f"line {line_number} with {len(cells)}",
                )

        return np.array(numbers, dtype=np.float64).reshape(-1, width)

    def _restore_large_integers(
        self, columns: dict[str, np.ndarray], rows: list[NumberedRow]
    ) -> None:
        """Read whole numbers that float64 would round once more, as int64."""
        for name, values in list(columns.items()):
            if not exceed_float64(values):
                continue

            place = self.names.index(name)
            all_cells = (self._split_row(row.text) for row in rows)
            texts = [
                cells[place] for cells in all_cells if len(cells) == len(self.names)
            ]
            with suppress(ValueError, OverflowError):  # some are no whole numbers
                columns[name] = np.array([int(text) for text in texts], dtype=np.int64)

    def _read_cells(self, line_number: int, cells: list[str]) -> list[float]:
        """Return the numbers in a row's cells; what is none is NaN.

        Text is noted as a fault.
        """
        values = []
        for i, text in enumerate(cells):
            cell = text.strip()
            value = _number(cell)
            if value is None and self._delimiter != ",":
                value = _number(cell.replace(",", "."))
                if value is not None:
                    place = f"line {line_number}"
                    self.faults.note("decimal commas read as points", place)

            if value is not None:
                self._has_number.add(i)
            elif cell and i not in self.omitted:
                place = f"line {line_number}, {cell[:40]!r}"
                self.faults.note(self._not_numbers(i), place)

            values.append(nan if value is None else value)

        return values

    def _not_numbers(self, column: int) -> str:
        """Return the kind of fault that a column has cells of text."""
        return f"column {self.names[column]!r}: cells that are not numbers, read as NaN"

    def _choose_columns(self, row_count: int) -> None:
        """Decide from the first rows which columns are left out."""
        width = len(self.names)
        if not row_count:
            first = next(iter(self.faults.values())).first
            raise FormatError(
                f"no row has the header's {width} cells (first: {first}); "
                f"check the delimiter and the header: {_EXPECTED}"
            )

        for i in sorted(set(range(width)) - self._has_number):
            text = self.faults.pop(self._not_numbers(i), FaultCount(0, "")).first
            reason = f"holds text ({text})" if text else "is empty"
            self.omitted[i] = f"column {self.names[i]!r} {reason} and was left out"

        if len(self.omitted) == width:
            reasons = "; ".join(self.omitted.values())
            raise FormatError(f"no column holds a number: {reasons[:500]}; {_EXPECTED}")


def _is_row(line: str) -> bool:
    """Return whether a line is neither blank nor a comment."""
    return line[:1] not in ("", _COMMENT) and not line.isspace()


def _has_number(cells: Iterable[str]) -> bool:
    """Return whether any cell holds a number."""
    return any(_number(cell) is not None for cell in cells)


def _number(cell: str) -> float | None:
    """Return the number in a cell; None if it holds none."""
    try:
        return None if "_" in cell else float(cell)  # 1_0 is Python's way to write 10
    except ValueError:
        return None


def csv_tables(
    blocks: Iterable[bytes],
    name: str,
    options: FollowOptions | None = None,
    max_bytes: int = MAX_BYTES,
) -> Iterator[Table]:
    """Read CSV text in blocks as it comes: a header row, then rows of numbers.

    Args:
        blocks: The text, plain or compressed with gzip.
        name: Of the source, for errors.
        options: A source that grows may end in the middle of a line that is being
            written.
        max_bytes: The most memory that rows may take before they are read.

    Yields:
        Tables of consecutive rows with equal columns, the first of `HEAD_ROWS` rows if
        there are so many; then one without rows, whose warnings report all that was
        wrong.

    Raises:
        FormatError: It is no such text, or has too long lines.
    """
    lines = TextLines(blocks)
    rows = _CsvRows()
    options = options or FollowOptions()
    is_first = True
    read_bytes = 0
    try:
        for batch in lines:
            rows.add(batch)
            while len(rows.waiting) >= (HEAD_ROWS if is_first else 1):
                yield rows.read_waiting()
                is_first = False
                read_bytes = lines.size

            waiting_bytes = lines.size - read_bytes + ROW_BYTES * len(rows.waiting)
            require_size(waiting_bytes, max_bytes, "its text")

        if options.should_stop():
            lines.forgive_end()

        rows.end(lines.tail, is_growing=options.follow)
        if rows.waiting:
            yield rows.read_waiting()
    except FormatError as error:
        losses = "".join(f" ({warning})" for warning in lines.warnings)
        raise error.reworded(f"{name}: {error}{losses}") from error

    names = [name for i, name in enumerate(rows.names) if i not in rows.omitted]
    warnings = (*lines.warnings, *rows.faults.lines())
    yield Table(columns=dict.fromkeys(names, np.empty(0)), warnings=warnings)
