"""From CSV rows to columns of numbers, the same columns whenever more rows come."""

import numpy as np

from recordings.clock.whole_stamps import Stamps
from recordings.errors import FormatError
from recordings.tables.table import FloatArray
from recordings.text.cells import CellReader, Faults
from recordings.text.exact_stamps import whole_stamps_of_text
from recordings.text.rows import CsvLayout

_EXPECTED = (
    "cells are separated by commas, semicolons or tabs, and what stands above the header begins "
    "with #"
)


class CsvColumns:
    """Reads the rows of one file.

    Rows with another number of cells than the header are left out, and so are columns without any
    number in the first rows read.
    """

    def __init__(self) -> None:
        self._cells = CellReader()
        self._names: tuple[str, ...] = ()
        self._left_out: dict[int, str] = {}
        self.stamps: Stamps = {}
        """Whole numbers too large for float64 of the rows that were read last."""

    def read(self, layout: CsvLayout) -> dict[str, FloatArray]:
        """Return the columns of some rows.

        Raises:
            FormatError: of the first rows, none fits the header, or no column holds a number.
        """
        values = read_fast(layout)
        if not self._names:
            values = self._choose(layout, values)
        elif values is None:
            values = self._cells.read(layout)
        columns = {
            name: values[:, i] for i, name in enumerate(self._names) if i not in self._left_out
        }
        self.stamps = whole_stamps_of_text(layout, columns)
        return columns

    @property
    def omitted(self) -> tuple[str, ...]:
        """Which columns were left out, and why."""
        return tuple(self._left_out.values())

    def notes(self) -> tuple[str, ...]:
        """What was left out or could not be read so far, in words."""
        cells, notes = self._cells, []
        line, columns = self._line_of_words()
        if columns:
            notes.append(
                f"{line} holds words in {len(columns)} columns (first: "
                f"{self._names[columns[0]]!r}), read as NaN; units belong into the header: "
                "'q1 [deg]'"
            )
        for i, name in enumerate(self._names):
            if i in self._left_out:
                notes.append(self._left_out[i])
            elif i in cells.words and i not in columns:
                notes.append(
                    f"column {name!r}: cells that are not numbers, read as NaN: "
                    f"{cells.words[i].count} (first: {cells.words[i].first})"
                )
        if cells.ragged.count:
            notes.append(
                f"rows without the header's {len(self._names)} cells, left out: "
                f"{cells.ragged.count} (first: {cells.ragged.first})"
            )
        if cells.commas.count:
            notes.append(f"decimal commas read as points (first: {cells.commas.first})")
        return tuple(notes)

    def _line_of_words(self) -> tuple[str, list[int]]:
        """Return a line that holds the only word of several columns, as one of units does."""
        lines: dict[str, list[int]] = {}
        for i, words in sorted(self._cells.words.items()):
            if words.count == 1 and i not in self._left_out:
                lines.setdefault(words.first.partition(",")[0], []).append(i)
        line, columns = max(lines.items(), key=lambda item: len(item[1]), default=("", []))
        return (line, columns) if len(columns) > 2 else ("", [])

    def _choose(self, layout: CsvLayout, values: FloatArray | None) -> FloatArray:
        """Decide from the first rows which columns there are."""
        cells, self._names = self._cells, layout.header.names
        if values is not None:
            return values
        values = cells.read(layout)
        width = len(self._names)
        if not len(values):
            raise FormatError(
                f"no row has the header's {width} cells (first: {cells.ragged.first}); "
                f"check the delimiter and the header: {_EXPECTED}"
            )
        for i in set(range(width)) - cells.has_number:
            words = cells.words.get(i, Faults())
            why = f"holds text ({words.first})" if words.count else "is empty"
            self._left_out[i] = f"column {self._names[i]!r} {why} and was left out"
        if len(self._left_out) == width:
            told = "; ".join(self._left_out.values())
            raise FormatError(f"no column holds a number: {told[:500]}; {_EXPECTED}")
        return values


def read_fast(layout: CsvLayout) -> FloatArray | None:
    """Return the rows if they are all numbers, as many as the header has names."""
    header = layout.header
    try:
        values = np.loadtxt(layout.rows, delimiter=header.delimiter, comments=None, ndmin=2)
    except ValueError:
        return None
    return values if values.shape[1] == len(header.names) else None
