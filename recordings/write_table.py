"""Writing columns to CSV or npz, whole or not at all."""

import csv
import gzip
import io
import os
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from recordings.errors import FileAccessError, LogError
from recordings.log import Log

_Columns = Mapping[str, np.ndarray]


def write_table(path: str | Path, columns: Mapping[str, ArrayLike]) -> None:
    """Write named columns; readers see the old file or the whole new one, never a part.

    Floats are written so that they read back bit for bit. In CSV, a two-dimensional column
    `q_rad` becomes `q_rad_1`, `q_rad_2`, ...; `read_log` joins them again.

    Args:
        path: a file ending in `.csv`, `.csv.gz` or `.npz`; replaced if it exists.
        columns: name, with its unit, to numbers, shape (n,) or (n, k), all of the same n.

    Raises:
        FileAccessError: the file cannot be written, or its suffix is not known.
        LogError: the columns are not numbers, differ in length, or a name is empty, starts with
            `#` or stands twice.
    """
    path = Path(path)
    write = _writer(path)
    arrays = _checked(columns)
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with part.open("wb") as stream:
            write(stream, arrays)
        os.replace(part, path)
    except OSError as error:
        raise FileAccessError(f"cannot write {path}: {error.strerror or error}") from error
    finally:
        part.unlink(missing_ok=True)


def check_writable(path: str | Path) -> None:
    """Find out before the work what `write_table` would refuse after it.

    Args:
        path: see `write_table`.

    Raises:
        FileAccessError: the suffix is not known, or there is no such folder.
    """
    path = Path(path)
    _writer(path)
    if not path.parent.is_dir():
        raise FileAccessError(f"cannot write {path}: there is no folder {path.parent}")


def write_log(path: str | Path, log: Log) -> None:
    """Write a log's time and channels, in SI units.

    Args:
        path: see `write_table`.
        log: what to write.

    Raises:
        FileAccessError: the file cannot be written, or its suffix is not known.
    """
    write_table(path, {"t_s": log.t_s, **log.channels})


def _writer(path: Path) -> Callable[[io.BufferedIOBase, _Columns], None]:
    for suffix, write in _WRITERS.items():
        if path.name.lower().endswith(suffix):
            return write
    raise FileAccessError(f"{path} has no known suffix; known are: {', '.join(_WRITERS)}")


def _as_array(name: str, values: ArrayLike) -> np.ndarray:
    try:
        return np.asarray(values)
    except ValueError as error:
        raise LogError(f"column {name!r} is not an array of numbers: {error}") from error


def _checked(columns: Mapping[str, ArrayLike]) -> _Columns:
    arrays = {name: _as_array(name, values) for name, values in columns.items()}
    if not arrays:
        raise LogError("no columns to write")
    rows = len(next(iter(arrays.values()))) if next(iter(arrays.values())).ndim else 0
    for name, values in arrays.items():
        if not name.strip() or name.startswith("#"):
            raise LogError(f"column name {name!r} is empty or starts with '#'")
        if values.dtype.kind not in "fiub" or values.ndim not in (1, 2) or len(values) != rows:
            raise LogError(
                f"column {name!r} has shape {values.shape} and type {values.dtype}; expected "
                f"numbers of shape ({rows},) or ({rows}, k)"
            )
    return arrays


def _write_csv(stream: io.BufferedIOBase, columns: _Columns) -> None:
    names: list[str] = []
    cells: list[list[float | int]] = []
    for name, values in columns.items():
        values = values.astype(int) if values.dtype.kind == "b" else values
        if values.ndim == 1:
            names.append(name)
            cells.append(values.tolist())
        else:
            names += [f"{name}_{i + 1}" for i in range(values.shape[1])]
            cells += values.T.tolist()
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise LogError(f"column name {twice!r} would stand twice in the header")
    header = io.StringIO()
    csv.writer(header, lineterminator="\n").writerow(names)
    stream.write(header.getvalue().encode())
    # repr is the shortest text that reads back to the same float.
    stream.writelines(f"{','.join(map(repr, row))}\n".encode() for row in zip(*cells, strict=True))


def _write_csv_gz(stream: io.BufferedIOBase, columns: _Columns) -> None:
    # No name and no time in the archive: the same columns give the same bytes.
    with gzip.GzipFile(filename="", mode="wb", fileobj=stream, mtime=0, compresslevel=3) as packed:
        _write_csv(packed, columns)


def _write_npz(stream: io.BufferedIOBase, columns: _Columns) -> None:
    with zipfile.ZipFile(stream, "w") as archive:
        for name, values in columns.items():
            # numpy.savez would stamp the time and could not write a column called "file".
            entry = zipfile.ZipInfo(f"{name}.npy")
            entry.compress_type = zipfile.ZIP_DEFLATED
            with archive.open(entry, "w", force_zip64=True) as member:
                np.lib.format.write_array(member, values, allow_pickle=False)


_WRITERS: Mapping[str, Callable[[io.BufferedIOBase, _Columns], None]] = {
    ".csv": _write_csv,
    ".csv.gz": _write_csv_gz,
    ".npz": _write_npz,
}
