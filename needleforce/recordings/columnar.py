"""npz, Parquet and Feather: files that hold one column after the other.

They are held in memory as a whole; pickled objects are never loaded.
"""

import zipfile
from collections import Counter
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
                arrays[name] = np.lib.format.read_array(stream, allow_pickle=False)
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


def read_arrow(path: Path, max_bytes: int) -> Table:
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
    try:
        if not is_parquet:
            require_size(path.stat().st_size, max_bytes, f"{path}: what it holds")
            content = library.read_table(path, use_threads=False)
            require_size(content.nbytes, max_bytes, f"{path}: what it holds")
            return _arrow_table(path, content, content.schema.metadata, arrow)

        with library.ParquetFile(path, page_checksum_verification=True) as file:
            size = _parquet_size(file.metadata)
            require_size(size, max_bytes, f"{path}: what it holds")
            content = file.read(use_threads=False)
            return _arrow_table(path, content, file.schema_arrow.metadata, arrow)
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


def _parquet_size(metadata: Any) -> int:
    """Return how many bytes the content of a Parquet file takes.

    Repeated numbers take no room in the file, but all of it in memory.
    """
    groups = [metadata.row_group(i) for i in range(metadata.num_row_groups)]
    number_count = sum(
        group.column(i).num_values for group in groups for i in range(group.num_columns)
    )
    packed_size = sum(group.total_byte_size for group in groups)
    return max(BYTES_PER_NUMBER * number_count, packed_size)


def _arrow_table(
    path: Path, content: Any, metadata: dict[bytes, bytes] | None, arrow: Any
) -> Table:
    """Return the columns of a table of pyarrow, those that hold numbers."""
    for name, count in Counter(content.column_names).items():
        if count > 1:
            raise FormatError(
                f"{path} has more than one column {name!r}; rename the others"
            )

    columns: dict[str, np.ndarray] = {}
    warnings: list[str] = []
    seconds: set[str] = set()
    start_ns = int((metadata or {}).get(START_KEY.encode(), 0))
    for name in content.column_names if content.num_rows else ():
        cells = content.column(name).combine_chunks()
        try:
            if arrow.types.is_timestamp(cells.type):
                zone = cells.type.tz
                stamps = cells.cast(arrow.timestamp("ns", zone)).cast(arrow.int64())
                is_known = cells.is_valid().to_numpy(zero_copy_only=False)
                stamps_ns = stamps.fill_null(0).to_numpy(zero_copy_only=False)
                if is_known.any():
                    first_ns = first_valid_stamp(stamps_ns[is_known])
                    start_ns = start_ns or start_of_clock(first_ns)

                seconds_s = to_seconds(stamps_ns, start_ns)
                columns[name] = np.where(is_known, seconds_s, np.nan)
                seconds.add(name)
            else:
                columns[name] = _read_numbers(cells, arrow)
        except (arrow.ArrowInvalid, arrow.ArrowNotImplementedError, TypeError):
            warnings.append(
                f"column {name!r} holds {cells.type}, no numbers, and was left out"
            )

    if not columns:
        left_out = "".join(f" ({warning})" for warning in warnings)
        raise FormatError(
            f"{path} holds {content.num_rows} rows without numbers{left_out}"
        )

    return Table(
        columns=columns,
        warnings=tuple(warnings),
        start_ns=start_ns,
        seconds=frozenset(seconds),
    )


def _read_numbers(cells: Any, arrow: Any) -> np.ndarray:
    """Return a column of numbers, empty cells as NaN, or of lists of these.

    Raises:
        TypeError, ArrowInvalid, ArrowNotImplementedError: It holds none.
    """
    types = arrow.types
    is_list = (types.is_list, types.is_large_list, types.is_fixed_size_list)
    if any(is_kind(cells.type) for is_kind in is_list):
        return _read_lists(cells, arrow)
    if types.is_string(cells.type) or types.is_large_string(cells.type):
        raise TypeError("text, which a cast would read as numbers")
    if not types.is_integer(cells.type) or cells.null_count:
        # Without the check of `safe`, which refuses integers that a double rounds.
        cells = cells.cast(arrow.float64(), safe=False)

    return cells.to_numpy(zero_copy_only=False)


def _read_lists(cells: Any, arrow: Any) -> np.ndarray:
    """Return a column of lists, shape (n, k); those of another length are NaN.

    Raises:
        TypeError, ArrowInvalid, ArrowNotImplementedError: They hold no numbers.
    """
    compute = optional_library("pyarrow.compute", "Parquet files")
    lengths = compute.list_value_length(cells).fill_null(-1).to_numpy()
    width = int(np.bincount(lengths[lengths > 0], minlength=2).argmax())
    if width > MAX_LIST_NUMBERS:
        raise TypeError(f"lists of {width} numbers, which are no signal")

    is_usual = lengths == width
    numbers = compute.list_flatten(cells.filter(arrow.array(is_usual)))
    rows = np.full((len(lengths), width), np.nan)
    rows[is_usual] = _read_numbers(numbers, arrow).reshape(-1, width)
    return rows
