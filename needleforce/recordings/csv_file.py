"""CSV and its kin, plain or compressed with gzip: read whole or as it comes."""

import csv
import re
from collections.abc import Iterable, Iterator
from contextlib import suppress
from math import nan

import numpy as np

from needleforce.recordings.errors import MAX_BYTES, FormatError, require_size
from needleforce.recordings.follow import FollowOptions, TextLines
from needleforce.recordings.table import (
    HEAD_ROWS,
    START_KEY,
    Faults,
    Table,
    exceed_float64,
)

CSV_SUFFIXES = (".csv", ".csv.gz", ".tsv", ".tsv.gz", ".txt")

_ROW_BYTES = 100  # what Python adds to the text of a row
_MOST_WITHOUT_ROW = 1_000_000
"""A megabyte of gzip can hold a thousand million line ends, which take minutes to
look at."""
_DELIMITERS = (",", ";", "\t")
_COMMENT = "#"
_START = re.compile(rf"{_COMMENT}\s*{START_KEY}\s*=\s*(-?\d{{1,19}})\s*$")
_EXPECTED = (
    "cells are separated by commas, semicolons or tabs, and what stands above the header begins "
    "with #"
)


class _CsvRows:
    """Sorts lines into header, comments and rows, and turns rows into columns, always
    the same.

    Lines starting with `#` are comments. Rows with another number of cells than the
    header are left out, and so are columns without any number in the first rows read.
    """

    def __init__(self) -> None:
        self.names: tuple[
            str, ...
        ] = ()  # unique; a column without a name is `column_N`
        self.rows: list[tuple[int, str]] = []
        """Rows that wait to be read, each with the number of its line."""
        self.omitted: dict[int, str] = {}  # which columns are left out, and why
        self._delimiter = ","
        self._comment = ""
        self._header = ""
        self._lines = self._latest = self._start_ns = 0
        self._is_chosen = False
        self._has_number: set[int] = set()
        self.faults = Faults()

    def add(self, lines: list[str]) -> None:
        """Take whole lines; `FormatError` if the header is none, or names a column
        twice.
        """
        for number, line in enumerate(lines, self._lines + 1):
            if _is_row(line):
                if self.names or self._is_below_header(line, number):
                    self.rows.append((number, line))
            elif not self.names and line.strip():
                self._comment = line
                if match := _START.match(line):
                    self._start_ns = int(match[1])
        self._lines += len(lines)
        self._latest = self.rows[-1][0] if self.rows else self._latest
        if self._lines - self._latest > _MOST_WITHOUT_ROW:
            raise FormatError(
                f"{_MOST_WITHOUT_ROW} lines after line {self._latest} are blank or comments; it is "
                "damaged, or no table: cut it there"
            )

    def end(self, tail: str, *, is_growing: bool) -> None:
        """Take what stands behind the last line end; `FormatError` if there was no row.

        It is a row if it has the header's cells: whether its last number is cut cannot
        be known, unless the file was still being written.
        """
        if self._latest and _is_row(tail):
            cells = tail.count(self._delimiter) + 1
            names = len(self.names)
            if cells < names or is_growing:
                what = f"({cells} of {names} cells) and was left out"
                self.faults.note(
                    f"line {self._lines + 1}, the last, is cut short {what}", ""
                )
                tail = ""
        self.add([tail])
        if not self.names:
            raise FormatError(
                "only comments; expected a header row and rows of numbers"
            )
        if not self._latest:
            header = self._header.strip()[:200]
            raise FormatError(f"a header but no rows; the header is: {header}")

    def _is_below_header(self, line: str, line_number: int) -> bool:
        """Read the header from the first line that is no comment; return whether that
        is a row.

        A comment just before it counts as the header if that line holds numbers and the
        comment has as many cells (`numpy.savetxt` writes its header so).
        """
        self._delimiter = max(_DELIMITERS, key=line.count)
        self._header = line
        names = self._split(line)
        is_row = any(_number(name) is not None for name in names)
        if is_row:
            names = self._split(self._comment.lstrip(_COMMENT))
            is_header = not any(_number(name) is not None for name in names)
            if not (
                self._comment and is_header and len(names) == len(self._split(line))
            ):
                raise FormatError(
                    f"no header row: line {line_number} already holds numbers ({line[:60]!r}). "
                    "Add a line with the column names above it"
                )
        places: dict[str, int] = {}
        for i, given in enumerate(names, 1):
            name = given.strip() or f"column_{i}"
            if places.setdefault(name, i) != i:
                raise FormatError(
                    f"the header names {name!r} twice, in columns {places[name]} and {i}"
                )
        self.names = tuple(places)
        return is_row

    def _split(self, line: str) -> list[str]:
        """Split a line into cells; a quoted cell ends with its line, whatever quotes
        stray.
        """
        if '"' in line:
            with suppress(csv.Error):
                return next(
                    csv.reader([line], delimiter=self._delimiter, skipinitialspace=True)
                )
        return line.split(self._delimiter)

    def table(self) -> Table:
        """Return waiting rows as a table; the first `HEAD_ROWS` say which columns
        are left out.
        """
        taken = self.rows if self._is_chosen else self.rows[:HEAD_ROWS]
        rows = [row for _, row in taken]
        width = len(self.names)
        try:
            values = np.loadtxt(rows, delimiter=self._delimiter, comments=None, ndmin=2)
        except ValueError:
            values = np.empty((0, 0))
        if values.shape[1] != width:
            # Cell by cell is slower, but it can say what is wrong.
            found = []
            for n, row in taken:
                cells = self._split_row(row)
                if len(cells) == width:
                    found.append(self._values(n, cells))
                else:
                    what = f"rows without the header's {width} cells, left out"
                    self.faults.note(what, f"line {n} with {len(cells)}")
            values = np.array(found, dtype=np.float64).reshape(-1, width)
            if not self._is_chosen:
                self._choose(len(values))
        warnings = () if self._is_chosen else tuple(self.omitted.values())
        self._is_chosen = True
        kept = (i for i in range(width) if i not in self.omitted)
        columns: dict[str, np.ndarray] = {self.names[i]: values[:, i] for i in kept}
        for name in [
            name for name, column in columns.items() if exceed_float64(column)
        ]:
            cells = (self._split_row(row) for row in rows)
            whole = [row[self.names.index(name)] for row in cells if len(row) == width]
            with suppress(ValueError, OverflowError):  # some are no whole numbers
                columns[name] = np.array([int(cell) for cell in whole], dtype=np.int64)
        self.rows = self.rows[len(taken) :]
        return Table(columns=columns, start_ns=self._start_ns, warnings=warnings)

    def _split_row(self, row: str) -> list[str]:
        cells = self._split(row)
        while len(cells) > len(self.names) and not cells[-1].strip():
            cells.pop()
        return cells

    def _values(self, line: int, cells: list[str]) -> list[float]:
        """Return the numbers in a row's cells; what is none is NaN, and noted if it
        is text.
        """
        values = []
        for i, text in enumerate(cells):
            cell = text.strip()
            value = _number(cell)
            if value is None and self._delimiter != ",":
                value = _number(cell.replace(",", "."))
                if value is not None:
                    self.faults.note("decimal commas read as points", f"line {line}")
            if value is not None:
                self._has_number.add(i)
            elif cell and i not in self.omitted:
                self.faults.note(self._not_numbers(i), f"line {line}, {cell[:40]!r}")
            values.append(nan if value is None else value)
        return values

    def _not_numbers(self, column: int) -> str:
        return f"column {self.names[column]!r}: cells that are not numbers, read as NaN"

    def _choose(self, rows: int) -> None:
        """Decide from the first rows which columns are left out."""
        width = len(self.names)
        if not rows:
            _, first = next(iter(self.faults.values()))
            raise FormatError(
                f"no row has the header's {width} cells (first: {first}); "
                f"check the delimiter and the header: {_EXPECTED}"
            )
        for i in sorted(set(range(width)) - self._has_number):
            _, first = self.faults.pop(self._not_numbers(i), (0, ""))
            why = f"holds text ({first})" if first else "is empty"
            self.omitted[i] = f"column {self.names[i]!r} {why} and was left out"
        if len(self.omitted) == width:
            reasons = "; ".join(self.omitted.values())
            raise FormatError(f"no column holds a number: {reasons[:500]}; {_EXPECTED}")


