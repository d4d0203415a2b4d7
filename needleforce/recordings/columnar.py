"""npz, Parquet and Feather: files that hold one column after the other."""

import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from needleforce.recordings.errors import (
    RECOVER,
    FormatError,
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


def read_npz(path: Path, max_bytes: int) -> Table:
    """Read an npz archive: arrays of numbers become columns; single numbers do not.

    Raises:
        FormatError: It is no such archive, or holds no array of numbers.
    """
    notes: list[str] = []
    try:
        with zipfile.ZipFile(path) as members:
            size = sum(member.file_size for member in members.infolist())

        require_size(size, max_bytes, f"{path}: its arrays")
        with np.load(path, allow_pickle=False) as archive:
            arrays = _load_arrays(archive, notes)
    except (OSError, FormatError):
        raise
    except Exception as error:  # whatever numpy and zipfile run into
        raise FormatError(
            f"{path} is not an npz archive of numbers, or damaged ({error})", RECOVER
        ) from error

    start = arrays.get(START_KEY, np.zeros(1))
    columns: dict[str, np.ndarray] = {}
    for name, values in arrays.items():
        if values.ndim in (1, 2) and values.size and values.dtype.kind in "fiub":
            columns[name] = values
        elif values.ndim:
            notes.append(f"column {name!r} was left out: {values.dtype} {values.shape}")

    if not columns:
        raise FormatError(f"{path} holds no array of numbers {'; '.join(notes)}")

    start_ns = int(start) if start.ndim == 0 else 0
    return Table(columns=columns, warnings=tuple(notes), start_ns=start_ns)


def _load_arrays(archive: Any, notes: list[str]) -> dict[str, np.ndarray]:
    """Return the arrays of an archive but objects, which are added to the notes."""
    arrays: dict[str, np.ndarray] = {}
    for name in archive.files:
        try:
            arrays[name] = archive[name]
        except ValueError as error:
            notes.append(f"column {name!r} was left out: {error}")

    return arrays


def read_arrow(path: Path, max_bytes: int) -> Table:
    """Read the columns of numbers, lists and time stamps of a Parquet or Feather file.

    Raises:
        FormatError: It is no such file, or holds no numbers.
    """
    kind = "parquet" if path.suffix.lower() == ".parquet" else "feather"
    arrow = optional_library("pyarrow", "Parquet and Feather files")
    reader = optional_library(f"pyarrow.{kind}", "Parquet and Feather files")
    try:
        if kind == "parquet":
            content = reader.ParquetFile(path).metadata
            groups = map(content.row_group, range(content.num_row_groups))
            size = sum(group.total_byte_size for group in groups)
            require_size(size, max_bytes, f"{path}: what it holds")

        content = reader.read_table(path, use_threads=False)
    except (arrow.ArrowException, UnicodeDecodeError) as error:
        raise FormatError(
            f"{path} is damaged, cut short or of another kind ({error})", RECOVER
        ) from error

    require_size(content.nbytes, max_bytes, f"{path}: what it holds")
    columns: dict[str, np.ndarray] = {}
    notes: list[str] = []
    start_ns = int((content.schema.metadata or {}).get(START_KEY.encode(), 0))
    seconds = {f.name for f in content.schema if arrow.types.is_timestamp(f.type)}
    for name, cells in zip(content.column_names, content.columns, strict=True):
        try:
            values = _values_of(cells, arrow)
        except (arrow.ArrowException, TypeError, ValueError):
            notes.append(
                f"column {name!r} holds {cells.type}, no numbers, and was left out"
            )
            continue

        if name in seconds:
            is_missing = values == np.iinfo(np.int64).min
            start_ns = start_ns or start_of_clock(
                first_valid_stamp(values[~is_missing])
            )
            values = np.where(is_missing, np.nan, to_seconds(values, start_ns))

        columns[name] = values

    if not columns or not content.num_rows:
        raise FormatError(f"{path} holds no rows of numbers ({'; '.join(notes)})")

    return Table(
        columns=columns,
        warnings=tuple(notes),
        start_ns=start_ns,
        seconds=frozenset(seconds),
    )


def _values_of(cells: Any, arrow: Any) -> np.ndarray:
    """Return numbers, rows of lists, or stamps in ns; raises if they are none."""
    if arrow.types.is_timestamp(cells.type):
        return cells.to_numpy().astype("datetime64[ns]").astype(np.int64)
    if arrow.types.is_nested(cells.type):
        rows = cells.to_pylist()
        width = max(len(row) for row in rows if row)
        if width > MAX_LIST_NUMBERS:
            raise TypeError("no signal")

        empty = [None] * width
        return np.array([row if row else empty for row in rows], dtype=np.float64)
    if cells.null_count:
        cells = cells.cast(arrow.float64(), safe=False)

    values = cells.to_numpy()
    if values.dtype.kind not in "fiub":
        raise TypeError("no numbers")

    return values
