"""Reading npz archives of numpy arrays. Pickled objects are never loaded."""

import zipfile
import zlib
from pathlib import Path

import numpy as np

from recordings.errors import FileAccessError, FormatError
from recordings.table import Table

_SUFFIX = ".npy"
_NUMBER_KINDS = "fiub"  # dtype kinds: float, signed, unsigned, bool


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
    columns, constants, warnings = {}, {}, []
    try:
        with zipfile.ZipFile(path) as archive:
            for member in archive.namelist():
                name = member.removesuffix(_SUFFIX)
                content = _read_member(archive, member)
                if isinstance(content, str):
                    warnings.append(f"column {name!r} {content} and was left out")
                elif content.ndim == 0:
                    constants[name] = float(content)
                else:
                    columns[name] = content
    except OSError as error:
        raise FileAccessError(f"cannot read {path}: {error.strerror or error}") from error
    except zipfile.BadZipFile as error:
        raise FormatError(
            f"{path} is not an npz archive, or it is cut short: an npz file ends with its table "
            "of contents, so that nothing can be read without its end"
        ) from error
    if not columns:
        told = f": {'; '.join(warnings)}" if warnings else ""
        raise FormatError(f"{path} holds no array of numbers{told}")
    return Table(columns=columns, constants=constants, warnings=tuple(warnings))


def _read_member(archive: zipfile.ZipFile, member: str) -> np.ndarray | str:
    """Return an array, or the reason why it cannot be used."""
    try:
        with archive.open(member) as stream:
            values = np.lib.format.read_array(stream, allow_pickle=False)
    except (ValueError, EOFError, RuntimeError, zipfile.BadZipFile, zlib.error) as error:
        return f"cannot be read ({error})"
    if values.dtype.kind not in _NUMBER_KINDS:
        return f"holds {values.dtype}, no numbers,"
    if values.ndim > 2 or values.size == 0:
        return f"has shape {values.shape}, not (n,) or (n, k),"
    return values
