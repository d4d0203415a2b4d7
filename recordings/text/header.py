"""Where a CSV file's header is, and what it says."""

from dataclasses import dataclass

from recordings.errors import FormatError
from recordings.text.line import split_line, to_number

DELIMITERS = (",", ";", "\t")
COMMENT = "#"


@dataclass(frozen=True, slots=True, kw_only=True)
class CsvHeader:
    """What the header says.

    Attributes:
        names: column names, unique; a column without one is called `column_N`.
        delimiter: what separates the cells.
        is_comment: whether it stands in a comment, so that the line after it holds data.
    """

    names: tuple[str, ...]
    delimiter: str
    is_comment: bool = False


def read_header(line: str, line_number: int, comment: str) -> CsvHeader:
    """Read the header from the first line that is neither blank nor a comment.

    A comment just before it counts as the header if that line holds numbers and the comment has
    as many cells (`numpy.savetxt` writes its header so).

    Args:
        line: that line.
        line_number: where it stands, counted from 1.
        comment: the comment before it, or empty.

    Returns:
        The header.

    Raises:
        FormatError: there is no header row, or a name stands twice.
    """
    delimiter = max(DELIMITERS, key=line.count)
    cells = _split(line, delimiter)
    if not _any_number(cells):
        return CsvHeader(names=_unique(cells), delimiter=delimiter)
    names = _split(comment.lstrip(COMMENT), delimiter)
    if not comment or len(names) != len(cells) or _any_number(names):
        raise FormatError(
            f"no header row: line {line_number} already holds numbers ({line[:60]!r}). "
            "Add a line with the column names above it"
        )
    return CsvHeader(names=_unique(names), delimiter=delimiter, is_comment=True)


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
