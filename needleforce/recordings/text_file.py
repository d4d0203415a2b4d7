"""CSV and its kin, plain or compressed with gzip: a header and rows of numbers."""

import gzip
import io
import re
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import product
from typing import NamedTuple

import numpy as np
import pandas as pd

from needleforce.recordings.channels import (
    JointRules,
    Knowledge,
    Layout,
    unit_in_brackets,
)
from needleforce.recordings.column_names import known_names
from needleforce.recordings.errors import FormatError, require_size
from needleforce.recordings.table import START_KEY, StatedUnit, Table
from needleforce.recordings.time_stamps import (
    NS_PER_S,
    first_valid_stamp,
    start_of_clock,
    to_seconds,
)

CSV_SUFFIXES = (
    ".csv",
    ".csv.gz",
    ".tsv",
    ".tsv.gz",
    ".txt",
    ".txt.gz",
    ".dat",
    ".asc",
    ".lvm",
)

COMMENT = "#"
WHITE_SPACE = r"\s+"

_NUMBER = re.compile(
    r"\s*[+-]?(\d+[.,]?\d*|[.,]\d+)(e[+-]?\d+)?\s*|nan|[+-]?inf", re.IGNORECASE
)


class _Start(NamedTuple):
    """Where the table of a text begins.

    Attributes:
        delimiter: Between cells.
        header: Place of the line with the names; -1 without one.
        first_row: Place of the first row.
        width: Cells of a row.
    """

    delimiter: str
    header: int
    first_row: int
    width: int


def read_text(data: bytes, name: str, knowledge: Knowledge, max_bytes: int) -> Table:
    """Read a text: perhaps lines above, a header, perhaps units, rows of numbers.

    Args:
        data: The file, plain or compressed with gzip.
        name: Of the file, for messages.
        knowledge: Names, units and layouts that are known.
        max_bytes: The most memory that the text may take.

    Raises:
        FormatError: There is no table in it.
    """
    text = _decode(data, name, max_bytes)
    start = re.search(rf"^{COMMENT}\s*{START_KEY}\s*=\s*(-?\d+)\s*$", text, re.M)
    numbered = _lines_of_table(text.splitlines())
    lines = [line for _, line in numbered]
    if not lines:
        raise FormatError(f"{name}: it is empty; expected a header and rows of numbers")

    layouts = (each for each in knowledge.layouts if each.first_line)
    layout = next(
        (each for each in layouts if re.search(each.first_line, lines[0])),
        Layout(name="", first_line="^"),
    )
    table = _find_table(lines, layout, knowledge)
    if table is None:
        raise FormatError(
            f"{name}: no table; expected a line of names and below it rows of numbers "
            f"with as many cells; it begins with {lines[0][:60]!r}"
        )

    names, units, notes = _names_and_units(numbered, table, layout, knowledge)
    rows = [line for line in lines[table.first_row :] if _fits(line, table)]
    is_decimal = table.delimiter != "," and re.search(r"\d,\d", "".join(rows[:50]))
    with warnings.catch_warnings(), _parser_errors(name):
        warnings.simplefilter("ignore", pd.errors.ParserWarning)
        frame = pd.read_csv(
            io.StringIO("\n".join(rows)),
            sep=table.delimiter,
            header=None,
            names=list(names),
            index_col=False,
            comment=COMMENT,
            decimal="," if is_decimal else ".",
            skipinitialspace=True,
            on_bad_lines="skip",
            low_memory=False,
        )
    if missing := len(lines) - table.first_row - len(frame):
        notes.append(
            f"rows without the header's {table.width} cells, left out: {missing}"
        )
    if is_decimal:
        notes.append("decimal commas read as points")

    columns, seconds, start_ns, texts, faults = _read_columns(frame)
    notes += faults
    groups, sources = find_joint_groups(columns, texts, knowledge.joints)
    notes += [
        f"column {each!r} holds text ({cell[:40]!r}) and was left out"
        for each, cell in texts.items()
        if each not in sources
    ]
    if not columns:
        raise FormatError(f"{name}: no column holds a number: {'; '.join(notes)[:500]}")

    for group, members in groups.items():
        values = np.stack([columns.pop(each) for each in members.values()], axis=1)
        columns[group] = values

    return Table(
        columns=columns,
        joint_names={group: tuple(members) for group, members in groups.items()},
        start_ns=int(start[1]) if start else start_ns,
        seconds=frozenset(seconds),
        warnings=tuple(notes),
        units=units,
        has_header=table.header >= 0,
        layout=layout.name,
    )


@contextmanager
def _parser_errors(name: str) -> Iterator[None]:
    """Turn what pandas reports about a text into a `FormatError`."""
    try:
        yield
    except pd.errors.ParserError as error:
        raise FormatError(f"{name}: {error}") from error


