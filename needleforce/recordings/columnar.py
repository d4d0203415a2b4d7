"""npz, Parquet and Feather: files that hold one column after the other."""

import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from needleforce.recordings.data_frame import table_of_frame
from needleforce.recordings.errors import (
    RECOVER,
    FormatError,
    optional_library,
    require_size,
)
from needleforce.recordings.table import START_KEY, Table

ARROW_SUFFIXES = (".parquet", ".feather")
"""Of files that pyarrow reads."""


def read_npz(path: Path, max_bytes: int) -> Table:
    """Read an npz archive: arrays of numbers become columns; single numbers do not.

    Raises:
        FormatError: It is no such archive, or damaged.
    """
    columns: dict[str, np.ndarray] = {}
    notes: list[str] = []
    start_ns = 0
    try:
        with zipfile.ZipFile(path) as members:
            size = sum(member.file_size for member in members.infolist())

        require_size(size, max_bytes, f"{path}: its arrays")
        with np.load(path, allow_pickle=False) as archive:
            for name in archive.files:
                try:
                    values = archive[name]
                except ValueError as error:  # objects
                    notes.append(f"column {name!r} was left out: {error}")
                    continue

                if name == START_KEY and values.ndim == 0:
                    start_ns = int(values)
                elif (
                    values.ndim in (1, 2)
                    and values.size
                    and values.dtype.kind in "fiub"
                ):
                    columns[name] = values
                elif values.ndim:
                    kind = f"{values.dtype} {values.shape}"
                    notes.append(f"column {name!r} was left out: {kind}")
    except (OSError, FormatError):
        raise
    except Exception as error:  # whatever numpy and zipfile run into
        raise FormatError(
            f"{path} is not an npz archive of numbers, or damaged ({error})", RECOVER
        ) from error

    return Table(columns=columns, warnings=tuple(notes), start_ns=start_ns)


def read_arrow(path: Path, max_bytes: int) -> Table:
    """Read the columns of numbers, lists and time stamps of a Parquet or Feather file.

    Raises:
        FormatError: It is no such file, or damaged.
    """
    kind = path.suffix.lower().removeprefix(".")
    arrow = optional_library("pyarrow", "Parquet and Feather files")
    reader = optional_library(f"pyarrow.{kind}", "Parquet and Feather files")
    try:
        if kind == "parquet":  # whose size is known before it is unpacked
            content = reader.ParquetFile(path).metadata
            groups = map(content.row_group, range(content.num_row_groups))
            size = sum(group.total_byte_size for group in groups)
            require_size(size, max_bytes, f"{path}: what it holds")

        content = reader.read_table(path, use_threads=False)
        require_size(content.nbytes, max_bytes, f"{path}: what it holds")
        table = table_of_frame(content.to_pandas(ignore_metadata=True))
    except (arrow.ArrowException, UnicodeDecodeError) as error:
        raise FormatError(
            f"{path} is damaged, cut short or of another kind ({error})", RECOVER
        ) from error

    own_start = (content.schema.metadata or {}).get(START_KEY.encode())
    return table if own_start is None else replace(table, start_ns=int(own_start))
