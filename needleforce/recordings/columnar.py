"""npz and Parquet: files that hold one column after the other.

Both are held in memory as a whole; pickled objects are never loaded.
"""

import zipfile
from collections import Counter
from math import prod
from pathlib import Path
from typing import IO, Any

import numpy as np

from needleforce.recordings.errors import (
    FormatError,
    file_errors,
    optional_library,
    require_size,
)
from needleforce.recordings.table import START_KEY, Table, start_of_clock, to_seconds

_CUT = "so that nothing can be read without its end"


def read_npz(path: Path, max_bytes: int) -> Table:
    """Read an npz archive: arrays of numbers become columns; single numbers are not.

    Arrays that hold no numbers, or are damaged, are left out, with a warning. Raises as
    `read_table` does.
    """
    with file_errors(path):
        try:
            with zipfile.ZipFile(path) as archive:
                return _npz_table(path, archive, max_bytes)
        except (zipfile.BadZipFile, NotImplementedError) as error:
            raise FormatError(
                f"{path} is not an npz archive, or it is cut short: an npz file ends with its "
                f"table of contents, {_CUT}"
            ) from error


def _npz_table(path: Path, archive: zipfile.ZipFile, max_bytes: int) -> Table:
    arrays: dict[str, np.ndarray] = {}
    warnings: list[str] = []
    total = 0
    for member in archive.namelist():
        name = member.removesuffix(".npy")
        try:
            with archive.open(member) as stream:
                total += _npy_size(stream)
            require_size(total, max_bytes, f"{path}: what its arrays hold")
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
    """Return from an array's header how many bytes it takes; `ValueError` if it is
    no column.
    """
    if np.lib.format.read_magic(stream) == (1, 0):
        shape, _, dtype = np.lib.format.read_array_header_1_0(stream)
    else:
        shape, _, dtype = np.lib.format.read_array_header_2_0(stream)
    if dtype.kind not in "fiub":
        raise ValueError(f"it holds {dtype}, no numbers")
    if len(shape) > 2 or any(n < 1 for n in shape):
        raise ValueError(f"its shape is {shape}, not (n,) or (n, k)")
    return prod(shape) * max(dtype.itemsize, 8)


def read_parquet(path: Path, max_bytes: int) -> Table:
    """Read columns of numbers, empty cells as NaN, and time stamps, as seconds, without
    loss.

    Columns of anything else are left out, with a warning. Raises as `read_table` does.
    """
    parquet = optional_library("pyarrow.parquet", "Parquet files")
    arrow = optional_library("pyarrow", "Parquet files")
    try:
        with parquet.ParquetFile(path, page_checksum_verification=True) as file:
            groups = [
                file.metadata.row_group(i) for i in range(file.metadata.num_row_groups)
            ]
            # Repeated numbers take no room in the file, but all of it in memory.
            values = (
                g.column(i).num_values for g in groups for i in range(g.num_columns)
            )
            size = max(8 * sum(values), sum(group.total_byte_size for group in groups))
            require_size(size, max_bytes, f"{path}: what it holds")
            names = Counter(file.schema_arrow.names)
            if twice := [name for name, count in names.items() if count > 1]:
                raise FormatError(
                    f"{path} has more than one column {twice[0]!r}; rename the others"
                )
            return _parquet_table(path, file, arrow)
    except (arrow.ArrowException, UnicodeDecodeError, OSError) as error:
        # Arrow's own failures come as OSError too, but have no number.
        if getattr(error, "errno", None) is not None:
            with file_errors(path):
                raise
        raise FormatError(
            f"{path} is not a Parquet file, or it is damaged or cut short: a Parquet file ends "
            f"with its table of contents, {_CUT} ({error})"
        ) from error


def _parquet_table(path: Path, file: Any, arrow: Any) -> Table:
    columns: dict[str, np.ndarray] = {}
    warnings = []
    types = arrow.types
    seconds = frozenset[str]()
    start_ns = int((file.schema_arrow.metadata or {}).get(START_KEY.encode(), 0))
    for name in file.schema_arrow.names if file.metadata.num_rows else ():
        cells = file.read(columns=[name]).column(0).combine_chunks()
        if types.is_timestamp(cells.type):
            nanoseconds = cells.cast(arrow.timestamp("ns", cells.type.tz)).cast(
                arrow.int64()
            )
            is_known = cells.is_valid().to_numpy(zero_copy_only=False)
            stamps_ns = nanoseconds.fill_null(0).to_numpy(zero_copy_only=False)
            if is_known.any():
                start_ns = start_ns or start_of_clock(int(stamps_ns[is_known][0]))
            columns[name] = np.where(is_known, to_seconds(stamps_ns, start_ns), np.nan)
            seconds |= {name}
            continue
        try:
            if types.is_string(cells.type) or types.is_large_string(cells.type):
                raise TypeError("text, which a cast would read as numbers")
            if not types.is_integer(cells.type) or cells.null_count:
                # Without the check of `safe`, which refuses integers that a double
                # rounds.
                cells = cells.cast(arrow.float64(), safe=False)
            columns[name] = cells.to_numpy(zero_copy_only=False)  # empty ones are NaN
        except (arrow.ArrowInvalid, arrow.ArrowNotImplementedError, TypeError):
            warnings.append(
                f"column {name!r} holds {cells.type}, no numbers, and was left out"
            )
    if not columns:
        left_out = "".join(f" ({warning})" for warning in warnings)
        raise FormatError(
            f"{path} holds {file.metadata.num_rows} rows without numbers{left_out}"
        )
    return Table(
        columns=columns, warnings=tuple(warnings), start_ns=start_ns, seconds=seconds
    )