def _decode(data: bytes, name: str, max_bytes: int) -> str:
    """Return the text in bytes: UTF-8, UTF-16 with a mark, or Windows text."""
    if data.startswith(b"\x1f\x8b"):
        try:
            with gzip.open(io.BytesIO(data)) as file:
                data = file.read(max_bytes + 1)
        except (OSError, EOFError) as error:
            raise FormatError(f"{name}: damaged gzip ({error})") from error

    require_size(len(data), max_bytes, f"{name}: its text")
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return data.decode("utf-16")
    for place, encoding in ((1, "utf-16-le"), (0, "utf-16-be")):
        halves = data[place:1000:2], data[1 - place : 1000 : 2]
        if halves[0].count(0) > 0.7 * len(halves[0]) and not halves[1].count(0):
            return data.decode(encoding, "replace")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("cp1252", "replace")


def _lines_of_table(lines: Sequence[str]) -> list[tuple[int, str]]:
    """Return numbers and lines, without blank ones and comments but for names.

    `numpy.savetxt` writes names, and others units, as comments directly above the rows.
    """
    filled = [(i, line) for i, line in enumerate(lines, 1) if line.strip()]
    kept = [(i, line) for i, line in filled if not line.startswith(COMMENT)]
    if kept and _NUMBER.fullmatch(re.split(r"[,;\t ]", kept[0][1].strip())[0]):
        above = [(i, line.lstrip("# ")) for i, line in filled if i < kept[0][0]]
        return [*above[-2:], *kept]

    return kept


def _cells(line: str, delimiter: str) -> list[str]:
    """Return the cells of a line without empty ones at its end."""
    if delimiter == WHITE_SPACE:
        # In a header a unit belongs to the name before it.
        return re.sub(r"(?<=[^\s)\]])\s+(?=[(\[][^\s()\[\]]+[)\]])", "", line).split()

    cells = re.split(rf'{re.escape(delimiter)}(?=(?:[^"]*"[^"]*")*[^"]*$)', line)
    cells = [cell.strip().strip('"').strip() for cell in cells]
    while cells and not cells[-1]:
        cells.pop()

    return cells


def _fits(line: str, table: _Start) -> bool:
    """Return whether a line has the cells of the header, and no text beside them."""
    if line.count(table.delimiter) == table.width - 1:
        return True

    cells = _cells(line, table.delimiter)
    width = len(line.split(table.delimiter)) if '"' not in line else len(cells)
    is_spaced = table.delimiter == WHITE_SPACE
    return len(cells) <= table.width and (is_spaced or width >= table.width)


def _find_table(
    lines: Sequence[str], layout: Layout, knowledge: Knowledge
) -> _Start | None:
    """Return where the table begins: that which most cells with numbers belong to."""
    begin = 0
    if layout.table_after:
        ends = [
            i for i, line in enumerate(lines) if re.search(layout.table_after, line)
        ]
        begin = ends[-1] + 1 if ends else 0

    best: _Start | None = None
    most = 0
    for delimiter in (*knowledge.delimiters, WHITE_SPACE):
        for found, count in _tables(lines[:400], begin, delimiter):
            if count > most:
                best, most = found, count

    return best


def _tables(
    lines: Sequence[str], begin: int, delimiter: str
) -> Iterator[tuple[_Start, int]]:
    """Yield tables, each with the number of its cells that are numbers."""
    found: _Start | None = None
    count = 0
    above: list[tuple[int, int]] = []  # places and widths of lines without numbers
    for place, line in enumerate(lines[begin:], begin):
        cells = _cells(line, delimiter)
        numbers = sum(_NUMBER.fullmatch(cell) is not None for cell in cells)
        if not numbers:
            above = [*above[-2:], (place, len(cells))]
            continue

        headers = [each for each, width in above if width >= len(cells)]
        if headers or (found is None and numbers > 1 and 2 * numbers >= len(cells)):
            if found is not None:
                yield found, count

            header = headers[0] if headers else -1
            names = _cells(lines[header], delimiter) if headers else cells
            # LabVIEW leaves the cells below it away.
            has_comment = names[-1].lower() == "comment"
            width = max(len(cells), len(names) - has_comment)
            found = _Start(delimiter, header, place, width)
            count = 0

        above = []
        if found is not None and len(cells) <= found.width:
            count += numbers

    if found is not None:
        yield found, count


def _names_and_units(
    lines: Sequence[tuple[int, str]],
    start: _Start,
    layout: Layout,
    knowledge: Knowledge,
) -> tuple[tuple[str, ...], dict[str, StatedUnit], list[str]]:
    """Return unique names of the columns, the units of a row below, and what is odd."""
    if start.header < 0:
        names = tuple(f"column_{number + 1}" for number in range(start.width))
        return (
            names,
            {},
            [f"there is no header; columns are called column_1 to {names[-1]}"],
        )

    texts = [
        (number, _cells(line, start.delimiter))
        for number, line in lines[start.header : start.first_row]
    ]
    header = max(texts, key=lambda item: (known_names(item[1], knowledge), -item[0]))
    cells = [*header[1], *[""] * start.width][: start.width]
    names: list[str] = []
    notes: list[str] = []
    for number, cell in enumerate(cells, 1):
        if cell and cell in names:
            notes.append(
                f"the header names {cell!r} twice; one is called column_{number}"
            )

        names.append(cell if cell and cell not in names else f"column_{number}")

    rows = [row for row in texts if row != header and knowledge.is_row_of_units(row[1])]
    above = lines[: start.header] if layout.units_line else ()
    rows += [
        (number, [layout.first_unit, *_cells(line, start.delimiter)[1:]])
        for number, line in above
        if re.search(layout.units_line, line)
    ]
    units = {
        name: StatedUnit(unit_in_brackets(cell) or cell, number)
        for number, row in rows
        for name, cell in zip(names, row, strict=False)
        if cell.strip("- ")
    }
    return tuple(names), units, notes


