"""Reading CSV rows cell by cell: slower than numpy's reader, but it can say what is wrong."""

from dataclasses import dataclass, field
from math import nan

import numpy as np

from recordings.tables.table import FloatArray
from recordings.text.line import split_line, to_number
from recordings.text.rows import CsvLayout


@dataclass(slots=True)
class Faults:
    """Faults of one kind: how many, and the first in words."""

    count: int = 0
    first: str = ""

    def add(self, text: str) -> None:
        """Count one more."""
        self.count += 1
        self.first = self.first or text


@dataclass(slots=True)
class CellReader:
    """Reads rows and remembers their faults.

    Attributes:
        ragged: rows with another number of cells than the header.
        commas: rows with decimal commas.
        words: cells that are not numbers, by column.
        has_number: columns in which a number was met.
    """

    ragged: Faults = field(default_factory=Faults)
    commas: Faults = field(default_factory=Faults)
    words: dict[int, Faults] = field(default_factory=dict)
    has_number: set[int] = field(default_factory=set)

    def read(self, layout: CsvLayout) -> FloatArray:
        """Return the rows that have as many cells as the header, shape (n, columns).

        Empty and non-numeric cells become NaN. Decimal commas are understood unless the comma
        separates cells.
        """
        width, delimiter = len(layout.header.names), layout.header.delimiter
        rows: list[list[float]] = []
        for line_number, row in zip(layout.line_numbers, layout.rows, strict=True):
            cells = split_line(row, delimiter)
            while len(cells) > width and not cells[-1].strip():
                cells.pop()
            if len(cells) == width:
                rows.append(self._numbers(line_number, cells, delimiter))
            else:
                self.ragged.add(f"line {line_number} with {len(cells)}")
        return np.array(rows, dtype=np.float64).reshape(-1, width)

    def _numbers(self, line: int, cells: list[str], delimiter: str) -> list[float]:
        try:
            numbers = [float(cell) for cell in cells]
        except ValueError:
            return [self._number(line, i, cell, delimiter) for i, cell in enumerate(cells)]
        self.has_number.update(range(len(cells)))
        return numbers

    def _number(self, line: int, column: int, cell: str, delimiter: str) -> float:
        if not cell.strip():
            return nan
        value = to_number(cell)
        if value is None and delimiter != ",":
            value = to_number(cell.replace(",", "."))
            if value is not None:
                self.commas.add(f"line {line}")
        if value is None:
            self.words.setdefault(column, Faults()).add(f"line {line}, {cell.strip()[:40]!r}")
            return nan
        self.has_number.add(column)
        return value
