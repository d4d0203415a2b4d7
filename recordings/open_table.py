"""A table that is written chunk by chunk."""

import os
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO, Protocol

from numpy.typing import ArrayLike

from recordings.bags.folder import FOLDER_SUFFIX, bag_folder, is_folder_name
from recordings.bags.writer import McapWriter
from recordings.columnar.npz_writer import NpzWriter
from recordings.columnar.parquet_writer import ParquetWriter
from recordings.errors import FileAccessError
from recordings.tables.checked_columns import Columns, checked_columns, require_same_columns
from recordings.tables.labels import PLAIN, Labels
from recordings.text.writer import CsvGzipWriter, CsvWriter

STANDARD_STREAM = "-"
"""Instead of a file: standard input or standard output."""


class TableWriter(Protocol):
    """Writes one format to a stream of bytes; gets the same columns in every `append`."""

    def append(self, columns: Columns) -> None:
        """Write rows, or keep them until `finish`."""
        ...

    def flush(self) -> None:
        """Let readers of the file see what was written, if the format allows it."""
        ...

    def finish(self) -> None:
        """Write what is still held back; the stream stays open."""
        ...


# A new format is a writer in a file of its own and a line here.
WRITERS: Mapping[str, Callable[[BinaryIO, Labels], TableWriter]] = {
    ".csv": CsvWriter,
    ".csv.gz": CsvGzipWriter,
    ".npz": NpzWriter,
    ".parquet": ParquetWriter,
    ".mcap": McapWriter,
}

LabelSource = Callable[[], Labels]

_GROWS = (".csv", ".csv.gz")


class OpenTable:
    """A table under construction; made by `open_table`.

    Args:
        begin: opens the file and returns what writes its format; called with the first rows.
        is_live: whether readers are to see every chunk at once.
        name: of the file, for messages.
    """

    def __init__(self, begin: Callable[[], TableWriter], *, is_live: bool, name: str) -> None:
        self._begin, self._is_live, self._name = begin, is_live, name
        self._writer: TableWriter | None = None
        self._columns: Columns = {}

    def append(self, columns: Mapping[str, ArrayLike]) -> None:
        """Write rows.

        Args:
            columns: see `write_table`; the same in every call.

        Raises:
            FileAccessError: the file cannot be written.
            LogError: the columns are no table, or not those of the rows before.
            BrokenPipeError: the reader of standard output has gone.
        """
        arrays = checked_columns(columns)
        with _told(self._name):
            if self._writer is None:
                self._columns = {name: values[:0] for name, values in arrays.items()}
                self._writer = self._begin()
            require_same_columns(self._columns, arrays)
            self._writer.append(arrays)
            if self._is_live:
                self._writer.flush()

    def finish(self) -> bool:
        """Write what is still held back.

        Returns:
            Whether there was anything to write.

        Raises:
            FileAccessError: the file cannot be written.
            BrokenPipeError: the reader of standard output has gone.
        """
        if self._writer is None:
            return False
        with _told(self._name):
            self._writer.finish()
        return True


@contextmanager
def open_table(
    path: str | Path, *, is_live: bool = False, labels: LabelSource = lambda: PLAIN
) -> Iterator[OpenTable]:
    """Open a table for writing; the file is not touched before there are rows.

    Args:
        path: a file with a suffix of `WRITERS`, a folder ending in `.db3` for a ROS 2 bag in an
            SQLite file, or `-` for CSV on standard output.
        is_live: Write rows to the file itself as they come, and leave them there whatever
            happens. Otherwise the file is replaced when all rows are written, or not at all. What
            cannot grow (npz) is always written at the end.
        labels: gives what the formats that have room for it say beside the numbers; asked when
            the first rows are there.

    Yields:
        The table, to be given rows.

    Raises:
        FileAccessError: the file cannot be written, or its suffix is not known.
        BrokenPipeError: the reader of standard output has gone.
    """
    if str(path) == STANDARD_STREAM:
        if sys.stdout is None:
            raise FileAccessError("cannot write standard output: it is closed")
        output = OpenTable(
            lambda: CsvWriter(sys.stdout.buffer, labels()), is_live=True, name="standard output"
        )
        yield output
        output.finish()
        return
    path = Path(path)
    if is_folder_name(path):
        with bag_folder(path, labels) as begin:
            folder = OpenTable(begin, is_live=False, name=str(path))
            yield folder
            folder.finish()
        return
    with _open_file(path, labels, grows=is_live and path.name.lower().endswith(_GROWS)) as table:
        yield table


@contextmanager
def _open_file(path: Path, labels: LabelSource, *, grows: bool) -> Iterator[OpenTable]:
    writer = find_writer(path)
    part = path if grows else path.with_name(f".{path.name}.{os.getpid()}.part")
    streams: list[BinaryIO] = []

    def begin() -> TableWriter:
        streams.append(part.open("wb"))
        return writer(streams[0], labels())

    try:
        table = OpenTable(begin, is_live=grows, name=str(path))
        yield table
        if table.finish():
            with _told(str(path)):
                streams[0].close()
                if not grows:
                    os.replace(part, path)
    finally:
        for stream in streams:
            # On a full disk closing fails too, but that has been told.
            with suppress(OSError):
                stream.close()
        if streams and not grows:
            part.unlink(missing_ok=True)


def find_writer(path: Path) -> Callable[[BinaryIO, Labels], TableWriter]:
    """Return what writes a file of this name.

    Raises:
        FileAccessError: the suffix is not known.
    """
    for suffix, writer in WRITERS.items():
        if path.name.lower().endswith(suffix):
            return writer
    known = (*WRITERS, FOLDER_SUFFIX)
    raise FileAccessError(f"{path} has no known suffix; known are: {', '.join(known)}")


@contextmanager
def _told(name: str) -> Iterator[None]:
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        raise FileAccessError(f"cannot write {name}: {error.strerror or error}") from error
