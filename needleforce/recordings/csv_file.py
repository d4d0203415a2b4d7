"""CSV and its kin, plain or compressed with gzip: read whole or as it comes, and written."""

import csv
import gzip
import io
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from math import nan
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from needleforce.recordings.errors import MAX_BYTES, FormatError, require_size
from needleforce.recordings.follow import TextLines
from needleforce.recordings.table import (
    START_KEY,
    Columns,
    FloatArray,
    Labels,
    Table,
    exceed_float64,
    flat_columns,
)

CSV_SUFFIXES = (".csv", ".csv.gz", ".tsv", ".tsv.gz", ".txt")

HEAD_ROWS = 200
"""So many rows decide which columns a stream has; they come in one table, however they arrive."""

_ROW_BYTES = 100
"""What Python adds to the text of a row."""
_DELIMITERS = (",", ";", "\t")
_COMMENT = "#"
_START = re.compile(rf"{_COMMENT}\s*{START_KEY}\s*=\s*(-?\d{{1,19}})\s*$")
_EXPECTED = (
    "cells are separated by commas, semicolons or tabs, and what stands above the header begins "
    "with #"
)


class _Header(NamedTuple):
    """Column names, unique; a column without one is `column_N`; and what separates the cells."""

    names: tuple[str, ...]
    delimiter: str
    is_comment: bool = False  # so that the line after it holds data


def _read_header(line: str, line_number: int, comment: str) -> _Header:
    """Read the header from the first line that is neither blank nor a comment.

    A comment just before it counts as the header if that line holds numbers and the comment has
    as many cells (`numpy.savetxt` writes its header so).
    """
    delimiter = max(_DELIMITERS, key=line.count)
    cells = [cell.strip() for cell in _split_line(line, delimiter)]
    if all(_number(cell) is None for cell in cells):
        return _Header(_unique(cells), delimiter)
    names = [cell.strip() for cell in _split_line(comment.lstrip(_COMMENT), delimiter)]
    if not comment or len(names) != len(cells) or any(_number(n) is not None for n in names):
        raise FormatError(
            f"no header row: line {line_number} already holds numbers ({line[:60]!r}). "
            "Add a line with the column names above it"
        )
    return _Header(_unique(names), delimiter, is_comment=True)


def _unique(names: list[str]) -> tuple[str, ...]:
    places: dict[str, int] = {}
    for i, given in enumerate(names, 1):
        name = given or f"column_{i}"
        if places.setdefault(name, i) != i:
            raise FormatError(f"the header names {name!r} twice, in columns {places[name]} and {i}")
    return tuple(places)


def _split_line(line: str, delimiter: str) -> list[str]:
    """Split a line into cells; a quoted cell ends with its line, whatever quotes stray."""
    if '"' not in line:
        return line.split(delimiter)
    try:
        return next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))
    except csv.Error:
        return line.split(delimiter)


def _number(cell: str) -> float | None:
    try:
        return float(cell)
    except ValueError:
        return None


class _Rows:
    """Sorts lines into header, comments and rows; lines starting with `#` are comments."""

    def __init__(self) -> None:
        self.header: Any = None  # a `_Header` once it was found
        self._header_line = self._comment = ""
        self._lines = self._total = 0
        self.rows: list[str] = []
        """Rows that wait to be read, and where each stands in the file."""
        self.numbers: list[int] = []
        self.start_ns = 0
        """The start of the clock, if a comment before the header says it."""
        self.notes: list[str] = []

    def add(self, lines: list[str]) -> None:
        """Take whole lines; `FormatError` if the header is none, or names a column twice."""
        if self.header is None:
            lines = self._find_header(lines)
        first = self._lines + 1
        self._lines += len(lines)
        rows = [line for line in lines if _is_row(line)]
        if len(rows) == len(lines):
            self.numbers += range(first, first + len(lines))
        else:
            self.numbers += [n for n, line in enumerate(lines, first) if _is_row(line)]
        self.rows += rows
        self._total += len(rows)

    def end(self, tail: str, *, is_growing: bool) -> None:
        """Take what stands behind the last line end; `FormatError` if there was no row.

        It is a row if it has the header's cells: whether its last number is cut cannot be known,
        unless the file was still being written.
        """
        if self.header is not None and self._total and _is_row(tail):
            cells = tail.count(self.header.delimiter) + 1
            names = len(self.header.names)
            if cells < names or is_growing:
                self.notes.append(
                    f"line {self._lines + 1}, the last, is cut short "
                    f"({cells} of {names} cells) and was left out"
                )
                tail = ""
        self.add([tail])
        if self.header is None:
            raise FormatError("only comments; expected a header row and rows of numbers")
        if not self._total:
            header = self._header_line.strip()[:200]
            raise FormatError(f"a header but no rows; the header is: {header}")

    def _find_header(self, lines: list[str]) -> list[str]:
        """Return the lines after the header, or none if it was not among them."""
        for i, line in enumerate(lines):
            if _is_row(line):
                self.header = _read_header(line, self._lines + i + 1, self._comment)
                self._header_line = line
                past = i if self.header.is_comment else i + 1
                self._lines += past
                return lines[past:]
            if line.strip():
                self._comment = line
            if match := _START.match(line):
                self.start_ns = int(match[1])
        self._lines += len(lines)
        return []


