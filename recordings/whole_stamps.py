"""Whole numbers too large for float64, as stamps in nanoseconds since 1970 are."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from recordings.csv_line import split_line
from recordings.csv_rows import CsvLayout
from recordings.table import FloatArray

_EXACT = 1 << 53
"""Up to here float64 holds every whole number."""

Stamps = dict[str, NDArray[np.int64]]


def whole_stamps(columns: Mapping[str, np.ndarray]) -> Stamps:
    """Return the columns of whole numbers that float64 would round.

    Args:
        columns: as the file has them, in its own types.
    """
    return {
        name: values.astype(np.int64)
        for name, values in columns.items()
        if values.dtype.kind in "iu" and values.ndim == 1 and _is_large(values)
    }


def whole_stamps_of_text(layout: CsvLayout, columns: Mapping[str, FloatArray]) -> Stamps:
    """Return the same for columns of a CSV file, read from its text once more.

    Args:
        layout: the rows.
        columns: those that were read of them, NaN where a cell is no number.
    """
    found: Stamps = {}
    for name, values in columns.items():
        if not _is_large(values):
            continue
        try:
            texts = _cells(layout, layout.header.names.index(name))
            stamps = np.array([int(text) for text in texts], dtype=np.int64)
        except (ValueError, OverflowError):
            continue
        if len(stamps) == len(values):
            found[name] = stamps
    return found


def _is_large(values: np.ndarray) -> bool:
    # Not abs, which overflows for the least integer; a NaN is not larger than anything.
    return bool(len(values)) and bool(((values > _EXACT) & (values < 1 << 63)).all())


def _cells(layout: CsvLayout, column: int) -> list[str]:
    """The cells of a column, of the rows that have as many cells as the header."""
    width, delimiter = len(layout.header.names), layout.header.delimiter
    cells = []
    for line in layout.rows:
        row = split_line(line, delimiter)
        if len(row) == width or (len(row) > width and not "".join(row[width:]).strip()):
            cells.append(row[column])
    return cells
