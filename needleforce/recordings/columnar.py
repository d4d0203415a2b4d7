"""npz, Parquet and Feather: files that hold one column after the other.

A Parquet file is read some rows at a time, the others are held in memory as a whole.
Pickled objects are never loaded.
"""

import zipfile
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import replace
from math import prod
from pathlib import Path
from typing import IO, Any

import numpy as np

from needleforce.recordings.errors import (
    RECOVER,
    FormatError,
    file_errors,
    optional_library,
    require_size,
)
from needleforce.recordings.table import MAX_LIST_NUMBERS, START_KEY, Table
from needleforce.recordings.time_stamps import (
    first_valid_stamp,
    start_of_clock,
    to_seconds,
)

ARROW_SUFFIXES = (".parquet", ".feather")
"""Of files that pyarrow reads."""

BYTES_PER_NUMBER = 8
"""Of a number in memory, as float64 or int64."""


def read_npz(path: Path, max_bytes: int) -> Table:
    """Read an npz archive: arrays of numbers become columns; single numbers do not.

    Arrays that hold no numbers, or are damaged, are left out, with a warning.

    Raises:
        RecordingError: As `read_table` does.
    """
    with file_errors(path):
        try:
            with zipfile.ZipFile(path) as archive:
                return _npz_table(path, archive, max_bytes)
        except (zipfile.BadZipFile, NotImplementedError) as error:
            raise FormatError(
                f"{path} is not an npz archive, or it is cut short: an npz file ends "
                "with its table of contents, so that nothing can be read without its "
                "end",
                RECOVER,
            ) from error


def _npz_table(path: Path, archive: zipfile.ZipFile, max_bytes: int) -> Table:
    """Return the arrays of an open archive as a table."""
    arrays: dict[str, np.ndarray] = {}
    warnings: list[str] = []
    size = 0
    for member in archive.namelist():
        name = member.removesuffix(".npy")
        try:
            with archive.open(member) as stream:
                size += _npy_size(stream)

            require_size(size, max_bytes, f"{path}: what its arrays hold")
            with archive.open(member) as stream:
                values = np.lib.format.read_array(stream, allow_pickle=False)

            # So that a `Table` need not copy them.
            for array in (values, values.base):
                if isinstance(array, np.ndarray):
                    array.setflags(write=False)

            arrays[name] = values
        except (OSError, FormatError, MemoryError):
            raise
        except Exception as error:
            # A damaged header raises whatever numpy's and Python's parsers run into.
            warnings.append(
                f"column {name!r} cannot be read ({error}) and was left out"
            )

    start = arrays.get(START_KEY)
    start_ns = int(start) if start is not None and start.shape == () else 0
    columns = {name: values for name, values in arrays.items() if values.ndim}
    if not columns:
        reasons = f": {'; '.join(warnings)}" if warnings else ""
        raise FormatError(f"{path} holds no array of numbers{reasons}")

    return Table(columns=columns, warnings=tuple(warnings), start_ns=start_ns)


def _npy_size(stream: IO[bytes]) -> int:
    """Return from an array's header how many bytes it takes.

    Raises:
        ValueError: It is no column of numbers.
    """
    if np.lib.format.read_magic(stream) == (1, 0):
        shape, _, dtype = np.lib.format.read_array_header_1_0(stream)
    else:
        shape, _, dtype = np.lib.format.read_array_header_2_0(stream)

    if dtype.kind not in "fiub":
        raise ValueError(f"it holds {dtype}, no numbers")
    if len(shape) > 2 or any(n < 1 for n in shape):
        raise ValueError(f"its shape is {shape}, not (n,) or (n, k)")

    return prod(shape) * max(dtype.itemsize, BYTES_PER_NUMBER)


def arrow_tables(path: Path, max_bytes: int) -> Iterator[Table]:
    """Read the columns of numbers, lists and time stamps of a Parquet or Feather file.

    Empty cells are NaN; time stamps are seconds, without loss; lists of one length are
    a column of two dimensions. Columns of anything else are left out, with a warning.

    Raises:
        RecordingError: As `read_table` does.
    """
    is_parquet = path.suffix.lower() == ".parquet"
    kind = "Parquet" if is_parquet else "Feather"
    arrow = optional_library("pyarrow", f"{kind} files")
    module = "pyarrow.parquet" if is_parquet else "pyarrow.feather"
    library = optional_library(module, f"{kind} files")
    rows_of_table = 1 << 14
    try:
        if not is_parquet:
            require_size(path.stat().st_size, max_bytes, f"{path}: what it holds")
            content = library.read_table(path, use_threads=False)
            require_size(content.nbytes, max_bytes, f"{path}: what it holds")
            reader = _ArrowReader(path, content.schema, arrow)
            batches = content.to_batches(max_chunksize=rows_of_table)
            yield from reader.tables(batches)
            return

        with library.ParquetFile(
            path,
            page_checksum_verification=True,
            buffer_size=1 << 16,  # else all pages of a column are held
        ) as file:
            _require_groups(file.metadata, max_bytes, f"{path}: a part of it")
            reader = _ArrowReader(path, file.schema_arrow, arrow)
            batches = file.iter_batches(batch_size=rows_of_table, use_threads=False)
            yield from reader.tables(batches)
    except (arrow.ArrowException, UnicodeDecodeError, OSError) as error:
        # Arrow's own failures come as OSError too, but have no number.
        if getattr(error, "errno", None) is not None:
            with file_errors(path):
                raise

        raise FormatError(
            f"{path} is not a {kind} file, or it is damaged or cut short: such a file "
            "ends with its table of contents, so that nothing can be read without its "
            f"end ({error})",
            RECOVER,
        ) from error


