"""Tables that are written: whole or not at all, or row by row for others to follow."""

import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, nullcontext
from itertools import combinations
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from needleforce.files import whole_file
from needleforce.recordings.bag_file import METADATA, is_bag
from needleforce.recordings.errors import (
    EQUAL_COLUMNS,
    KNOWN_SUFFIX,
    OWN_PLACES,
    FileAccessError,
    LogError,
    file_errors,
)
from needleforce.recordings.log import Log
from needleforce.recordings.table import STANDARD_STREAM, TableColumns, TableLabels
from needleforce.recordings.writers import WRITERS, Append, Writer, csv_writer


def checked_columns(columns: Mapping[str, ArrayLike]) -> TableColumns:
    """Return columns as arrays; `LogError` if `write_table` cannot write them."""
    arrays: dict[str, np.ndarray] = {}
    for name, values in columns.items():
        try:
            arrays[name] = np.asarray(values)
        except ValueError as error:
            raise LogError(
                f"column {name!r} is not an array of numbers: {error}"
            ) from error

    if not arrays:
        raise LogError("no columns to write", EQUAL_COLUMNS)

    first = next(iter(arrays.values()))
    row_count = len(first) if first.ndim else 0
    for name, values in arrays.items():
        if not name.strip() or name.startswith("#"):
            raise LogError(
                f"column name {name!r} is empty or starts with '#'", EQUAL_COLUMNS
            )

        is_numeric = values.dtype.kind in "fiub"
        if not is_numeric or values.ndim not in (1, 2) or len(values) != row_count:
            raise LogError(
                f"column {name!r} has shape {values.shape} and type {values.dtype}; "
                f"expected numbers of shape ({row_count},) or ({row_count}, k)",
                EQUAL_COLUMNS,
            )

    return arrays


class OpenTable:
    """A table of `open_table`.

    Args:
        begin: Opens its file when the first rows are there.
        name: Of the file, for messages.
    """

    def __init__(self, begin: Callable[[TableColumns], Append], name: str) -> None:
        self._begin = begin
        self._name = name
        self._write: Append | None = None
        self._kinds: list[str] = []

    def append(self, columns: Mapping[str, ArrayLike]) -> None:
        """Write rows of the same columns in every call; raises as `write_table` does.

        `BrokenPipeError` if the reader of standard output has gone.
        """
        arrays = checked_columns(columns)
        kinds = [
            f"{name} {values.dtype}{list(values.shape[1:])}"
            for name, values in arrays.items()
        ]
        with file_errors(self._name, "write"):
            if self._write is None:
                empty = {name: values[:0] for name, values in arrays.items()}
                self._write = self._begin(empty)
                self._kinds = kinds

            if kinds != self._kinds:
                raise LogError(
                    f"rows with the columns {kinds} do not fit those before: "
                    f"{self._kinds}"
                )

            self._write(arrays)


@contextmanager
def open_table(
    path: str | Path,
    *,
    is_live: bool = False,
    overwrites: bool = True,
    labels: Callable[[], TableLabels] = TableLabels,
) -> Iterator[OpenTable]:
    """Open a table for writing; the file is not touched before there are rows.

    Args:
        path: A file with a suffix of `WRITERS`, or `-` for CSV on standard output.
        is_live: Whether rows are written to the file itself as they come, and stay
            there whatever happens; otherwise the file is replaced when all rows are
            written, or not at all. What cannot grow (npz) is always written at the end.
        overwrites: Whether a file that is there may be replaced.
        labels: Gives what formats that have room for it say beside the numbers; asked
            with the first rows.

    Raises:
        FileAccessError: The file cannot be written, or its suffix is not known.
    """
    if str(path) == STANDARD_STREAM:
        if sys.stdout is None:
            raise FileAccessError("cannot write standard output: it is closed")

        name = "standard output"
        writer = csv_writer
        file = nullcontext(sys.stdout.buffer)
    else:
        name = str(path)
        writer = _find_writer(Path(path))
        if not overwrites:
            _require_new(Path(path))

        is_growing = is_live and name.lower().endswith((".csv", ".mcap"))
        file = whole_file(path, is_in_place=is_growing, overwrites=overwrites)

    with ExitStack() as files:

        def begin(empty: TableColumns) -> Append:
            stream = files.enter_context(file)
            return files.enter_context(writer(stream, labels(), empty))

        yield OpenTable(begin, name)
        with file_errors(name, "write"):
            files.close()