def _read_columns(
    frame: pd.DataFrame,
) -> tuple[dict[str, np.ndarray], list[str], int, dict[str, str], list[str]]:
    """Return columns of numbers, those of times, their start, texts, and oddities."""
    columns: dict[str, np.ndarray] = {}
    seconds: list[str] = []
    texts: dict[str, str] = {}
    faults: list[str] = []
    start_ns = 0
    for name in frame:
        column = frame[name]
        numbers = pd.to_numeric(column, errors="coerce")
        filled = column.notna()
        if not filled.any():
            faults.append(f"column {name!r} is empty and was left out")
        elif numbers.notna().any():
            columns[name] = numbers.to_numpy()
            if odd := int((filled & numbers.isna()).sum()):
                faults.append(f"column {name!r}: cells that are not numbers: {odd}")
        elif (stamps_ns := _clock_ns(column[filled])) is not None:
            start_ns = start_ns or start_of_clock(first_valid_stamp(stamps_ns))
            values = np.full(len(column), np.nan)
            values[filled.to_numpy()] = to_seconds(stamps_ns, start_ns)
            columns[name] = values
            seconds.append(name)
        else:
            texts[name] = str(column[filled].iloc[0]).strip()

    return columns, seconds, start_ns, texts, faults


def _clock_ns(cells: pd.Series) -> np.ndarray | None:
    """Return dates with times, or times that go on over midnight, in ns; or None."""
    try:
        if str(cells.iloc[0]).count(":") == 2 and len(str(cells.iloc[0])) < 19:
            day_ns = 86_400 * NS_PER_S
            clock_ns = (
                pd.to_timedelta(cells).to_numpy("timedelta64[ns]").astype(np.int64)
            )
            days = np.cumsum(
                np.round(-np.diff(clock_ns, prepend=clock_ns[:1]) / day_ns)
            )
            return clock_ns + days.astype(np.int64) * day_ns

        dates = pd.to_datetime(cells, utc=True, format="ISO8601")
        return dates.dt.tz_localize(None).to_numpy("datetime64[ns]").astype(np.int64)
    except (ValueError, OverflowError):
        return None


def find_joint_groups(
    names: Iterable[str], texts: Mapping[str, str], rules: JointRules
) -> tuple[dict[str, dict[str, str]], set[str]]:
    """Find the joints that text exported from ROS topics names.

    A message of joint states holds names, positions, velocities and efforts. Tools that
    export it to text write one column for each joint, in one of the ways that
    `[joints]` in `layouts.toml` lists. These columns become one of two dimensions.

    Args:
        names: Of all columns of numbers.
        texts: Of each column of text, what its first row holds.
        rules: How names of columns are made.

    Returns:
        By name of the column that they become: the columns by joint. And the columns
        of text that state names of joints.
    """
    by_path: dict[str, dict[str, str]] = {}
    for name in names:
        if match := re.match(rules.by_path, name):
            group = match["head"] + match["field"]
            by_path.setdefault(group, {})[match["joint"]] = name

    named: dict[str, dict[str, str]] = {}  # joints by number, by what is before `name`
    head_of: dict[str, str] = {}
    for name, text in texts.items():
        listed = re.findall(r"['\"]([^'\"]+)['\"]", text)
        if match := re.match(rules.by_number, name):
            head_of[name] = match["head"]
            named.setdefault(match["head"], {})[match["number"]] = text
        elif len(listed) > 1 and (match := re.match(rules.by_list, name)):
            head_of[name] = match["head"]
            named[match["head"]] = {str(n): joint for n, joint in enumerate(listed)}

    groups = {group: members for group, members in by_path.items() if len(members) > 1}
    used: set[str] = set()
    for (head, joint_of), field in product(named.items(), rules.fields):
        expression = re.compile(rf"{re.escape(head + field)}_?\[?(\d{{1,3}})\]?")
        matches = filter(None, map(expression.fullmatch, names))
        column_of = {match[1]: match[0] for match in matches}
        if column_of.keys() == joint_of.keys():
            members = {joint: column_of[n] for n, joint in joint_of.items()}
            groups[head.replace(".", "/") + field] = members
            used |= {name for name, each in head_of.items() if each == head}

    return groups, used