def _require_groups(metadata: Any, max_bytes: int, subject: str) -> None:
    """Raise `FormatError` if a group of rows of a Parquet file takes too many bytes.

    Repeated numbers take no room in the file, but all of it in memory.
    """
    for group in map(metadata.row_group, range(metadata.num_row_groups)):
        columns = map(group.column, range(group.num_columns))
        number_bytes = BYTES_PER_NUMBER * sum(column.num_values for column in columns)
        require_size(max(number_bytes, group.total_byte_size), max_bytes, subject)


class _ArrowReader:
    """Turns rows of pyarrow into tables; the first ones decide what columns hold.

    Args:
        path: Of the file, for messages.
        schema: Names and types of the columns.
        arrow: The library.

    Raises:
        FormatError: A name stands twice.
    """

    def __init__(self, path: Path, schema: Any, arrow: Any) -> None:
        for name, count in Counter(schema.names).items():
            if count > 1:
                raise FormatError(
                    f"{path} has more than one column {name!r}; rename the others"
                )

        self._path = path
        self._schema = schema
        self._arrow = arrow
        self._start_ns = int((schema.metadata or {}).get(START_KEY.encode(), 0))
        self._widths: dict[str, int] = {}  # of columns of lists

    def tables(self, batches: Iterable[Any]) -> Iterator[Table]:
        """Yield the columns of rows that hold numbers."""
        head: Table | None = None
        for batch in batches:
            if head is not None:
                columns = {name: self._read(name, batch) for name in head.columns}
                yield replace(head, columns=columns, warnings=())
            elif batch.num_rows:
                head = self._head(batch)
                yield head

        if head is None:
            raise FormatError(f"{self._path} holds 0 rows without numbers")

    def _head(self, batch: Any) -> Table:
        """Return the columns of the first rows."""
        arrow = self._arrow
        columns: dict[str, np.ndarray] = {}
        warnings: list[str] = []
        kinds = {field.name: field.type for field in self._schema}
        for name, kind in kinds.items():
            try:
                columns[name] = self._read(name, batch)
            except (arrow.ArrowInvalid, arrow.ArrowNotImplementedError, TypeError):
                warnings.append(
                    f"column {name!r} holds {kind}, no numbers, and was left out"
                )

        if not columns:
            left_out = "".join(f" ({warning})" for warning in warnings)
            raise FormatError(f"{self._path} holds rows without numbers{left_out}")

        is_time = arrow.types.is_timestamp
        seconds = (name for name in columns if is_time(kinds[name]))
        return Table(
            columns=columns,
            warnings=tuple(warnings),
            start_ns=self._start_ns,
            seconds=frozenset(seconds),
        )

    def _read(self, name: str, batch: Any) -> np.ndarray:
        """Return a column of numbers, of lists of these, or of seconds.

        Raises:
            TypeError, ArrowInvalid, ArrowNotImplementedError: It holds none.
        """
        cells = batch.column(name)
        types = self._arrow.types
        if types.is_timestamp(cells.type):
            return self._read_stamps(cells)

        is_list = (types.is_list, types.is_large_list, types.is_fixed_size_list)
        if not any(is_kind(cells.type) for is_kind in is_list):
            return self._read_numbers(cells)

        # Lists of another length than most are NaN.
        compute = optional_library("pyarrow.compute", "Parquet files")
        lengths = compute.list_value_length(cells).fill_null(-1).to_numpy()
        usual = int(np.bincount(lengths[lengths > 0], minlength=2).argmax())
        width = self._widths.setdefault(name, usual)
        if width > MAX_LIST_NUMBERS:
            raise TypeError(f"lists of {width} numbers, which are no signal")

        is_usual = lengths == width
        numbers = compute.list_flatten(cells.filter(self._arrow.array(is_usual)))
        rows = np.full((len(lengths), width), np.nan)
        rows[is_usual] = self._read_numbers(numbers).reshape(-1, width)
        return rows

    def _read_stamps(self, cells: Any) -> np.ndarray:
        """Return time stamps in seconds, NaN where there is none."""
        kind = self._arrow.timestamp("ns", cells.type.tz)
        stamps = cells.cast(kind).cast(self._arrow.int64())
        is_known = cells.is_valid().to_numpy(zero_copy_only=False)
        stamps_ns = stamps.fill_null(0).to_numpy(zero_copy_only=False)
        if is_known.any():
            first_ns = first_valid_stamp(stamps_ns[is_known])
            self._start_ns = self._start_ns or start_of_clock(first_ns)

        return np.where(is_known, to_seconds(stamps_ns, self._start_ns), np.nan)

    def _read_numbers(self, cells: Any) -> np.ndarray:
        """Return numbers, NaN for empty cells."""
        types = self._arrow.types
        if types.is_string(cells.type) or types.is_large_string(cells.type):
            raise TypeError("text, which a cast would read as numbers")
        if not types.is_integer(cells.type) or cells.null_count:
            # Without the check of `safe`, which refuses integers that a double rounds.
            cells = cells.cast(self._arrow.float64(), safe=False)

        return cells.to_numpy(zero_copy_only=False)
