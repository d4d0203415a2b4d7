"""The header and the rows of a CSV text, from lines as they come."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

from recordings.errors import FormatError
from recordings.tables.labels import START_KEY
from recordings.text.header import COMMENT, CsvHeader, read_header

_START = re.compile(rf"{COMMENT}\s*{START_KEY}\s*=\s*(-?\d{{1,19}})\s*$")


@dataclass(frozen=True, slots=True, kw_only=True)
class CsvLayout:
    """Rows with what is known about them.

    Attributes:
        header: of the file.
        rows: lines that hold data; neither blank nor comments.
        line_numbers: where each stands in the file, counted from 1.
    """

    header: CsvHeader
    rows: Sequence[str]
    line_numbers: Sequence[int]


class CsvRows:
    """Sorts lines into header, comments and rows; lines starting with `#` are comments."""

    def __init__(self) -> None:
        self._header: CsvHeader | None = None
        self._header_line = self._comment = ""
        self._lines = self._total = 0
        self._rows: list[str] = []
        self._numbers: list[int] = []
        self.start_ns = 0
        """The start of the clock, if a comment before the header says it."""
        self.notes: list[str] = []
        """What was left out."""

    def __len__(self) -> int:
        """Return how many rows wait to be taken."""
        return len(self._rows)

    def add(self, lines: list[str]) -> None:
        """Take whole lines.

        Raises:
            FormatError: there is no header row, or a name stands twice in it.
        """
        if self._header is None:
            lines = self._find_header(lines)
        first = self._lines + 1
        self._lines += len(lines)
        rows = [line for line in lines if _is_row(line)]
        if len(rows) == len(lines):
            self._numbers += range(first, first + len(lines))
        else:
            self._numbers += [n for n, line in enumerate(lines, first) if _is_row(line)]
        self._rows += rows
        self._total += len(rows)

    def end(self, tail: str, *, is_growing: bool) -> None:
        """Take what stands behind the last line end.

        It is a row if it has the header's cells: whether its last number is cut cannot be known,
        unless the file was still being written.

        Args:
            tail: without a line end; may be empty.
            is_growing: whether it was.

        Raises:
            FormatError: there was no header, or no row after it.
        """
        if self._header is not None and self._total and _is_row(tail):
            cells = tail.count(self._header.delimiter) + 1
            names = len(self._header.names)
            if cells < names or is_growing:
                self.notes.append(
                    f"line {self._lines + 1}, the last, is cut short "
                    f"({cells} of {names} cells) and was left out"
                )
                tail = ""
        self.add([tail])
        if self._header is None:
            raise FormatError("only comments; expected a header row and rows of numbers")
        if not self._total:
            header = self._header_line.strip()[:200]
            raise FormatError(f"a header but no rows; the header is: {header}")

    def take(self) -> CsvLayout:
        """Return the rows that wait, of which there must have been one at least."""
        assert self._header is not None
        layout = CsvLayout(header=self._header, rows=self._rows, line_numbers=self._numbers)
        self._rows, self._numbers = [], []
        return layout

    def _find_header(self, lines: list[str]) -> list[str]:
        """Return the lines after the header, or none if it was not among them."""
        for i, line in enumerate(lines):
            if _is_row(line):
                header = read_header(line, self._lines + i + 1, self._comment)
                self._header, self._header_line = header, line
                past = i if header.is_comment else i + 1
                self._lines += past
                return lines[past:]
            if line.strip():
                self._comment = line
            if match := _START.match(line):
                self.start_ns = int(match[1])
        self._lines += len(lines)
        return []


def _is_row(line: str) -> bool:
    return bool(line) and line[0] != COMMENT and not line.isspace()
