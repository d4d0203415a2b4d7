"""Writing CSV rows as they come."""

import csv
import gzip
import io
from typing import BinaryIO

from recordings.tables.checked_columns import Columns
from recordings.tables.flat_columns import flat_columns
from recordings.tables.labels import PLAIN, START_KEY, Labels


class CsvWriter:
    """Writes a header, then rows.

    Floats are written so that they read back bit for bit. A two-dimensional column `q_rad`
    becomes `q_rad_1`, `q_rad_2`, ...; `read_log` joins them again.

    Args:
        stream: where the bytes go.
        labels: the start of the clock, unless it is zero, goes into a comment.
    """

    def __init__(self, stream: BinaryIO, labels: Labels = PLAIN) -> None:
        self._comment = f"# {START_KEY} = {labels.start_ns}\n" if labels.start_ns else ""
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
            self._stream.write(self._comment.encode() + _header(names))
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
        labels: see `CsvWriter`.
    """

    def __init__(self, stream: BinaryIO, labels: Labels = PLAIN) -> None:
        # No name and no time in the archive: the same columns give the same bytes.
        self._packed = gzip.GzipFile(
            filename="", mode="wb", fileobj=stream, mtime=0, compresslevel=3
        )
        super().__init__(self._packed, labels)  # type: ignore[arg-type]

    def finish(self) -> None:
        """Write what is still held back, and the end of the archive."""
        self._packed.close()


def _cells(columns: Columns) -> tuple[list[str], list[list[float | int]]]:
    flat = flat_columns(columns)
    cells = [v.astype(int).tolist() if v.dtype.kind == "b" else v.tolist() for v in flat.values()]
    return list(flat), cells


def _header(names: list[str]) -> bytes:
    header = io.StringIO()
    csv.writer(header, lineterminator="\n").writerow(names)
    return header.getvalue().encode()
