"""npz and Parquet: files that hold one column after the other, read and written.

An npz file is held in memory as a whole, read or written; pickled objects are never loaded.
"""

import zipfile
from collections.abc import Iterator
from math import prod
from pathlib import Path
from typing import IO, Any, BinaryIO

import numpy as np

from needleforce.recordings.errors import (
    MAX_BYTES,
    FormatError,
    file_errors,
    optional_library,
    require_size,
)
from needleforce.recordings.table import (
    START_KEY,
    Columns,
    FloatArray,
    Labels,
    Table,
    flat_columns,
    start_of_clock,
    to_seconds,
    whole_stamps,
)

_NUMBER_KINDS = "fiub"


def read_npz(path: Path, max_bytes: int = MAX_BYTES) -> Table:
    """Read an npz archive: arrays of numbers become columns, single numbers constants.

    Arrays that hold no numbers, or are damaged, are left out, with a warning.

    Raises:
        FileAccessError: the file cannot be read.
        FormatError: it is no npz archive, is cut short, or holds no usable array, or too much.
    """
    with file_errors(path):
        try:
            with zipfile.ZipFile(path) as archive:
                return _npz_table(path, archive, max_bytes)
        except (zipfile.BadZipFile, NotImplementedError) as error:
            raise FormatError(
                f"{path} is not an npz archive, or it is cut short: an npz file ends with its "
                "table of contents, so that nothing can be read without its end"
            ) from error


def _npz_table(path: Path, archive: zipfile.ZipFile, max_bytes: int) -> Table:
    columns: dict[str, np.ndarray] = {}
    constants: dict[str, float] = {}
    warnings: list[str] = []
    total = 0
    for member in archive.namelist():
        name = member.removesuffix(".npy")
        try:
            with archive.open(member) as stream:
                total += _npy_size(stream)
            require_size(total, max_bytes, f"{path}: what its arrays hold")
            with archive.open(member) as stream:
                values = np.lib.format.read_array(stream, allow_pickle=False)
        except (OSError, FormatError, MemoryError):
            raise
        except Exception as error:
            # A damaged header raises whatever numpy's and Python's parsers run into.
            reason = (
                error if isinstance(error, _UnusableArrayError) else f"cannot be read ({error})"
            )
            warnings.append(f"column {name!r} {reason} and was left out")
            continue
        if values.ndim:
            columns[name] = values
        else:
            constants[name] = values.item()
    if not columns:
        raise FormatError(
            f"{path} holds no array of numbers{': ' * bool(warnings)}{'; '.join(warnings)}"
        )
    return Table(
        columns=columns,
        warnings=tuple(warnings),
        start_ns=int(constants.pop(START_KEY, 0)),
        constants={name: float(value) for name, value in constants.items()},
        stamps=whole_stamps(columns),
    )


class _UnusableArrayError(ValueError):
    """An array that is no column of numbers; the message goes on after its name."""


def _npy_size(stream: IO[bytes]) -> int:
    """Return from an array's header how many bytes it takes."""
    if np.lib.format.read_magic(stream) == (1, 0):
        shape, _, dtype = np.lib.format.read_array_header_1_0(stream)
    else:
        shape, _, dtype = np.lib.format.read_array_header_2_0(stream)
    if dtype.hasobject:
        raise _UnusableArrayError("cannot be read (Object arrays cannot be loaded)")
    if dtype.kind not in _NUMBER_KINDS:
        raise _UnusableArrayError(f"holds {dtype}, no numbers,")
    if len(shape) > 2 or any(n < 1 for n in shape):
        raise _UnusableArrayError(f"has shape {shape}, not (n,) or (n, k),")
    return prod(shape) * max(dtype.itemsize, 8)


