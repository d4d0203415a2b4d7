"""Files that are written whole or not at all."""

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO


@contextmanager
def whole_file(
    path: str | os.PathLike[str],
    *,
    is_in_place: bool = False,
    overwrites: bool = True,
) -> Iterator[BinaryIO]:
    """Open a file that replaces an older one when the block ends without an error.

    Otherwise the older one stays as it was. A pipe or a device stays what it is and is
    written to, and so is what shall be written in place; of a link the file that it
    points at is replaced.

    Args:
        path: The file.
        is_in_place: Write into the file itself.
        overwrites: Whether an older file may be written into; what is written beside it
            always replaces it.

    Raises:
        OSError: The file cannot be written, or is there and shall stay.
    """
    target = Path(os.path.realpath(path))
    is_special = target.exists() and not target.is_file()
    if is_in_place or is_special:
        stream = target.open("wb" if overwrites or is_special else "xb")
        with _closed_quietly(stream):
            yield stream
            stream.flush()
        return
    # A new file, under a name where nobody can plant a link.
    new_file = target.with_name(f".{target.name}.{secrets.token_hex(4)}.part")
    stream = new_file.open("xb")
    try:
        with _closed_quietly(stream):
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        new_file.replace(target)
    finally:
        new_file.unlink(missing_ok=True)


@contextmanager
def _closed_quietly(stream: BinaryIO) -> Iterator[None]:
    """Close a file at the end of a block, without an error of its own.

    On a full disk closing fails, too, but that has been reported by writing.
    """
    try:
        yield
    finally:
        with suppress(OSError):
            stream.close()
