"""Tables that are written: whole or not at all, or row by row for others to follow."""

import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from itertools import combinations
from pathlib import Path
from typing import BinaryIO

from numpy.typing import ArrayLike

from needleforce.files import whole_file
from needleforce.recordings.bag_messages import METADATA, is_bag
from needleforce.recordings.bag_types import mcap_writer
from needleforce.recordings.columnar import npz_writer, parquet_writer
from needleforce.recordings.csv_file import csv_writer
from needleforce.recordings.errors import FileAccessError, LogError, file_errors
from needleforce.recordings.follow import STANDARD_STREAM
from needleforce.recordings.log import Log
from needleforce.recordings.table import Append, Columns, Labels, checked_columns

Writer = Callable[[BinaryIO, Labels, Columns], AbstractContextManager[Append]]
"""Begins a table of checked columns, gives what writes its rows, and finishes it at the end."""

WRITERS: Mapping[str, Writer] = {
    ".csv": csv_writer,
    ".npz": npz_writer,
    ".parquet": parquet_writer,
    ".mcap": mcap_writer,
}
"""By the suffix of a file."""


class OpenTable:
    """A table of `open_table`; `begin` opens its file when the first rows are there."""

    def __init__(self, begin: Callable[[Columns], Append], name: str) -> None:
        self._begin, self._name = begin, name
        self._write: Append | None = None
        self._kinds: list[str] = []

    def append(self, columns: Mapping[str, ArrayLike]) -> None:
        """Write rows of the same columns in every call; raises as `write_table` does.

        `BrokenPipeError` if the reader of standard output has gone.
        """
        arrays = checked_columns(columns)
        kinds = [f"{name} {v.dtype}{list(v.shape[1:])}" for name, v in arrays.items()]
        with file_errors(self._name, "write"):
            if self._write is None:
                self._write, self._kinds = self._begin(arrays), kinds
            if kinds != self._kinds:
                raise LogError(
                    f"rows with the columns {kinds} do not fit those before: {self._kinds}"
                )
            self._write(arrays)


@contextmanager
def open_table(
    path: str | Path, *, is_live: bool = False, labels: Callable[[], Labels] = Labels
) -> Iterator[OpenTable]:
    """Open a table for writing; the file is not touched before there are rows.

    Its name has a suffix of `WRITERS`, or is `-` for CSV on standard output. Live rows are written
    to the file itself as they come, and stay there whatever happens; otherwise the file is replaced
    when all rows are written, or not at all. What cannot grow (npz) is always written at the end.
    `labels` are what formats that have room for it say beside the numbers, asked for with the first
    rows. `FileAccessError` if the file cannot be written, or its suffix is not known.
    """
    if str(path) == STANDARD_STREAM:
        if sys.stdout is None:
            raise FileAccessError("cannot write standard output: it is closed")
        name, writer, file = "standard output", csv_writer, nullcontext(sys.stdout.buffer)
    else:
        name, writer = str(path), _find_writer(Path(path))
        file = whole_file(path, is_in_place=is_live and name.lower().endswith((".csv", ".mcap")))
    with ExitStack() as files:

        def begin(first: Columns) -> Append:
            return files.enter_context(writer(files.enter_context(file), labels(), first))

        yield OpenTable(begin, name)
        with file_errors(name, "write"):
            files.close()


def _find_writer(path: Path) -> Writer:
    for suffix, writer in WRITERS.items():
        if path.name.lower().endswith(suffix):
            return writer
    if path.name.lower().endswith(".db3"):
        raise FileAccessError(f"cannot write {path}: bags are written as MCAP; name it .mcap")
    raise FileAccessError(f"{path} has no known suffix; known are: {', '.join(WRITERS)}")


def write_table(
    path: str | Path, columns: Mapping[str, ArrayLike], *, labels: Labels | None = None
) -> None:
    """Write named columns; readers see the old file or the whole new one, never a part.

    Floats are written so that they read back bit for bit. In CSV, a two-dimensional column
    `q_rad` becomes `q_rad_1`, `q_rad_2`, ...; `read_log` joins them again.

    Args:
        path: a file ending in `.csv`, `.npz`, `.parquet` or `.mcap`; replaced if it exists.
        columns: name, with its unit, to numbers, shape (n,) or (n, k), all of the same n.
        labels: what the formats that have room for it say beside the numbers.

    Raises:
        FileAccessError: the file cannot be written, or its suffix is not known.
        LogError: the columns are not numbers, differ in length, or a name is empty, starts with
            `#` or stands twice.
    """
    with open_table(path, labels=lambda: labels or Labels()) as table:
        table.append(columns)


def write_log(path: str | Path, log: Log) -> None:
    """Write a log's time and channels, in SI units; raises as `write_table`."""
    write_table(path, {"t_s": log.t_s, **log.channels}, labels=Labels(start_ns=log.start_ns))


def check_writable(path: str | Path) -> None:
    """Find out before the work that the suffix is not known, or that no file can stand there."""
    if str(path) != STANDARD_STREAM:
        _find_writer(Path(path))
        require_place(Path(path))


def require_place(path: Path) -> None:
    """Check that a file can stand there; `FileAccessError` if not."""
    with file_errors(path, "write"):
        if not path.parent.is_dir():
            raise FileAccessError(f"cannot write {path}: there is no folder {path.parent}")
        if path.is_dir():
            raise FileAccessError(f"cannot write {path}: it is a folder")


def check_outputs(outputs: Mapping[str, Path], source: Path | None = None) -> None:
    """Check that no output, an option and the path that it names, would replace another one.

    Nor may it harm the recording that is read, a file or a folder, which need not exist.
    """
    for (option, path), (other, place) in combinations(outputs.items(), 2):
        if _overlap(path, place):
            raise FileAccessError(
                f"{option} and {other} both write to {path}; give each a place of its own"
            )
    if source is None or not source.exists():
        return
    whole = source.resolve().parent
    is_part = source.is_file() and is_bag(source) and (whole / METADATA).exists()
    for path in outputs.values():
        if path.exists() and path.samefile(source):
            raise FileAccessError(f"cannot write {path}: it is the log itself; give another name")
        if _overlap(path, whole if is_part else source):
            raise FileAccessError(
                f"cannot write {path}: it and the log {source} lie one inside the other; "
                "give a place outside"
            )


def _overlap(path: Path, other: Path) -> bool:
    """Return whether two paths are the same place, or one lies inside the other."""
    if path.exists() and other.exists() and path.samefile(other):
        return True
    path, other = path.resolve(), other.resolve()
    return path == other or path in other.parents or other in path.parents
