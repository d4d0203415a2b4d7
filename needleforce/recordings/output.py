"""Tables that are written: whole or not at all, or row by row for others to follow."""

import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from itertools import combinations, product
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from needleforce.files import whole_file
from needleforce.recordings.bag_file import METADATA, is_bag
from needleforce.recordings.errors import (
    KNOWN_SUFFIX,
    FileAccessError,
    LogError,
    file_errors,
)
from needleforce.recordings.log import Log
from needleforce.recordings.table import STANDARD_STREAM, TableColumns, TableLabels
from needleforce.recordings.writers import WRITERS, Append, Writer, csv_writer

OWN_PLACES = "Give each output a place of its own, in a folder that exists."


def checked_columns(columns: Mapping[str, ArrayLike]) -> TableColumns:
    """Return columns as arrays; `LogError` if `write_table` cannot write them."""
    arrays: dict[str, np.ndarray] = {}
    with suppress(ValueError):  # of lists of different lengths
        arrays = {name: np.asarray(values) for name, values in columns.items()}

    are_named = [name.strip() and not name.startswith("#") for name in arrays]
    are_numbers = [a.dtype.kind in "fiub" and a.ndim in (1, 2) for a in arrays.values()]
    row_counts = {values.shape[:1] for values in arrays.values()}
    if len(row_counts) != 1 or not all([*are_named, *are_numbers]):
        shapes = {name: f"{a.dtype}{list(a.shape)}" for name, a in arrays.items()}
        raise LogError(
            f"expected columns with names and numbers of shape (n,) or (n, k), all of "
            f"the same n, not {shapes or columns}",
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
        empty = {name: values[:0] for name, values in arrays.items()}
        kinds = [f"{name} {a.dtype}{list(a.shape)}" for name, a in empty.items()]
        with file_errors(self._name, "write"):
            if self._write is None:
                self._write = self._begin(empty)
                self._kinds = kinds

            if kinds != self._kinds:
                raise LogError(f"rows of other columns, {kinds}, after {self._kinds}")

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
        require_place(Path(path), overwrites=overwrites)
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

    raise FileAccessError(
        f"cannot write {path}: its suffix is none of {', '.join(WRITERS)}", KNOWN_SUFFIX
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
    write_table(
        path,
        {"t_s": log.t_s, **log.channels},
        labels=TableLabels(start_ns=log.start_ns),
    )


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
        require_place(Path(path), overwrites=overwrites)


def require_place(path: Path, *, overwrites: bool = True) -> None:
    """Check that a file can stand at a path; a pipe or a device may be there.

    Args:
        path: The place.
        overwrites: Whether a file that is there may be replaced.

    Raises:
        FileAccessError: There is no folder, it is one, or a file would be lost.
    """
    with file_errors(path, "write"):
        if not overwrites and path.is_file():
            raise FileAccessError(
                f"{path} exists", "Give another name, or overwrite it (`--overwrite`)."
            )
        if not path.parent.is_dir():
            raise FileAccessError(
                f"cannot write {path}: there is no folder {path.parent}", OWN_PLACES
            )
        if path.is_dir():
            raise FileAccessError(f"cannot write {path}: it is a folder", OWN_PLACES)


def check_outputs(outputs: Mapping[str, Path], sources: Iterable[Path] = ()) -> None:
    """Check that no output would replace another one, or harm the recording read.

    Args:
        outputs: Paths by the options that name them.
        sources: The recording, files or a folder, which need not exist.

    Raises:
        FileAccessError: One would.
    """
    logs: list[tuple[str, Path]] = []
    for source in filter(Path.exists, sources):
        is_in_bag = is_bag(source) and (source.resolve().parent / METADATA).exists()
        logs.append(("the log", source.resolve().parent if is_in_bag else source))

    pairs = [*combinations(outputs.items(), 2), *product(outputs.items(), logs)]
    for (option, path), (other_option, other) in pairs:
        with file_errors(path, "write"):
            is_same_file = path.exists() and other.exists() and path.samefile(other)
            place = path.resolve()
            other_place = other.resolve()
        is_inside = place.is_relative_to(other_place)
        if is_same_file or is_inside or other_place.is_relative_to(place):
            raise FileAccessError(
                f"cannot write {option} {path}: {other_option} is there, or one lies "
                "inside the other",
                OWN_PLACES,
            )
