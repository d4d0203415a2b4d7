"""Reading Parquet files, whole or a number of rows at a time."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from recordings.clock.whole_stamps import whole_stamps
from recordings.columnar.parquet_column import ParquetColumn, is_number_column
from recordings.errors import FileAccessError, FormatError
from recordings.optional_library import optional_library
from recordings.tables.labels import START_KEY
from recordings.tables.table import Table

_BUFFER = 1 << 16  # bytes of a column

START = START_KEY.encode()
"""Where the schema's metadata say when t = 0 was."""


def read_parquet(path: Path) -> Table:
    """Read a Parquet file.

    Columns of numbers, or of lists of equally many numbers, are taken; empty cells are NaN. Time
    stamps become seconds, without loss. Columns of anything else are left out and told in the
    table's warnings.

    Args:
        path: the file.

    Returns:
        Its columns.

    Raises:
        FileAccessError: the file cannot be read, or pyarrow is not installed.
        FormatError: it is not a Parquet file, is cut short, or holds no numbers.
    """
    return next(parquet_chunks(path, rows=None))


def parquet_chunks(path: Path, rows: int | None) -> Iterator[Table]:
    """Read a Parquet file a number of rows at a time.

    Args:
        path: the file.
        rows: the most rows of a table; None for all in one.

    Yields:
        Tables of consecutive rows with equal columns; the warnings stand in the first.

    Raises:
        FileAccessError: see `read_parquet`.
        FormatError: see `read_parquet`.
    """
    parquet = optional_library("pyarrow.parquet", "Parquet files")
    arrow = optional_library("pyarrow", "Parquet files")
    try:
        # Read ahead, columns would stay in memory to the end.
        with parquet.ParquetFile(path, pre_buffer=False, buffer_size=_BUFFER) as file:
            yield from _tables(path, file, rows, arrow)
    except (FileAccessError, FormatError):
        raise
    except (arrow.ArrowException, UnicodeDecodeError, OSError) as error:
        # Arrow's own failures come as OSError too, but have no number.
        if getattr(error, "errno", None) is not None:
            raise FileAccessError(f"cannot read {path}: {error}") from error
        raise FormatError(
            f"{path} is not a Parquet file, or it is damaged or cut short: a Parquet file ends "
            f"with its table of contents, so that nothing can be read without its end ({error})"
        ) from error


def _tables(path: Path, file: Any, rows: int | None, arrow: Any) -> Iterator[Table]:
    schema, total = file.schema_arrow, file.metadata.num_rows
    wanted = [field.name for field in schema if is_number_column(field.type, arrow.types)]
    warnings = tuple(
        f"column {field.name!r} holds {field.type}, no numbers, and was left out"
        for field in schema
        if field.name not in wanted
    )
    if not (wanted and total):
        told = "".join(f" ({warning})" for warning in warnings)
        raise FormatError(f"{path} holds {total} rows of {len(wanted)} columns of numbers{told}")
    readers = {name: ParquetColumn(arrow) for name in wanted}
    start_ns = int((schema.metadata or {}).get(START, 0))
    for batch in _batches(file, rows, wanted):
        columns, stamps = {}, {}
        for name, reader in readers.items():
            columns[name] = reader.read(batch.column(name), start_ns)
            start_ns = start_ns or reader.start_ns
            stamps |= whole_stamps({name: reader.whole(batch.column(name))})
        yield Table(columns=columns, warnings=warnings, start_ns=start_ns, stamps=stamps)
        warnings = ()


def _batches(file: Any, rows: int | None, wanted: list[str]) -> Iterator[Any]:
    if rows is not None:
        yield from file.iter_batches(batch_size=rows, columns=wanted)
    else:
        # Not iter_batches, whose batches may end with a row group.
        yield from file.read(columns=wanted).combine_chunks().to_batches()
