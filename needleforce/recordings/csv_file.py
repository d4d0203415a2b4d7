"""CSV and its kin, plain or compressed with gzip: read whole or as it comes."""

import re
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from math import nan

import numpy as np

from needleforce.recordings.csv_header import (
    COMMENT,
    WHITE_SPACE,
    NumberedRow,
    TableStart,
    find_table,
    split_line,
)
from needleforce.recordings.errors import (
    MAX_BYTES,
    FaultCount,
    FaultCounts,
    FormatError,
    require_size,
)
from needleforce.recordings.exported_joints import (
    JointGroup,
    find_joint_groups,
    group_columns,
)
from needleforce.recordings.follow import FollowOptions
from needleforce.recordings.table import HEAD_ROWS, START_KEY, StatedUnit, Table
from needleforce.recordings.text_lines import TextLines
from needleforce.recordings.time_stamps import exceed_float64
from needleforce.recordings.written_numbers import (
    Commas,
    meaning_of_commas,
    read_number,
    read_with_commas,
)

CSV_SUFFIXES = (
    ".csv",
    ".csv.gz",
    ".tsv",
    ".tsv.gz",
    ".txt",
    ".txt.gz",
    ".dat",
    ".asc",
    ".lvm",
)

ROW_BYTES = 100
"""Memory that Python adds to the text of a row."""

MAX_LINES_WITHOUT_ROW = 1_000_000
"""A megabyte of gzip can hold a thousand million line ends, which take minutes to
look at."""

LINES_LOOKED_AT = (HEAD_ROWS + 1, HEAD_ROWS + 50, 400, 800, 1600, 3200, 5000)
"""After so many lines, blank ones and comments aside, the table is looked for; the last
time it must be there."""

NAMING_COMMENTS = 2
"""So many comments above the first row may hold its names and units."""

_START_COMMENT = re.compile(rf"{COMMENT}\s*{START_KEY}\s*=\s*(-?\d{{1,19}})\s*$")
_NUL = "\0"