def _find_writer(path: Path) -> Writer:
    """Return the writer of a file's suffix; `FileAccessError` if there is none."""
    for suffix, writer in WRITERS.items():
        if path.name.lower().endswith(suffix):
            return writer

    if path.name.lower().endswith(".db3"):
        raise FileAccessError(
            f"cannot write {path}: bags are written as .mcap only", KNOWN_SUFFIX
        )

    raise FileAccessError(
        f"{path} has no known suffix; known are: {', '.join(WRITERS)}",
        KNOWN_SUFFIX,
    )


def write_table(
    path: str | Path,
    columns: Mapping[str, ArrayLike],
    *,
    labels: TableLabels | None = None,
) -> None:
    """Write named columns; readers see the old file or the whole new one, never a part.

    Floats are written so that they read back bit for bit. In CSV, a two-dimensional
    column `q_rad` becomes `q_rad_1`, `q_rad_2`, ...; `read_log` joins them again.

    Args:
        path: a file ending in `.csv`, `.npz`, `.parquet` or `.mcap`; replaced if it
            exists.
        columns: name, with its unit, to numbers, shape (n,) or (n, k), all of the same
            n.
        labels: what the formats that have room for it say beside the numbers.

    Raises:
        FileAccessError: the file cannot be written, or its suffix is not known.
        LogError: the columns are not numbers, differ in length, or a name is empty,
            starts with `#` or stands twice.
    """
    with open_table(path, labels=lambda: labels or TableLabels()) as table:
        table.append(columns)


def write_log(path: str | Path, log: Log) -> None:
    """Write a log's time and channels, in SI units; raises as `write_table`."""
    columns = {"t_s": log.t_s, **log.channels}
    write_table(path, columns, labels=TableLabels(start_ns=log.start_ns))


def check_writable(path: str | Path, *, overwrites: bool = True) -> None:
    """Check before the work that a table can be written to a place.

    Args:
        path: As of `open_table`.
        overwrites: Whether a file that is there may be replaced.

    Raises:
        FileAccessError: The suffix is not known, no file can stand there, or one is
            there that shall stay.
    """
    if str(path) != STANDARD_STREAM:
        _find_writer(Path(path))
        require_place(Path(path))
        if not overwrites:
            _require_new(Path(path))


def require_place(path: Path) -> None:
    """Check that a file can stand at a path; `FileAccessError` if not."""
    with file_errors(path, "write"):
        if not path.parent.is_dir():
            raise FileAccessError(
                f"cannot write {path}: there is no folder {path.parent}",
                OWN_PLACES,
            )

        if path.is_dir():
            raise FileAccessError(f"cannot write {path}: it is a folder", OWN_PLACES)


def _require_new(path: Path) -> None:
    """Check that no file is at a path; a pipe or a device may be.

    Raises:
        FileAccessError: There is one, which would be lost.
    """
    with file_errors(path, "write"):
        if path.is_file():
            raise FileAccessError(
                f"{path} exists", "Give another name, or set `overwrites`."
            )


def check_outputs(outputs: Mapping[str, Path], source: Path | None = None) -> None:
    """Check that no output would replace another one, or harm the recording read.

    Args:
        outputs: Paths by the options that name them.
        source: The recording, a file or a folder, which need not exist.

    Raises:
        FileAccessError: One would.
    """
    for (option, path), (other_option, other_path) in combinations(outputs.items(), 2):
        with file_errors(path, "write"):
            if _overlap(path, other_path):
                raise FileAccessError(
                    f"{option} and {other_option} both write to {path}",
                    OWN_PLACES,
                )

    if source is not None and source.exists():
        for path in outputs.values():
            with file_errors(path, "write"):
                _require_apart(path, source)


def _require_apart(path: Path, source: Path) -> None:
    """Raise `FileAccessError` if writing to a path would harm a recording."""
    if path.exists() and path.samefile(source):
        raise FileAccessError(f"cannot write {path}: it is the log itself", OWN_PLACES)

    folder = source.resolve().parent
    is_in_bag = source.is_file() and is_bag(source) and (folder / METADATA).exists()
    if _overlap(path, folder if is_in_bag else source):
        raise FileAccessError(
            f"cannot write {path}: it and the log {source} lie one inside the other",
            OWN_PLACES,
        )


def _overlap(path: Path, other: Path) -> bool:
    """Return whether two paths are the same place, or one lies inside the other."""
    if path.exists() and other.exists() and path.samefile(other):
        return True

    path = path.resolve()
    other = other.resolve()
    return path == other or path in other.parents or other in path.parents
