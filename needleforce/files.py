"""Files that are written whole or not at all."""

import os
import secrets
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO


@contextmanager
def whole_file(
    path: str | os.PathLike[str], *, is_in_place: bool = False
) -> Iterator[BinaryIO]:
    """Open a file that takes the place of an older one when the block has ended without
    an error.

    Otherwise the older one stays as it was. A pipe or a device stays what it is and is
    written to, and so is what shall be written in place; of a link what it points at is
    replaced. `OSError` if the file cannot be written.
    """
    place = part = Path(os.path.realpath(path))
    stays = is_in_place or (place.exists() and not place.is_file())
    if not stays:
        # A new file, under a name where nobody can plant a link.
        part = place.with_name(f".{place.name}.{secrets.token_hex(4)}.part")
    stream = (
        _open_pipe(place) if place.is_fifo() else part.open("wb" if stays else "xb")
    )
    try:
        yield stream
        stream.flush()
        if not stays:
            os.fsync(stream.fileno())
            part.replace(place)
    finally:
        with suppress(
            OSError
        ):  # on a full disk closing fails, too, but that has been reported
            stream.close()
        if not stays:
            part.unlink(missing_ok=True)


def _open_pipe(path: Path) -> BinaryIO:
    """Wait for its reader; Ctrl-C ends that at once, whatever else it is taken for."""
    if threading.current_thread() is not threading.main_thread():
        return path.open("wb")
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        return path.open("wb")
    finally:
        signal.signal(signal.SIGINT, before)