def _is_row(line: str) -> bool:
    return line[:1] not in ("", _COMMENT) and not line.isspace()


def _number(cell: str) -> float | None:
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

    Yield tables of consecutive rows with equal columns, the first of `HEAD_ROWS` rows
    if there are so many; then one without rows, whose warnings report all that was
    wrong. A source that grows may end in the middle of a line that is being written.
    `name` stands in errors.
    """
    lines = TextLines(blocks)
    rows = _CsvRows()
    options = options or FollowOptions()
    is_first = True
    read_until = 0
    try:
        for batch in lines:
            rows.add(batch)
            while len(rows.rows) >= (HEAD_ROWS if is_first else 1):
                yield rows.table()
                is_first = False
                read_until = lines.size
            waiting = lines.size - read_until + _ROW_BYTES * len(rows.rows)
            require_size(waiting, max_bytes, "its text")
        if options.should_stop():
            lines.forgive_end()
        rows.end(lines.tail, is_growing=options.follow)
        if rows.rows:
            yield rows.table()
    except FormatError as error:
        lost = "".join(f" ({warning})" for warning in lines.warnings)
        raise FormatError(f"{name}: {error}{lost}") from error
    kept = [name for i, name in enumerate(rows.names) if i not in rows.omitted]
    warnings = (*lines.warnings, *rows.faults.lines())
    yield Table(columns=dict.fromkeys(kept, np.empty(0)), warnings=warnings)
