"""One line of a CSV file: split into cells, and a cell read as a number."""

import csv


def split_line(line: str, delimiter: str) -> list[str]:
    """Split a line into cells, with quotes removed.

    A quoted cell ends with its line: a stray quote must not swallow the lines after it.

    Args:
        line: the line, without its end.
        delimiter: what separates cells.

    Returns:
        The cells; at least one.
    """
    if '"' not in line:
        return line.split(delimiter)
    try:
        return next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))
    except csv.Error:
        return line.split(delimiter)


def to_number(cell: str) -> float | None:
    """Return the number in a cell, which may be NaN; None if it holds something else."""
    try:
        return float(cell)
    except ValueError:
        return None
