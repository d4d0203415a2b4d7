"""Reading CSV files, plain or compressed with gzip."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from recordings.csv_cells import read_cells
from recordings.csv_header import CsvLayout, find_layout
from recordings.csv_text import read_text
from recordings.errors import FormatError
from recordings.table import FloatArray, Table


def read_csv(path: Path) -> Table:
    """Read a CSV file: a header row, then rows of numbers.

    Cells are separated by commas, semicolons or tabs. What cannot be read is left out and told
    in the table's warnings, with line numbers.

    Args:
        path: the file.

    Returns:
        Its columns.

    Raises:
        FileAccessError: the file cannot be read.
        FormatError: it is empty, has no header or no rows, or holds no numbers.
    """
    text, warnings = read_text(path)
    try:
        layout, lost = _without_cut_line(find_layout(text), ends_clean=text.endswith("\n"))
        columns, notes = _read_columns(layout)
    except FormatError as error:
        told = "".join(f" ({warning})" for warning in warnings)
        raise FormatError(f"{path}: {error}{told}") from error
    return Table(columns=columns, warnings=warnings + lost + notes)


def _without_cut_line(layout: CsvLayout, ends_clean: bool) -> tuple[CsvLayout, tuple[str, ...]]:
    """Leave out a last line that has too few cells because writing was interrupted."""
    cells = layout.rows[-1].count(layout.delimiter) + 1
    if ends_clean or len(layout.rows) == 1 or cells >= len(layout.names):
        return layout, ()
    note = (
        f"line {layout.line_numbers[-1]}, the last, is cut short "
        f"({cells} of {len(layout.names)} cells) and was left out"
    )
    whole = replace(layout, rows=layout.rows[:-1], line_numbers=layout.line_numbers[:-1])
    return whole, (note,)


def _read_columns(layout: CsvLayout) -> tuple[dict[str, FloatArray], tuple[str, ...]]:
    try:
        values = np.loadtxt(layout.rows, delimiter=layout.delimiter, comments=None, ndmin=2)
    except ValueError:
        return read_cells(layout)
    if values.shape[1] != len(layout.names):
        return read_cells(layout)
    return dict(zip(layout.names, values.T, strict=True)), ()
