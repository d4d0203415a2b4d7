"""Reading CSV rows cell by cell: slower than numpy's reader, but it can say what is wrong."""

from dataclasses import dataclass, field
from math import nan

import numpy as np

from recordings.csv_header import CsvLayout
from recordings.csv_line import split_line, to_number
from recordings.errors import FormatError
from recordings.table import FloatArray


@dataclass(slots=True)
class _Faults:
    """Faults of one kind: how many, and the first in words."""

    count: int = 0
    first: str = ""

    def add(self, text: str) -> None:
        self.count += 1
        self.first = self.first or text


@dataclass(slots=True)
class _Reader:
    """What accumulates while rows are read."""

    layout: CsvLayout
    rows: list[list[float]] = field(default_factory=list)
    ragged: _Faults = field(default_factory=_Faults)
    commas: _Faults = field(default_factory=_Faults)
    words: dict[int, _Faults] = field(default_factory=dict)
    has_number: set[int] = field(default_factory=set)

    def add(self, line: int, cells: list[str]) -> None:
        width = len(self.layout.names)
        while len(cells) > width and not cells[-1].strip():
            cells.pop()
        if len(cells) != width:
            self.ragged.add(f"line {line} with {len(cells)}")
            return
        try:
            self.rows.append([float(cell) for cell in cells])
            self.has_number.update(range(width))
        except ValueError:
            self.rows.append([self.number(line, i, cell) for i, cell in enumerate(cells)])

    def number(self, line: int, column: int, cell: str) -> float:
        if not cell.strip():
            return nan
        value = to_number(cell)
        if value is None and self.layout.delimiter != ",":
            value = to_number(cell.replace(",", "."))
            if value is not None:
                self.commas.add(f"line {line}")
        if value is None:
            self.words.setdefault(column, _Faults()).add(f"line {line}, {cell.strip()[:40]!r}")
            return nan
        self.has_number.add(column)
        return value


def read_cells(layout: CsvLayout) -> tuple[dict[str, FloatArray], tuple[str, ...]]:
    """Read the rows of a CSV file that is not all numbers.

    Empty and non-numeric cells become NaN, rows with another number of cells than the header are
    left out, and so are columns without any number. Decimal commas are understood unless the
    comma separates cells.

    Args:
        layout: the file's header and rows.

    Returns:
        The columns, and what was left out or could not be read.

    Raises:
        FormatError: no row fits the header, or no column holds a number.
    """
    reader = _Reader(layout=layout)
    for line_number, row in zip(layout.line_numbers, layout.rows, strict=True):
        reader.add(line_number, split_line(row, layout.delimiter))
    width = len(layout.names)
    if not reader.rows:
        raise FormatError(
            f"no row has the header's {width} cells (first: {reader.ragged.first}); "
            "check the delimiter and the header"
        )
    columns, warnings = _columns(reader)
    if reader.ragged.count:
        warnings.append(
            f"rows without the header's {width} cells, left out: {reader.ragged.count} "
            f"(first: {reader.ragged.first})"
        )
    if reader.commas.count:
        warnings.append(f"decimal commas read as points (first: {reader.commas.first})")
    return columns, tuple(warnings)


def _columns(reader: _Reader) -> tuple[dict[str, FloatArray], list[str]]:
    values = np.array(reader.rows)
    columns, warnings = {}, []
    for i, name in enumerate(reader.layout.names):
        words = reader.words.get(i, _Faults())
        if i not in reader.has_number:
            why = f"holds text ({words.first})" if words.count else "is empty"
            warnings.append(f"column {name!r} {why} and was left out")
            continue
        columns[name] = values[:, i]
        if words.count:
            warnings.append(
                f"column {name!r}: cells that are not numbers, read as NaN: {words.count} "
                f"(first: {words.first})"
            )
    if not columns:
        raise FormatError(f"no column holds a number: {'; '.join(warnings)[:500]}")
    return columns, warnings
