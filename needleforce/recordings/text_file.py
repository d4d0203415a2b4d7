"""CSV and its kin, plain or compressed with gzip: a header and rows of numbers."""

import codecs
import csv
import gzip
import io
import re
import warnings
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from itertools import product
from typing import NamedTuple

import numpy as np
import pandas as pd

from needleforce.recordings.channels import Knowledge
from needleforce.recordings.column_names import parse_column_name
from needleforce.recordings.errors import FormatError, require_size
from needleforce.recordings.table import START_KEY, Table
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

WHITE_SPACE = r"\s+"
DELIMITERS = (",", ";", "\t", "|", WHITE_SPACE)

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
        knowledge: Names and units that are known.
        max_bytes: The most memory that the text may take.

    Raises:
        FormatError: There is no table in it.
    """
    data = _in_utf8(data, name, max_bytes)
    head = data[: 1 << 20].decode("utf-8", "replace")
    lines = _lines_of_table(re.split(r"\r\n|\r|\n", head))[:400]
    texts = [line for _, line in lines]
    tables = [each for mark in DELIMITERS for each in _tables_in(texts, mark)]
    if not tables:
        raise FormatError(
            f"{name}: no table; expected a line of names and below it rows of numbers "
            f"with as many cells; it begins with {head[:60]!r}"
        )

    start, _ = max(tables, key=lambda table: table[1])
    names, units, notes = _names_and_units(texts, start, knowledge)
    first_row = lines[start.first_row][0]
    few_rows = "".join(texts[start.first_row :][:50])
    decimal = "," if start.delimiter != "," and re.search(r"\d,\d", few_rows) else "."
    if decimal == ",":
        notes.append("decimal commas read as points")

    frame = _read_rows(data, name, start.delimiter, first_row, names, decimal, notes)
    columns, seconds, start_ns, texts = _read_columns(frame, notes)
    groups = find_joint_groups(columns, texts)
    for each, cell in texts.items():
        advice = ": write its numbers as columns" if cell.startswith("[") else ""
        if not groups or "name" not in each:
            notes.append(
                f"column {each!r} holds text ({cell[:40]!r}) and was left out{advice}"
            )

    if not columns:
        raise FormatError(f"{name}: no column holds a number: {'; '.join(notes)[:500]}")

    for group, members in groups.items():
        values = np.stack([columns.pop(each) for each in members.values()], axis=1)
        columns[group] = values

    own_start = re.search(rf"^#\s*{START_KEY}\s*=\s*(-?\d+)\s*$", head, re.M)
    return Table(
        columns=columns,
        joint_names={group: tuple(members) for group, members in groups.items()},
        start_ns=int(own_start[1]) if own_start else start_ns,
        seconds=frozenset(seconds),
        warnings=tuple(notes),
        units=units,
    )


def _read_rows(
    data: bytes,
    name: str,
    delimiter: str,
    first_row: int,
    columns: Sequence[str],
    decimal: str,
    notes: list[str],
) -> pd.DataFrame:
    """Return rows of cells by column; those of too many cells are left out and noted.

    Raises:
        FormatError: A quotation does not end.
    """
    try:
        with warnings.catch_warnings(record=True, action="always") as caught:
            frame = pd.read_csv(
                io.BytesIO(data),
                sep=delimiter,
                skiprows=first_row,
                header=None,
                names=list(columns),
                index_col=False,  # a delimiter may end each row
                comment="#",
                decimal=decimal,
                skipinitialspace=True,
                on_bad_lines="warn",
            )
    except pd.errors.ParserError as error:
        raise FormatError(f"{name}: {error}") from error

    faults = "".join(str(each.message) for each in caught)
    if count := faults.count("Skipping line"):
        notes.append(f"rows with more than {len(columns)} cells, left out: {count}")

    return frame


def _in_utf8(data: bytes, name: str, max_bytes: int) -> bytes:
    """Return a text in UTF-8, UTF-16 or Windows' encoding, perhaps packed, in UTF-8.

    Raises:
        FormatError: It is damaged, or longer than allowed.
    """
    if data.startswith(b"\x1f\x8b"):
        try:
            with gzip.open(io.BytesIO(data)) as file:
                data = file.read(max_bytes + 1)
        except (OSError, EOFError) as error:
            raise FormatError(f"{name}: damaged gzip ({error})") from error

    require_size(len(data), max_bytes, f"{name}: its text")
    is_wide = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    for encoding in ("utf-16",) if is_wide else ("utf-8", "cp1252"):
        with suppress(UnicodeDecodeError):
            text = data.decode(encoding)
            if "\0" not in text:  # without a copy where there is no need
                is_utf8 = encoding == "utf-8"
                return data.removeprefix(codecs.BOM_UTF8) if is_utf8 else text.encode()

    raise FormatError(
        f"{name}: it is no text in UTF-8, UTF-16 or Windows' encoding",
        "Save it as UTF-8.",
    )


def _lines_of_table(lines: Sequence[str]) -> list[tuple[int, str]]:
    """Return places and lines, without blank ones and comments but for names.

    `numpy.savetxt` writes names, and others units, as comments directly above the rows.
    """
    filled = [(place, line) for place, line in enumerate(lines) if line.strip()]
    kept = [(place, line) for place, line in filled if not line.startswith("#")]
    if kept and _NUMBER.fullmatch(re.split(r"[,;\t ]", kept[0][1].strip())[0]):
        above = [(i, line.lstrip("# ")) for i, line in filled if i < kept[0][0]]
        return [*above[-2:], *kept]

    return kept


def _cells(line: str, delimiter: str) -> list[str]:
    """Return the cells of a line without empty ones at its end."""
    if delimiter == WHITE_SPACE:
        # In a header a unit belongs to the name before it.
        return re.sub(r"(?<=[^\s)\]])\s+(?=[(\[][^\s()\[\]]+[)\]])", "", line).split()

    (row,) = csv.reader([line], delimiter=delimiter, skipinitialspace=True)
    cells = [cell.strip() for cell in row]
    while cells and not cells[-1]:
        cells.pop()

    return cells


def _tables_in(lines: Sequence[str], delimiter: str) -> list[tuple[_Start, int]]:
    """Return where tables begin, each with the number of its cells that are numbers."""
    tables: list[tuple[_Start, int]] = []
    above: list[int] = []  # places of lines without numbers
    for place, line in enumerate(lines):
        cells = _cells(line, delimiter)
        numbers = sum(_NUMBER.fullmatch(cell) is not None for cell in cells)
        if not numbers:
            above = [*above[-2:], place]
            continue

        widths = {each: len(_cells(lines[each], delimiter)) for each in above}
        header = next((each for each in above if widths[each] >= len(cells)), -1)
        is_bare = not tables and numbers > 1 and 2 * numbers >= len(cells)
        if header >= 0 or is_bare:
            names = _cells(lines[max(header, 0)], delimiter)
            # LabVIEW leaves the cells below it away.
            has_comment = names[-1].lower() == "comment"
            name_count = len(names) - has_comment if header >= 0 else 0
            width = max(len(cells), name_count)
            tables.append((_Start(delimiter, header, place, width), 0))

        above = []
        if tables and len(cells) <= tables[-1][0].width:
            start, count = tables[-1]
            tables[-1] = (start, count + numbers)

    return tables


def _names_and_units(
    lines: Sequence[str], start: _Start, knowledge: Knowledge
) -> tuple[list[str], dict[str, str], list[str]]:
    """Return unique names of the columns, the units of a row below, and what is odd."""
    if start.header < 0:
        names = [f"column_{number + 1}" for number in range(start.width)]
        note = f"there is no header; columns are called column_1 to {names[-1]}"
        return names, {}, [note]

    head = lines[start.header : start.first_row]
    texts = [_cells(line, start.delimiter) for line in head]
    header = max(texts, key=lambda cells: _count_names(cells, knowledge))
    names = []
    notes: list[str] = []
    for number, cell in enumerate([*header, *[""] * start.width][: start.width], 1):
        if cell in names:
            notes.append(f"the header has {cell!r} twice, one as column_{number}")

        names.append(cell if cell and cell not in names else f"column_{number}")

    rows = [row for row in texts if _is_row_of_units(row, knowledge)]
    rows += [  # of LabVIEW, whose first column is the time
        ["s", *_cells(line, start.delimiter)[1:]]
        for line in lines[: start.header]
        if line.startswith("Y_Unit_Label\t")
    ]
    units = {
        name: cell.strip("()[]{}<> ")
        for row in rows
        if row is not header
        for name, cell in zip(names, row, strict=False)
        if cell.strip("- ")
    }
    return names, units, notes


def _count_names(cells: Iterable[str], knowledge: Knowledge) -> int:
    """Return how many cells of a line name a channel."""
    return sum(
        parse_column_name(cell, channel.units).stem
        in (*channel.spellings, *channel.machine_words)
        for cell in cells
        for channel in knowledge.channels.values()
    )


def _is_row_of_units(cells: Iterable[str], knowledge: Knowledge) -> bool:
    """Return whether a row holds units: `(s),(mm),(kN)` or `s;mm;kN`.

    Every cell is empty, in brackets or a unit, and at least one is a known unit.
    """
    bare = {
        cell: re.sub(r"^[(\[{<](.*)[)\]}>]$", r"\1", cell) for cell in cells if cell
    }
    known = {cell for cell, text in bare.items() if knowledge.is_unit(text.strip())}
    return bool(known) and all(cell in known or cell != bare[cell] for cell in bare)


def _read_columns(
    frame: pd.DataFrame, notes: list[str]
) -> tuple[dict[str, np.ndarray], list[str], int, dict[str, str]]:
    """Return columns of numbers, those of times, their start, and texts; add notes."""
    columns: dict[str, np.ndarray] = {}
    seconds: list[str] = []
    texts: dict[str, str] = {}
    start_ns = 0
    for name in map(str, frame):
        column = frame[name]
        numbers = pd.to_numeric(column, errors="coerce")
        filled = column.notna()
        if not filled.any():
            notes.append(f"column {name!r} is empty and was left out")
        elif numbers.notna().any():
            columns[name] = numbers.to_numpy()
            if odd := int((filled & numbers.isna()).sum()):
                notes.append(f"column {name!r}: cells that are not numbers: {odd}")
        elif (stamps_ns := _clock_ns(column[filled])) is not None:
            start_ns = start_ns or start_of_clock(first_valid_stamp(stamps_ns))
            values = np.full(len(column), np.nan)
            values[filled.to_numpy()] = to_seconds(stamps_ns, start_ns)
            columns[name] = values
            seconds.append(name)
        else:
            texts[name] = str(column[filled].iloc[0]).strip()

    return columns, seconds, start_ns, texts


def _clock_ns(cells: pd.Series) -> np.ndarray | None:
    """Return dates with times, or times that go on over midnight, in ns; or None."""
    try:
        if re.match(r"\s*\d+:\d+:\d", str(cells.iloc[0])):
            day_ns = 86_400 * NS_PER_S
            clock_ns = pd.to_timedelta(cells).to_numpy("m8[ns]").astype(np.int64)
            steps_ns = np.diff(clock_ns, prepend=clock_ns[:1])
            days = np.cumsum(np.round(-steps_ns / day_ns)).astype(np.int64)
            return clock_ns + days * day_ns

        dates = pd.to_datetime(cells, utc=True, format="ISO8601")
        return dates.dt.tz_localize(None).to_numpy("M8[ns]").astype(np.int64)
    except (ValueError, OverflowError):
        return None


def find_joint_groups(
    names: Iterable[str], texts: Mapping[str, str]
) -> dict[str, dict[str, str]]:
    """Find the joints that text exported from ROS topics names.

    `field.name0` holds the name of `field.position0`, or `name` the list of the names
    of `position_0`, `position_1`, ...; these columns become one of two dimensions.

    Args:
        names: Of all columns of numbers.
        texts: Of each column of text, what its first row holds.

    Returns:
        By name of the column that they become: the columns by joint.
    """
    joints: dict[str, dict[str, str]] = {}  # by number, by what is before `name`
    for name, text in texts.items():
        if match := re.fullmatch(r"((?:.*[./])?)name_?\[?(\d{0,3})\]?", name):
            listed = re.findall(r"['\"]([^'\"]+)['\"]", text)
            numbered = {str(number): each for number, each in enumerate(listed)}
            if match[2]:
                numbered = {match[2]: text}

            joints.setdefault(match[1], {}).update(numbered)

    groups: dict[str, dict[str, str]] = {}
    for (head, joint_of), field in product(
        joints.items(), ("position", "velocity", "effort")
    ):
        expression = re.compile(rf"{re.escape(head + field)}_?\[?(\d{{1,3}})\]?")
        matches = filter(None, map(expression.fullmatch, names))
        column_of = {match[1]: match[0] for match in matches}
        if joint_of and column_of.keys() == joint_of.keys():
            members = {joint: column_of[number] for number, joint in joint_of.items()}
            groups[head.replace(".", "/") + field] = members

    return groups