class NpzWriter:
    """Collects rows in memory, since an archive cannot be appended to; writes it at the end."""

    def __init__(self, stream: BinaryIO, labels: Labels) -> None:
        self._stream, self._start_ns = stream, labels.start_ns
        self._parts: dict[str, list[np.ndarray]] = {}

    def append(self, columns: Columns) -> None:
        """Take rows of checked columns, the same in every call."""
        for name, values in columns.items():
            self._parts.setdefault(name, []).append(np.array(values))

    def flush(self) -> None:
        """Nothing can be read before the end."""

    def finish(self) -> None:
        """Write the archive."""
        arrays = {name: np.concatenate(parts) for name, parts in self._parts.items()}
        if self._start_ns:
            arrays[START_KEY] = np.array(self._start_ns, dtype=np.int64)
        # numpy.savez could not write a column called "file".
        with zipfile.ZipFile(self._stream, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, values in arrays.items():
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                    np.lib.format.write_array(member, values)


def parquet_tables(
    path: Path, rows: int | None = None, max_bytes: int = MAX_BYTES
) -> Iterator[Table]:
    """Read a Parquet file in tables of at most so many rows, all at once if None.

    Columns of numbers, or of lists of equally many numbers, are taken; empty cells are NaN. Time
    stamps become seconds, without loss. Columns of anything else are left out, with a warning.

    Raises:
        FileAccessError: the file cannot be read, or pyarrow is not installed.
        FormatError: it is no Parquet file, is damaged or cut short, or holds no numbers, or too
            much.
    """
    parquet = optional_library("pyarrow.parquet", "Parquet files")
    arrow = optional_library("pyarrow", "Parquet files")
    try:
        # Read ahead, columns would stay in memory to the end.
        with parquet.ParquetFile(
            path, pre_buffer=False, buffer_size=1 << 16, page_checksum_verification=True
        ) as file:
            groups = [file.metadata.row_group(i) for i in range(file.metadata.num_row_groups)]
            sizes = [group.total_byte_size for group in groups]
            size = sum(sizes) if rows is None else max(sizes, default=0)
            require_size(size, max_bytes, f"{path}: what it holds")
            yield from _parquet_tables(path, file, rows, arrow)
    except (arrow.ArrowException, UnicodeDecodeError, OSError) as error:
        # Arrow's own failures come as OSError too, but have no number.
        if getattr(error, "errno", None) is not None:
            with file_errors(path):
                raise
        raise FormatError(
            f"{path} is not a Parquet file, or it is damaged or cut short: a Parquet file ends "
            f"with its table of contents, so that nothing can be read without its end ({error})"
        ) from error


def _parquet_tables(path: Path, file: Any, rows: int | None, arrow: Any) -> Iterator[Table]:
    schema, total, types = file.schema_arrow, file.metadata.num_rows, arrow.types
    wanted = [field.name for field in schema if _is_number_column(field.type, types)]
    warnings = tuple(
        f"column {field.name!r} holds {field.type}, no numbers, and was left out"
        for field in schema
        if field.name not in wanted
    )
    if not (wanted and total):
        left_out = "".join(f" ({warning})" for warning in warnings)
        raise FormatError(
            f"{path} holds {total} rows of {len(wanted)} columns of numbers{left_out}"
        )
    readers = {name: _ParquetColumn(arrow) for name in wanted}
    start_ns = int((schema.metadata or {}).get(START_KEY.encode(), 0))
    if rows is None:
        # Not iter_batches, whose batches may end with a row group.
        batches = file.read(columns=wanted).combine_chunks().to_batches()
    else:
        batches = file.iter_batches(batch_size=rows, columns=wanted)
    for batch in batches:
        columns, stamps = {}, {}
        for name, reader in readers.items():
            cells = batch.column(name)
            columns[name] = reader.read(cells, start_ns)
            start_ns = start_ns or reader.start_ns
            if types.is_integer(cells.type) and not cells.null_count:
                stamps |= whole_stamps({name: cells.to_numpy(zero_copy_only=False)})
        yield Table(columns=columns, warnings=warnings, start_ns=start_ns, stamps=stamps)
        warnings = ()


def _is_list(kind: Any, types: Any) -> bool:
    return types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind)


def _is_number_column(kind: Any, types: Any) -> bool:
    if _is_list(kind, types):
        kind = kind.value_type
    tests = (types.is_floating, types.is_integer, types.is_boolean, types.is_decimal)
    return types.is_timestamp(kind) or any(test(kind) for test in tests)


class _ParquetColumn:
    """Turns the batches of one column into arrays of equal shape."""

    def __init__(self, arrow: Any) -> None:
        self._arrow = arrow
        self._width: int | None = None
        self.start_ns = 0

    def read(self, cells: Any, start_ns: int) -> FloatArray:
        """Return a batch's values, NaN where a cell is empty; shape (n,), or (n, k) for lists.

        A list column gets the width of its first list; lists of another length are NaN. Time
        stamps are in seconds since `self.start_ns`, which is `start_ns` if the file says it.
        """
        types = self._arrow.types
        if _is_list(cells.type, types):
            return self._lists(cells)
        if types.is_timestamp(cells.type):
            return self._stamps(cells, start_ns)
        return self._numbers(cells)

    def _numbers(self, cells: Any) -> FloatArray:
        # Without the check of `safe`, which refuses integers that a double rounds.
        return cells.cast(self._arrow.float64(), safe=False).to_numpy(zero_copy_only=False)

    def _lists(self, cells: Any) -> FloatArray:
        lengths = cells.value_lengths().fill_null(0).to_numpy(zero_copy_only=False)
        if self._width is None:
            self._width = int(lengths[0])
        whole = lengths == self._width
        values = np.full((len(lengths), self._width), np.nan)
        kept = cells.filter(self._arrow.array(whole)).flatten()
        values[whole] = self._numbers(kept).reshape(-1, self._width)
        return values

    def _stamps(self, cells: Any, start_ns: int) -> FloatArray:
        whole = cells.is_valid().to_numpy(zero_copy_only=False)
        kind = self._arrow.timestamp("ns", cells.type.tz)
        stamps = cells.cast(kind).cast(self._arrow.int64()).fill_null(0)
        stamps_ns = stamps.to_numpy(zero_copy_only=False)
        if self.start_ns == 0 and whole.any():
            self.start_ns = start_ns or start_of_clock(int(stamps_ns[whole][0]))
        seconds = to_seconds(stamps_ns, self.start_ns)
        seconds[~whole] = np.nan
        return seconds


class ParquetWriter:
    """Writes each chunk as a row group; two-dimensional columns become numbered ones, as in CSV."""

    def __init__(self, stream: BinaryIO, labels: Labels) -> None:
        self._arrow = optional_library("pyarrow", "Parquet files")
        self._parquet = optional_library("pyarrow.parquet", "Parquet files")
        self._stream = stream
        self._metadata = {START_KEY: str(labels.start_ns)} if labels.start_ns else {}
        self._writer: Any = None

    def append(self, columns: Columns) -> None:
        """Write rows of checked columns, the same in every call."""
        table = self._arrow.table(flat_columns(columns), metadata=self._metadata)
        if self._writer is None:
            self._writer = self._parquet.ParquetWriter(
                self._stream, table.schema, write_page_checksum=True
            )
        if table.num_rows:
            self._writer.write_table(table)

    def flush(self) -> None:
        """Nothing can be read before the end."""

    def finish(self) -> None:
        """Write the table of contents, without which the file cannot be read."""
        if self._writer is not None:
            self._writer.close()