def _is_row(line: str) -> bool:
    return bool(line) and line[0] != _COMMENT and not line.isspace()


class _Columns:
    """Turns rows into columns, the same columns whenever more rows come.

    Rows with another number of cells than the header are left out, and so are columns without any
    number in the first rows read.
    """

    def __init__(self, header: _Header) -> None:
        self._names, self._delimiter, _ = header
        self._left_out: dict[int, str] | None = None
        self._faults: dict[object, tuple[int, str]] = {}
        self._has_number: set[int] = set()

    def read(self, rows: Sequence[str], numbers: Sequence[int]) -> tuple[Columns, Mapping]:
        """Return the columns of some rows, and those of whole numbers that float64 would round."""
        is_first, width = self._left_out is None, len(self._names)
        values = self._read_fast(rows)
        if values is None:
            values = self._read_cells(rows, numbers)
            self._left_out = self._choose(values) if is_first else self._left_out
        left_out = self._left_out = self._left_out or {}
        columns = {self._names[i]: values[:, i] for i in range(width) if i not in left_out}
        return columns, self._exact(rows, columns)

    def _read_fast(self, rows: Sequence[str]) -> FloatArray | None:
        """Return the rows if they are all numbers, as many as the header has names."""
        try:
            values = np.loadtxt(rows, delimiter=self._delimiter, comments=None, ndmin=2)
        except ValueError:
            return None
        return values if values.shape[1] == len(self._names) else None

    def _read_cells(self, rows: Sequence[str], numbers: Sequence[int]) -> FloatArray:
        """Read cell by cell: slower, but it can say what is wrong."""
        found: list[list[float]] = []
        for line_number, row in zip(numbers, rows, strict=True):
            cells = self._cells(row)
            if len(cells) == len(self._names):
                found.append([self._cell(line_number, i, cell) for i, cell in enumerate(cells)])
            else:
                self._note("ragged", f"line {line_number} with {len(cells)}")
        return np.array(found, dtype=np.float64).reshape(-1, len(self._names))

    def _cells(self, row: str) -> list[str]:
        cells = _split_line(row, self._delimiter)
        while len(cells) > len(self._names) and not cells[-1].strip():
            cells.pop()
        return cells

    def _cell(self, line: int, column: int, cell: str) -> float:
        value = _number(cell)
        if value is None and not cell.strip():
            return nan
        if value is None and self._delimiter != ",":
            value = _number(cell.replace(",", "."))
            if value is not None:
                self._note("commas", f"line {line}")
        if value is None:
            self._note(column, f"line {line}, {cell.strip()[:40]!r}")
            return nan
        self._has_number.add(column)
        return value

    def _note(self, kind: object, text: str) -> None:
        count, first = self._faults.get(kind, (0, text))
        self._faults[kind] = count + 1, first

    def _choose(self, values: FloatArray) -> dict[int, str]:
        """Decide from the first rows which columns are left out."""
        width = len(self._names)
        if not len(values):
            raise FormatError(
                f"no row has the header's {width} cells (first: {self._faults['ragged'][1]}); "
                f"check the delimiter and the header: {_EXPECTED}"
            )
        left_out = {}
        for i in sorted(set(range(width)) - self._has_number):
            why = f"holds text ({self._faults[i][1]})" if i in self._faults else "is empty"
            left_out[i] = f"column {self._names[i]!r} {why} and was left out"
        if len(left_out) == width:
            reasons = "; ".join(left_out.values())
            raise FormatError(f"no column holds a number: {reasons[:500]}; {_EXPECTED}")
        return left_out

    def _exact(self, rows: Sequence[str], columns: Columns) -> dict[str, NDArray[np.int64]]:
        """Read columns of whole numbers that float64 would round once more, without loss."""
        found: dict[str, NDArray[np.int64]] = {}
        for name, values in columns.items():
            if not exceed_float64(values):
                continue
            i = self._names.index(name)
            cells = (self._cells(row) for row in rows)
            try:
                texts = [row[i] for row in cells if len(row) == len(self._names)]
                stamps = np.array([int(text) for text in texts], dtype=np.int64)
            except (ValueError, OverflowError):
                continue
            found[name] = stamps
        return found

    @property
    def kept(self) -> list[str]:
        """The names of the columns that are read."""
        return [n for i, n in enumerate(self._names) if i not in (self._left_out or {})]

    @property
    def omitted(self) -> tuple[str, ...]:
        """Which columns were left out, and why."""
        return tuple((self._left_out or {}).values())

    def notes(self) -> tuple[str, ...]:
        """What was left out or could not be read so far, in words."""
        notes, left_out = [], self._left_out or {}
        columns = {i for i in self._faults if isinstance(i, int)} | left_out.keys()
        for i in sorted(columns):
            count, first = self._faults.get(i, (0, ""))
            notes.append(
                left_out.get(i)
                or f"column {self._names[i]!r}: cells that are not numbers, read as NaN: {count} "
                f"(first: {first})"
            )
        if "ragged" in self._faults:
            count, first = self._faults["ragged"]
            width = len(self._names)
            notes.append(
                f"rows without the header's {width} cells, left out: {count} (first: {first})"
            )
        if "commas" in self._faults:
            notes.append(f"decimal commas read as points (first: {self._faults['commas'][1]})")
        return tuple(notes)


