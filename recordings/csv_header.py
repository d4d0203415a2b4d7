"""Where a CSV file's header is, and what it says."""

from dataclasses import dataclass

from recordings.csv_line import split_line, to_number
from recordings.errors import FormatError

DELIMITERS = (",", ";", "\t")
_COMMENT = "#"


@dataclass(frozen=True, slots=True, kw_only=True)
class CsvLayout:
    """A CSV file split into its header and its rows.

    Attributes:
        names: column names, unique; a column without one is called `column_N`.
        delimiter: what separates the cells.
        rows: the lines that hold data; neither blank nor comments.
        line_numbers: where each stands in the file, counted from 1.
    """

    names: tuple[str, ...]
    delimiter: str
    rows: tuple[str, ...]
    line_numbers: tuple[int, ...]


def find_layout(text: str) -> CsvLayout:
    """Find the header and the rows.

    Lines starting with `#` are comments. A comment just before the first row counts as the
    header if it has as many cells (`numpy.savetxt` writes its header so).

    Args:
        text: the file's text.

    Returns:
        The layout.

    Raises:
        FormatError: there is no header row, no row after it, or a name stands twice.
    """
    lines = text.split("\n")
    filled = [i for i, line in enumerate(lines) if line.strip()]
    data = [i for i in filled if not lines[i].startswith(_COMMENT)]
    if not data:
        raise FormatError("only comments; expected a header row and rows of numbers")
    header = lines[data[0]]
    delimiter = max(DELIMITERS, key=header.count)
    names = _split(header, delimiter)
    if _any_number(names):
        names = _commented_header(lines, filled, data[0], len(names), delimiter)
    else:
        data = data[1:]
    if not data:
        raise FormatError(f"a header but no rows; the header is: {header.strip()[:200]}")
    return CsvLayout(
        names=_unique(names),
        delimiter=delimiter,
        rows=tuple([lines[i] for i in data]),
        line_numbers=tuple([i + 1 for i in data]),
    )


def _commented_header(
    lines: list[str], filled: list[int], first: int, width: int, delimiter: str
) -> list[str]:
    before = filled.index(first) - 1
    if before >= 0:
        names = _split(lines[filled[before]].lstrip(_COMMENT), delimiter)
        if len(names) == width and not _any_number(names):
            return names
    raise FormatError(
        f"no header row: line {first + 1} already holds numbers ({lines[first][:60]!r}). "
        "Add a line with the column names above it"
    )


def _split(line: str, delimiter: str) -> list[str]:
    return [cell.strip() for cell in split_line(line, delimiter)]


def _unique(names: list[str]) -> tuple[str, ...]:
    unique = tuple(name or f"column_{i + 1}" for i, name in enumerate(names))
    for i, name in enumerate(unique):
        if name in unique[:i]:
            raise FormatError(
                f"the header names {name!r} twice, in columns {unique.index(name) + 1} and {i + 1}"
            )
    return unique


def _any_number(cells: list[str]) -> bool:
    return any(to_number(cell) is not None for cell in cells)
