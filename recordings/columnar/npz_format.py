"""Reading npz archives of numpy arrays, whole or in part. Pickled objects are never loaded."""

import zipfile
import zlib
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from recordings.clock.whole_stamps import whole_stamps
from recordings.columnar.npz_member import NpzMember, UnusableArrayError
from recordings.errors import FileAccessError, FormatError
from recordings.tables.labels import START_KEY
from recordings.tables.table import Table

_SUFFIX = ".npy"
_DAMAGE = (ValueError, EOFError, RuntimeError, zipfile.BadZipFile, zlib.error)
_ALL_ROWS = 1 << 62


def read_npz(path: Path) -> Table:
    """Read an npz archive.

    Arrays of shape (n,) or (n, k) become columns, single numbers become constants. Arrays that
    hold no numbers, or are damaged, are left out and told in the table's warnings.

    Args:
        path: the file.

    Returns:
        Its columns.

    Raises:
        FileAccessError: the file cannot be read.
        FormatError: it is not an npz archive, is cut short, or holds no usable array.
    """
    return next(npz_chunks(path, _ALL_ROWS))


def npz_chunks(path: Path, rows: int) -> Iterator[Table]:
    """Read an npz archive a number of rows at a time.

    Args:
        path: the file.
        rows: the most rows of a table.

    Yields:
        Tables of consecutive rows, as `read_npz` would give them; an array that turns out damaged
        is left out from there on. Constants stand in every table, a warning in one.

    Raises:
        FileAccessError: the file cannot be read.
        FormatError: it is not an npz archive, is cut short, or holds no usable array.
    """
    try:
        with zipfile.ZipFile(path) as archive, ExitStack() as stack:
            yield from _Members(archive, stack).tables(path, rows)
    except (FileAccessError, FormatError):
        raise
    except OSError as error:
        raise FileAccessError(f"cannot read {path}: {error.strerror or error}") from error
    except zipfile.BadZipFile as error:
        raise FormatError(
            f"{path} is not an npz archive, or it is cut short: an npz file ends with its table "
            "of contents, so that nothing can be read without its end"
        ) from error


class _Members:
    """The usable arrays of an archive."""

    def __init__(self, archive: zipfile.ZipFile, stack: ExitStack) -> None:
        self._arrays: dict[str, NpzMember] = {}
        self._constants: dict[str, float] = {}
        self._warnings: list[str] = []
        self._start_ns = 0
        for member in archive.namelist():
            name = member.removesuffix(_SUFFIX)
            try:
                array = NpzMember(archive, member, stack)
                if array.shape:
                    self._arrays[name] = array
                elif name == START_KEY:
                    self._start_ns = int(array.read(1)[0])
                else:
                    self._constants[name] = float(array.read(1)[0])
            except _DAMAGE as error:
                self._leave_out(name, error)

    def tables(self, path: Path, rows: int) -> Iterator[Table]:
        while True:
            columns = self._read(rows)
            if not columns:
                told = f": {'; '.join(self._warnings)}" if self._warnings else ""
                raise FormatError(f"{path} holds no array of numbers{told}")
            if not any(map(len, columns.values())):
                return
            warnings, self._warnings = tuple(self._warnings), []
            yield Table(
                columns=columns,
                constants=self._constants,
                warnings=warnings,
                start_ns=self._start_ns,
                stamps=whole_stamps(columns),
            )

    def _read(self, rows: int) -> dict[str, np.ndarray]:
        columns = {}
        for name, array in list(self._arrays.items()):
            try:
                columns[name] = array.read(rows)
            except _DAMAGE as error:
                del self._arrays[name]
                self._leave_out(name, error)
        return columns

    def _leave_out(self, name: str, error: Exception) -> None:
        reason = error if isinstance(error, UnusableArrayError) else f"cannot be read ({error})"
        self._warnings.append(f"column {name!r} {reason} and was left out")