def csv_tables(
    blocks: Iterable[bytes],
    name: str,
    *,
    head_rows: int | None = HEAD_ROWS,
    is_growing: bool = False,
    is_stopped: Callable[[], bool] = lambda: False,
    max_bytes: int = MAX_BYTES,
) -> Iterator[Table]:
    """Read CSV text as it comes: a header row, then rows of numbers.

    Args:
        blocks: bytes as read.
        name: of the source, for errors.
        head_rows: least rows of the first table; None to read all into one.
        is_growing: whether the source may end in the middle of a line that is being written.
        is_stopped: asked at the end, whether it is one only because the user wanted no more.
        max_bytes: the most bytes of text that wait to be read.

    Yields:
        Tables of consecutive rows with equal columns; then one without rows, whose warnings
        report all that was wrong.
    """
    lines, rows = TextLines(blocks), _Rows()
    columns: _Columns | None = None
    read_until = 0

    def table() -> Table:
        nonlocal columns, read_until
        columns = columns or _Columns(rows.header)
        found, stamps = columns.read(rows.rows, rows.numbers)
        rows.rows, rows.numbers, read_until = [], [], lines.size
        return Table(columns=found, start_ns=rows.start_ns, stamps=stamps, omitted=columns.omitted)

    try:
        for batch in lines:
            rows.add(batch)
            if head_rows is not None and len(rows.rows) >= (1 if columns else head_rows):
                yield table()
            waiting = lines.size - read_until + _ROW_BYTES * len(rows.rows)
            require_size(waiting, max_bytes, "its text")
        if is_stopped():
            lines.forgive_end()
        rows.end(lines.tail, is_growing=is_growing)
        if rows.rows:
            yield table()
    except FormatError as error:
        lost = "".join(f" ({warning})" for warning in lines.warnings)
        raise FormatError(f"{name}: {error}{lost}") from error
    assert columns is not None
    yield Table(
        columns=dict.fromkeys(columns.kept, np.empty(0)),
        warnings=(*lines.warnings, *rows.notes, *columns.notes()),
    )


class CsvWriter:
    """Writes a header, then rows; floats so that they read back bit for bit.

    The start of the clock, unless it is zero, goes into a comment.
    """

    def __init__(self, stream: BinaryIO, labels: Labels) -> None:
        self._comment = f"# {START_KEY} = {labels.start_ns}\n" if labels.start_ns else ""
        self._stream = stream
        self._has_header = False

    def append(self, columns: Columns) -> None:
        """Write rows of checked columns, the same in every call."""
        flat = flat_columns(columns)
        if not self._has_header:
            header = io.StringIO()
            csv.writer(header, lineterminator="\n").writerow(flat)
            self._stream.write((self._comment + header.getvalue()).encode())
            self._has_header = True
        # repr is the shortest text that reads back to the same float.
        cells = (v.astype(int) if v.dtype.kind == "b" else v for v in flat.values())
        texts = (map(repr, column.tolist()) for column in cells)
        if rows := [",".join(row) for row in zip(*texts, strict=True)]:
            self._stream.write(("\n".join(rows) + "\n").encode())

    def flush(self) -> None:
        """Let readers of the file see what was written."""
        self._stream.flush()

    def finish(self) -> None:
        """Write what is still held back."""
        self._stream.flush()


class CsvGzipWriter(CsvWriter):
    """The same, compressed with gzip."""

    def __init__(self, stream: BinaryIO, labels: Labels) -> None:
        # No name and no time in the archive: the same columns give the same bytes.
        packed = gzip.GzipFile(filename="", mode="wb", fileobj=stream, mtime=0, compresslevel=3)
        super().__init__(packed, labels)  # type: ignore[arg-type]

    def finish(self) -> None:
        """Write what is still held back, and the end of the archive."""
        self._stream.close()
