"""npz, Parquet and Feather: files that hold one column after the other."""

from pathlib import Path
from typing import Any

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


def read_npz(path: Path, max_bytes: int) -> Table:
    """Read an npz archive: arrays of numbers become columns; single numbers do not.

    Raises:
        FormatError: It is no such archive, or holds no array of numbers.
    """
    with file_errors(path):
        try:
            archive = np.load(path, allow_pickle=False)
            table = _table_of(archive)
        except OSError:
            raise
        except Exception as error:  # whatever numpy and zipfile run into
            raise FormatError(
                f"{path} is not an npz archive of numbers, or damaged ({error})",
                RECOVER,
            ) from error

    size = sum(values.nbytes for values in table.columns.values())
    require_size(size, max_bytes, f"{path}: its arrays")
    if not table.columns:
        notes = "; ".join(["", *table.warnings])
        raise FormatError(f"{path} holds no array of numbers{notes}")

    return table


def _table_of(archive: Any) -> Table:
    """Return the arrays of numbers in an npz archive, and notes on the others."""
    columns: dict[str, np.ndarray] = {}
    notes: list[str] = []
    start_ns = 0
    for name in archive.files:
        try:
            values = archive[name]
        except ValueError as error:  # objects, or a damaged header
            notes.append(f"column {name!r} cannot be read ({error}), left out")
            continue

        if name == START_KEY and not values.ndim:
            start_ns = int(values)
        elif values.ndim in (1, 2) and values.size and values.dtype.kind in "fiub":
            columns[name] = values
        elif values.ndim:
            notes.append(f"column {name!r}: {values.dtype} {values.shape}, left out")

    return Table(columns=columns, warnings=tuple(notes), start_ns=start_ns)


def read_arrow(path: Path, max_bytes: int) -> Table:
    """Read the columns of numbers, lists and time stamps of a Parquet or Feather file.

    Raises:
        FormatError: It is no such file, or holds no numbers.
    """
    is_parquet = path.suffix.lower() == ".parquet"
    arrow = optional_library("pyarrow", "Parquet and Feather files")
    module = "pyarrow.parquet" if is_parquet else "pyarrow.feather"
    with file_errors(path):
        try:
            reader = optional_library(module, "Parquet and Feather files")
            content = reader.read_table(path, use_threads=False)
        except arrow.ArrowException as error:
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
            if name in seconds:
                known = values[values > np.iinfo(np.int64).min]
                start_ns = start_ns or start_of_clock(first_valid_stamp(known))
                values = np.where(
                    values == np.iinfo(np.int64).min,
                    np.nan,
                    to_seconds(values, start_ns),
                )

            columns[name] = values
        except (arrow.ArrowException, TypeError, ValueError):
            notes.append(
                f"column {name!r} holds {cells.type}, no numbers, and was left out"
            )

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
        rows = [np.atleast_1d(row) for row in cells.to_pylist() if row]
        width = int(np.bincount([len(row) for row in rows]).argmax())
        if width > MAX_LIST_NUMBERS:
            raise TypeError("no signal")

        values = np.full((len(cells), width), np.nan)
        for index, row in enumerate(cells.to_pylist()):
            if row and len(row) == width:
                values[index] = row

        return values

    is_text = arrow.types.is_string(cells.type) or arrow.types.is_large_string(
        cells.type
    )
    if cells.null_count and not is_text:
        cells = cells.cast(arrow.float64(), safe=False)

    values = cells.to_numpy()
    if values.dtype.kind not in "fiub":
        raise TypeError("no numbers")

    return values
