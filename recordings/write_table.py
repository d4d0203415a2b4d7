"""Writing columns to a file, whole or not at all."""

from collections.abc import Mapping
from pathlib import Path

from numpy.typing import ArrayLike

from recordings.apart import require_apart_from_log
from recordings.bags.folder import is_folder_name, require_replaceable
from recordings.errors import FileAccessError
from recordings.log import Log
from recordings.open_table import STANDARD_STREAM, find_writer, open_table
from recordings.tables.labels import PLAIN, Labels


def write_table(
    path: str | Path, columns: Mapping[str, ArrayLike], *, labels: Labels = PLAIN
) -> None:
    """Write named columns; readers see the old file or the whole new one, never a part.

    Floats are written so that they read back bit for bit. In CSV, a two-dimensional column
    `q_rad` becomes `q_rad_1`, `q_rad_2`, ...; `read_log` joins them again.

    Args:
        path: a file ending in `.csv`, `.csv.gz`, `.npz`, `.parquet` or `.mcap`, or a folder
            ending in `.db3`; replaced if it exists.
        columns: name, with its unit, to numbers, shape (n,) or (n, k), all of the same n.
        labels: what the formats that have room for it say beside the numbers.

    Raises:
        FileAccessError: the file cannot be written, or its suffix is not known.
        LogError: the columns are not numbers, differ in length, or a name is empty, starts with
            `#` or stands twice.
    """
    with open_table(path, labels=lambda: labels) as table:
        table.append(columns)


def check_writable(path: str | Path, *, source: str | Path | None = None) -> None:
    """Find out before the work what `write_table` would refuse after it.

    Args:
        path: see `write_table`; or `-` for standard output.
        source: a file or folder that is being read and must not be harmed.

    Raises:
        FileAccessError: the suffix is not known, there is no such folder, something stands there
            that must not be replaced, or it and the source lie one inside the other.
    """
    if str(path) == STANDARD_STREAM:
        return
    path = Path(path)
    if not is_folder_name(path):
        find_writer(path)
    if not path.parent.is_dir():
        raise FileAccessError(f"cannot write {path}: there is no folder {path.parent}")
    if is_folder_name(path):
        require_replaceable(path)
    elif path.is_dir():
        raise FileAccessError(f"cannot write {path}: it is a folder")
    if source is not None:
        require_apart_from_log(path, Path(source))


def write_log(path: str | Path, log: Log) -> None:
    """Write a log's time and channels, in SI units.

    Args:
        path: see `write_table`.
        log: what to write.

    Raises:
        FileAccessError: the file cannot be written, or its suffix is not known.
    """
    columns = {"t_s": log.t_s, **log.channels}
    write_table(path, columns, labels=Labels(start_ns=log.start_ns))
