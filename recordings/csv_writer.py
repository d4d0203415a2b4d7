"""Writing CSV rows as they come."""

import csv
import gzip
import io
from typing import BinaryIO

import numpy as np

from recordings.checked_columns import Columns
from recordings.errors import LogError


class CsvWriter:
    """Writes a header, then rows.

    Floats are written so that they read back bit for bit. A two-dimensional column `q_rad`
    becomes `q_rad_1`, `q_rad_2`, ...; `read_log` joins them again.

    Args:
        stream: where the bytes go.
    """

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self._has_header = False

    def append(self, columns: Columns) -> None:
        """Write rows.

        Args:
            columns: checked columns, the same in every call.

        Raises:
            LogError: a name would stand twice in the header.
        """
        names, cells = _cells(columns)
        if not self._has_header:
            self._stream.write(_header(names))
            self._has_header = True
        # repr is the shortest text that reads back to the same float.
        rows = [",".join(row) for row in zip(*(map(repr, column) for column in cells), strict=True)]
        if rows:
            self._stream.write(("\n".join(rows) + "\n").encode())

    def flush(self) -> None:
        """Let readers of the file see what was written."""
        self._stream.flush()

    def finish(self) -> None:
        """Write what is still held back."""
        self._stream.flush()


class CsvGzipWriter(CsvWriter):
    """The same, compressed with gzip.

    Args:
        stream: where the bytes go.
    """

    def __init__(self, stream: BinaryIO) -> None:
        # No name and no time in the archive: the same columns give the same bytes.
        self._packed = gzip.GzipFile(
            filename="", mode="wb", fileobj=stream, mtime=0, compresslevel=3
        )
        super().__init__(self._packed)  # type: ignore[arg-type]

    def finish(self) -> None:
        """Write what is still held back, and the end of the archive."""
        self._packed.close()


def _cells(columns: Columns) -> tuple[list[str], list[list[float | int]]]:
    names: list[str] = []
    cells: list[list[float | int]] = []
    for name, given in columns.items():
        values = given.astype(int) if given.dtype.kind == "b" else given
        if values.ndim == 1:
            names.append(name)
            cells.append(values.tolist())
        else:
            names += [f"{name}_{i + 1}" for i in range(values.shape[1])]
            cells += np.ascontiguousarray(values.T).tolist()
    return names, cells


def _header(names: list[str]) -> bytes:
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise LogError(f"column name {twice!r} would stand twice in the header")
    header = io.StringIO()
    csv.writer(header, lineterminator="\n").writerow(names)
    return header.getvalue().encode()