class _CsvRows:
    """Sorts lines into what stands above the table, comments and rows.

    Lines starting with `#` are comments. Where the table begins is decided from the
    first rows, see `find_table`. Rows with another number of cells than the header are
    left out, and so are columns without any number in the first rows read; which these
    are does not depend on how the lines come.

    Attributes:
        names: Of the columns, unique; one without a name is `column_N`. None before the
            table has been found.
        units: What a row of units says, by name of the column.
        waiting: Rows that wait to be read; before the table has been found all lines.
        omitted: Which columns are left out, by their place, and why.
        faults: What is wrong with rows and cells.
        joint_groups: Columns that hold joints by name, once the first rows were read.
    """

    def __init__(self) -> None:
        self.names: tuple[str, ...] = ()
        self.units: dict[str, StatedUnit] = {}
        self.waiting: list[NumberedRow] = []
        self.omitted: dict[int, str] = {}
        self.faults = FaultCounts()
        self.joint_groups: list[JointGroup] = []
        self._delimiter = ","
        self._commas = Commas.UNKNOWN
        self._comments: deque[NumberedRow] = deque(maxlen=NAMING_COMMENTS)
        self._header_warnings: tuple[str, ...] = ()
        self._has_header = False
        self._looks = 0
        self._line_count = 0
        self._latest_row_line = 0
        self._start_ns = 0
        self._is_chosen = False  # which columns are left out
        self._has_number: set[int] = set()

    def add(self, lines: Sequence[str]) -> None:
        """Add whole lines.

        Raises:
            FormatError: There is no table in very many lines, or no row has come for
                very many.
        """
        for line_number, line in enumerate(lines, self._line_count + 1):
            if _is_row(line):
                self.waiting.append(NumberedRow(line_number, line))
            elif not self.waiting and line.strip():
                self._comments.append(NumberedRow(line_number, line))
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

    def find_head(self) -> bool:
        """Return whether the table has been found, and its first rows have come.

        Whatever the pieces in which lines come, the same numbers of them are looked at.

        Raises:
            FormatError: In very many lines there is no table.
        """
        while not self.names and len(self.waiting) >= LINES_LOOKED_AT[self._looks]:
            lines = self.waiting[: LINES_LOOKED_AT[self._looks]]
            self._looks += 1
            if self._looks == len(LINES_LOOKED_AT):
                self._begin(find_table(lines, self._comments))
                break

            with suppress(FormatError):
                start = find_table(lines, self._comments)
                if start.row_count >= HEAD_ROWS:
                    self._begin(start)

        return bool(self.names) and len(self.waiting) >= HEAD_ROWS

    def _begin(self, start: TableStart) -> None:
        """Take the names of a table that was found; what stands above it goes."""
        self.names = start.names
        self.units = start.units
        self._delimiter = start.delimiter
        self._has_header = bool(start.header_line)
        self._header_warnings = start.warnings
        self.waiting = self.waiting[start.first_row :]
        self._commas = meaning_of_commas(
            cell
            for row in self.waiting[:HEAD_ROWS]
            for cell in split_line(row.text, self._delimiter)
        )

    def end(self, tail: str, *, is_growing: bool) -> None:
        """Add what stands behind the last line end.

        It is a row if it has the header's cells: whether its last number is cut cannot
        be known, unless the file was still being written.

        Raises:
            FormatError: There is no table.
        """
        if not self.names:
            with suppress(FormatError):
                self._begin(find_table(self.waiting, self._comments))

        if self.names and _is_row(tail):
            cell_count = len(split_line(tail, self._delimiter))
            if cell_count < len(self.names) or is_growing:
                self.faults.note(
                    f"line {self._line_count + 1}, the last, is cut short "
                    f"({cell_count} of {len(self.names)} cells) and was left out",
                    "",
                )
                tail = ""

        self.add([tail])
        if not self.names:
            self._begin(find_table(self.waiting, self._comments))

    def _split_row(self, line: str) -> list[str]:
        """Split a row into cells, without empty ones behind the header's."""
        cells = split_line(line, self._delimiter)
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
        if not self._is_chosen:
            self._group_joints(rows)

        warnings: tuple[str, ...] = ()
        if not self._is_chosen:
            used = {name for group in self.joint_groups for name in group.sources}
            left_out = (
                reason
                for i, reason in self.omitted.items()
                if self.names[i] not in used
            )
            warnings = (*self._header_warnings, *left_out)

        self._is_chosen = True

        columns: dict[str, np.ndarray] = {
            name: values[:, i]
            for i, name in enumerate(self.names)
            if i not in self.omitted
        }
        self._restore_large_integers(columns, rows)
        self.waiting = self.waiting[len(rows) :]
        if self.joint_groups:
            columns = group_columns(columns, self.joint_groups)

        return Table(
            columns=columns,
            joint_names={group.column: group.joints for group in self.joint_groups},
            start_ns=self._start_ns,
            warnings=warnings,
            units=self.units,
            has_header=self._has_header,
        )

    def _read_fast(self, rows: list[NumberedRow]) -> np.ndarray | None:
        """Return the numbers in rows, shape (n, k), if all cells hold numbers."""
        lines = [row.text for row in rows]
        comma_count = 0
        if self._delimiter != "," and self._commas is Commas.DECIMAL:
            comma_count = sum(line.count(",") for line in lines)
            lines = [line.replace(",", ".") for line in lines]

        delimiter = None if self._delimiter == WHITE_SPACE else self._delimiter
        quote = '"' if lines and '"' in lines[0] else None
        try:
            values = np.loadtxt(
                lines, delimiter=delimiter, comments=None, ndmin=2, quotechar=quote
            )
        except ValueError:
            return None

        if values.shape[1] != len(self.names):
            return None

        if comma_count:
            first = next(row.line_number for row in rows if "," in row.text)
            self.faults.note(self._commas.value, f"line {first}", comma_count)

        return values

    def _read_by_cell(self, rows: list[NumberedRow]) -> np.ndarray:
        """Return the numbers in rows, shape (n, k), and note what is wrong."""
        width = len(self.names)
        numbers = []
        for line_number, line in rows:
            if _NUL in line:
                place = f"line {line_number}"
                self.faults.note("rows with NUL bytes, left out", place)
                continue

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
                cells[place]
                for row, cells in zip(rows, all_cells, strict=True)
                if len(cells) == len(self.names) and _NUL not in row.text
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
            value = read_number(cell)
            if value is None and "," in cell:
                value = read_with_commas(cell, self._commas)
                if value is not None:
                    self.faults.note(self._commas.value, f"line {line_number}")

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

    def _group_joints(self, rows: list[NumberedRow]) -> None:
        """Find the columns that hold joints by name, from the first rows."""
        all_cells = [self._split_row(row.text) for row in rows[:1]]
        texts = {
            self.names[i]: cells[i].strip()
            for cells in all_cells
            for i in self.omitted
            if i < len(cells)
        }
        kept = [name for i, name in enumerate(self.names) if i not in self.omitted]
        self.joint_groups = find_joint_groups(kept, texts)

    def _choose_columns(self, row_count: int) -> None:
        """Decide from the first rows which columns are left out."""
        width = len(self.names)
        if not row_count:
            fault, (_, first) = next(iter(self.faults.items()))
            raise FormatError(f"no row can be read: {fault} (first: {first})")

        for i in sorted(set(range(width)) - self._has_number):
            text = self.faults.pop(self._not_numbers(i), FaultCount(0, "")).first
            reason = f"holds text ({text})" if text else "is empty"
            self.omitted[i] = f"column {self.names[i]!r} {reason} and was left out"

        if len(self.omitted) == width:
            reasons = "; ".join(self.omitted.values())
            raise FormatError(f"no column holds a number: {reasons[:500]}")


def _is_row(line: str) -> bool:
    """Return whether a line is neither blank nor a comment."""
    return line[:1] not in ("", COMMENT) and not line.isspace()


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
            while rows.find_head() if is_first else rows.waiting:
                yield rows.read_waiting()
                is_first = False
                read_bytes = lines.size

            waiting_bytes = lines.size - read_bytes + ROW_BYTES * len(rows.waiting)
            require_size(waiting_bytes, max_bytes, "its text")

        if options.should_stop():
            lines.forgive_end()

        rows.end(lines.tail, is_growing=options.follow)
        if rows.waiting or is_first:
            yield rows.read_waiting()
    except FormatError as error:
        losses = "".join(f" ({warning})" for warning in lines.warnings)
        raise error.reworded(f"{name}: {error}{losses}") from error

    names = [name for i, name in enumerate(rows.names) if i not in rows.omitted]
    no_rows = group_columns(dict.fromkeys(names, np.empty(0)), rows.joint_groups)
    warnings = (*lines.warnings, *rows.faults.lines())
    joint_names = {group.column: group.joints for group in rows.joint_groups}
    yield Table(columns=no_rows, warnings=warnings, joint_names=joint_names)
