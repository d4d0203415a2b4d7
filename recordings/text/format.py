"""Reading CSV text, plain or compressed with gzip, whole or as it comes."""

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from recordings.errors import FormatError
from recordings.sources.byte_source import Patience, byte_blocks
from recordings.sources.text_lines import TextLines
from recordings.tables.table import FloatArray, Table
from recordings.text.columns import CsvColumns
from recordings.text.rows import CsvRows

CSV_SUFFIXES = (".csv", ".csv.gz", ".tsv", ".tsv.gz", ".txt")

HEAD_ROWS = 200
"""So many rows decide which columns a stream has; they come in one table, however they arrive."""


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
    blocks = byte_blocks(path, Patience())
    table, *_, last = csv_tables(blocks, str(path), head_rows=None)
    return Table(
        columns=table.columns,
        warnings=last.warnings,
        start_ns=table.start_ns,
        stamps=table.stamps,
    )


def csv_tables(
    blocks: Iterable[bytes],
    name: str,
    *,
    head_rows: int | None = HEAD_ROWS,
    is_growing: bool = False,
    is_stopped: Callable[[], bool] = lambda: False,
) -> Iterator[Table]:
    """Read CSV text as it comes.

    Args:
        blocks: bytes as read.
        name: of the source, for errors.
        head_rows: least rows of the first table; None to read all into one.
        is_growing: whether the source may end in the middle of a line that is being written.
        is_stopped: tells at the end whether it is one only because the user wanted no more.

    Yields:
        Tables of consecutive rows with equal columns; then one without rows, whose warnings tell
        all that was wrong.

    Raises:
        FileAccessError: the source cannot be read.
        FormatError: it is empty, has no header or no rows, or holds no numbers.
    """
    lines, rows, columns = TextLines(blocks), CsvRows(), CsvColumns()
    read: dict[str, FloatArray] = {}
    try:
        for batch in lines:
            rows.add(batch)
            if head_rows is not None and len(rows) >= (1 if read else head_rows):
                read = columns.read(rows.take())
                yield _table(rows, columns, read)
        if is_stopped():
            lines.forgive_end()
        rows.end(lines.tail, is_growing=is_growing)
        if len(rows):
            read = columns.read(rows.take())
            yield _table(rows, columns, read)
    except FormatError as error:
        told = "".join(f" ({warning})" for warning in lines.warnings)
        raise FormatError(f"{name}: {error}{told}") from error
    yield Table(
        columns={name: values[:0] for name, values in read.items()},
        warnings=(*lines.warnings, *rows.notes, *columns.notes()),
    )


def _table(rows: CsvRows, columns: CsvColumns, read: dict[str, FloatArray]) -> Table:
    return Table(
        columns=read, start_ns=rows.start_ns, stamps=columns.stamps, omitted=columns.omitted
    )
