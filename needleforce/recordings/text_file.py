"""CSV and its kin, plain or compressed with gzip: a header and rows of numbers."""

import codecs
import csv
import gzip
import io
import re
import warnings
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

import pandas as pd

from needleforce.recordings import errors
from needleforce.recordings.channel_request import parse_column_name
from needleforce.recordings.channels import Knowledge
from needleforce.recordings.columnar import table_of_frame
from needleforce.recordings.errors import FormatError, UnpackedSize, damage_errors
from needleforce.recordings.table import START_KEY, Table

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
    """Where a table in a text begins.

    Attributes:
        number_count: How many of its first cells are numbers.
        delimiter: Between cells.
        header: Place of the line with the names; -1 without one.
        first_row: Place of the first row.
        width: Cells of a row.
    """

    number_count: int
    delimiter: str
    header: int
    first_row: int
    width: int


def read_text(
    data: bytes, name: str, knowledge: Knowledge, unpacked: UnpackedSize
) -> Table:
    """Read a text: perhaps lines above, a header, perhaps units, rows of numbers.

    Args:
        data: The file, plain or compressed with gzip.
        name: Of the file, for messages.
        knowledge: Names and units that are known.
        unpacked: Counts what is in it if it is compressed.

    Raises:
        FormatError: There is no table in it, a quotation does not end, or it is too
            large.
    """
    data = _in_utf8(data, name, unpacked)
    head = data[: 1 << 20].decode("utf-8", "replace")
    lines = _lines_of_table(re.split(r"\r\n|\r|\n", head))[:400]
    texts = [line for _, line in lines]
    tables = [each for mark in DELIMITERS for each in _tables_in(texts, mark)]
    if not tables:
        raise FormatError(
            f"{name}: no table; expected a line of names and below it rows of numbers "
            f"with as many cells; it begins with {head[:60]!r}"
        )

    start = max(tables, key=lambda table: table.number_count)
    above = [_cells(line, start.delimiter) for line in texts[: start.first_row]]
    heads = above[start.header :] if start.header >= 0 else []
    header = max(heads, key=lambda cells: _count_names(cells, knowledge), default=[])
    names = _unique_names(header, start.width)
    notes = [
        f"the header has {cell!r} twice, one as {name}"
        for cell, name in zip(header, names, strict=False)
        if cell not in ("", name)
    ]
    if not header:
        notes = [f"there is no header; columns are called column_1 to {names[-1]}"]

    rows = [row for row in heads if _is_row_of_units(row, knowledge)]
    # Of LabVIEW, whose first column is the time.
    rows += [["s", *row[1:]] for row in above if row[:1] == ["Y_Unit_Label"]]
    units = {
        name: cell.strip("()[]{}<> ")
        for row in rows
        if row is not header
        for name, cell in zip(names, row, strict=False)
        if cell.strip("- ")
    }
    few_rows = "".join(texts[start.first_row :][:50])
    decimal = "."
    if start.delimiter != "," and re.search(r"\d,\d", few_rows):
        decimal = ","
        notes.append("decimal commas read as points")

    with (
        damage_errors(name, "table"),
        warnings.catch_warnings(record=True, action="always") as caught,
    ):
        frame = pd.read_csv(
            io.BytesIO(data),
            sep=start.delimiter,
            skiprows=lines[start.first_row][0],
            header=None,
            names=names,
            index_col=False,  # a delimiter may end each row
            comment="#",
            decimal=decimal,
            skipinitialspace=True,
            on_bad_lines="warn",
        )

    faults = "".join(str(each.message) for each in caught)
    if count := faults.count("Skipping line"):
        notes.append(f"rows with more than {len(names)} cells, left out: {count}")

    table = table_of_frame(frame)
    own_start = re.search(rf"^#\s*{START_KEY}\s*=\s*(-?\d+)\s*$", head, re.M)
    return replace(
        table,
        start_ns=int(own_start[1]) if own_start else table.start_ns,
        warnings=(*notes, *table.warnings),
        units=units,
    )


def _in_utf8(data: bytes, name: str, unpacked: UnpackedSize) -> bytes:
    """Return a text in UTF-8, UTF-16 or Windows' encoding, perhaps packed, in UTF-8.

    Raises:
        FormatError: It is damaged or too large.
    """
    if data.startswith(b"\x1f\x8b"):
        with damage_errors(name, "gzip file"), gzip.open(io.BytesIO(data)) as file:
            data = file.read(errors.MAX_BYTES + 1)

        unpacked.add(len(data), name)
    is_wide = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    for encoding in ("utf-16",) if is_wide else ("utf-8-sig", "cp1252"):
        with suppress(UnicodeDecodeError):
            text = data.decode(encoding)
            if "\0" not in text:
                return text.encode()

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

    line = line.rstrip(f"{delimiter} ")
    (row,) = csv.reader([line], delimiter=delimiter, skipinitialspace=True)
    return [cell.strip() for cell in row]


def _tables_in(lines: Sequence[str], delimiter: str) -> list[_Start]:
    """Return where tables begin: below a line with as many cells, or with numbers."""
    rows = [_cells(line, delimiter) for line in lines]
    counts = [sum(map(bool, map(_NUMBER.fullmatch, cells))) for cells in rows]
    tables: list[_Start] = []
    above: list[int] = []  # places of lines without numbers
    for place, (cells, count) in enumerate(zip(rows, counts, strict=True)):
        if not count:
            above = [*above[-2:], place]
            continue

        header = next((each for each in above if len(rows[each]) >= len(cells)), -1)
        above = []
        if header >= 0 or (not tables and 1 < count >= len(cells) / 2):
            names = rows[header] if header >= 0 else []
            # LabVIEW leaves the cells below its last name away.
            named = len(names) - ([each.lower() for each in names[-1:]] == ["comment"])
            tables.append(_Start(0, delimiter, header, place, max(len(cells), named)))
        if tables and len(cells) <= tables[-1].width:
            number_count = tables[-1].number_count + count
            tables[-1] = tables[-1]._replace(number_count=number_count)

    return tables


def _unique_names(header: Sequence[str], width: int) -> list[str]:
    """Return a name for each of so many columns, `column_3` where there is none."""
    cells = [*header, *[""] * width][:width]
    return [
        cell if cell and cell not in cells[:place] else f"column_{place + 1}"
        for place, cell in enumerate(cells)
    ]


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
