"""Finding the columns that a mapping names."""

import re
from dataclasses import dataclass
from difflib import get_close_matches

from recordings.errors import ColumnError
from recordings.tables.table import FloatArray, Table

_RANGE = re.compile(r"\{(?P<first>\d+)\.\.(?P<last>\d+)\}")
_ELEMENT = re.compile(r"^(?P<name>.+)\[(?P<index>\d+)\]$")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FoundColumn:
    """One column of a table, or one of a table's two-dimensional columns.

    Attributes:
        name: its name in the file.
        values: shape (n,) or (n, k), in the file's unit.
    """

    name: str
    values: FloatArray

    @property
    def width(self) -> int:
        """How many values it has per row."""
        return 1 if self.values.ndim == 1 else self.values.shape[1]


def find_columns(table: Table, pattern: str) -> tuple[FoundColumn, ...]:
    """Return the columns that a name or pattern stands for.

    In this order: a column of exactly that name; `q{1..7}`, the numbers from 1 to 7; `q_*`, all
    columns with a number in that place; `wrench[2]`, one column (from 0) of a two-dimensional
    one; and `q_rad` for a family `q_rad_1`, `q_rad_2`, ... as this package writes it to CSV.

    Args:
        table: where to look.
        pattern: the name or pattern.

    Returns:
        At least one column; numbered ones in the order of their numbers.

    Raises:
        ColumnError: no such column, or a number is missing in a family.
    """
    if pattern in table.columns:
        return (FoundColumn(name=pattern, values=table.columns[pattern]),)
    if match := _RANGE.search(pattern):
        names = _expand_range(pattern, match)
        return tuple(column for name in names for column in find_columns(table, name))
    if "*" in pattern:
        return _find_numbered(table, pattern, f"{re.escape(pattern)}".replace(r"\*", r"(\d+)", 1))
    if match := _ELEMENT.match(pattern):
        return (_find_element(table, pattern, match["name"], int(match["index"])),)
    return _find_numbered(table, pattern, rf"{re.escape(pattern)}[_. ]?\[?(\d+)\]?")


def _expand_range(pattern: str, match: re.Match[str]) -> list[str]:
    first, last = match["first"], match["last"]
    step = 1 if int(first) <= int(last) else -1
    numbers = range(int(first), int(last) + step, step)
    width = len(first) if first.startswith("0") else 1
    head, tail = pattern[: match.start()], pattern[match.end() :]
    return [f"{head}{number:0{width}d}{tail}" for number in numbers]


def _find_element(table: Table, pattern: str, name: str, index: int) -> FoundColumn:
    values = table.columns.get(name)
    if values is None or values.ndim != 2:
        raise _not_found(table, pattern)
    if index >= values.shape[1]:
        raise ColumnError(
            f"{pattern!r}: column {name!r} has the elements [0] to [{values.shape[1] - 1}]"
        )
    return FoundColumn(name=pattern, values=values[:, index])


def _find_numbered(table: Table, pattern: str, expression: str) -> tuple[FoundColumn, ...]:
    numbered: dict[int, str] = {}
    for name in table.columns:
        if not (match := re.fullmatch(expression, name)):
            continue
        number = int(match[1])
        if number in numbered:
            raise ColumnError(f"{pattern!r} fits both {numbered[number]!r} and {name!r}; name one")
        numbered[number] = name
    if not numbered:
        raise _not_found(table, pattern)
    require_no_gap(sorted(numbered), pattern)
    return tuple(
        FoundColumn(name=numbered[number], values=table.columns[numbered[number]])
        for number in sorted(numbered)
    )


def require_no_gap(numbers: list[int], pattern: str) -> None:
    """Check that the numbers of a family of columns follow each other.

    Args:
        numbers: the numbers found, ascending.
        pattern: the family, for the error.

    Raises:
        ColumnError: a number between the first and the last is missing.
    """
    missing = sorted(set(range(numbers[0], numbers[-1] + 1)) - set(numbers))
    if missing:
        listed = ", ".join(map(str, missing[:5]))
        raise ColumnError(
            f"{pattern!r}: found the numbers {numbers[0]} to {numbers[-1]}, but not {listed}; "
            "list the columns to use"
        )


def _not_found(table: Table, pattern: str) -> ColumnError:
    notes = dict.fromkeys((*table.omitted, *table.warnings))
    told = "".join(f" ({note})" for note in notes if repr(pattern) in note)
    hint = _hint(list(table.columns), pattern)
    return ColumnError(f"no column {pattern!r}{told}.{hint} Columns are: {table.describe()}")


def _hint(names: list[str], pattern: str) -> str:
    """Say what may have been meant."""
    if "*" in pattern:
        return " The * stands for one number; all the rest of the name must be written out."
    head, colon, unit = pattern.rpartition(":")
    if colon and any(name.startswith(head) for name in names):
        return f" The unit {unit!r} is none of this channel's; --help lists them."
    with_unit = [name for name in names if re.match(rf"{re.escape(pattern)}\s*[\[(]\D", name)]
    close = with_unit or get_close_matches(pattern, names, n=1)
    return f" Did you mean {close[0]!r}?" if close else ""
