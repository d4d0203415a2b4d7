"""Columns of whole numbers too large for float64, read from the text of their cells."""

from collections.abc import Mapping

import numpy as np

from recordings.clock.whole_stamps import Stamps, exceed_float64
from recordings.tables.table import FloatArray
from recordings.text.line import split_line
from recordings.text.rows import CsvLayout


def whole_stamps_of_text(layout: CsvLayout, columns: Mapping[str, FloatArray]) -> Stamps:
    """Return the columns of whole numbers that float64 would round, read once more, without loss.

    Args:
        layout: the rows.
        columns: those that were read of them, NaN where a cell is no number.
    """
    found: Stamps = {}
    for name, values in columns.items():
        if not exceed_float64(values):
            continue
        try:
            texts = _cells(layout, layout.header.names.index(name))
            stamps = np.array([int(text) for text in texts], dtype=np.int64)
        except (ValueError, OverflowError):
            continue
        if len(stamps) == len(values):
            found[name] = stamps
    return found


def _cells(layout: CsvLayout, column: int) -> list[str]:
    """The cells of a column, of the rows that have as many cells as the header."""
    width, delimiter = len(layout.header.names), layout.header.delimiter
    cells = []
    for line in layout.rows:
        row = split_line(line, delimiter)
        if len(row) == width or (len(row) > width and not "".join(row[width:]).strip()):
            cells.append(row[column])
    return cells
