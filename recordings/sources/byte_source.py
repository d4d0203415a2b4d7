"""The bytes of a file, of a pipe, or of a file that still grows, as they come."""

import os
import select
import stat
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from recordings.errors import FileAccessError

BLOCK = 1 << 18
"""The most bytes that are read at a time."""

_POLL_S = 0.05
_GONE_S = 1.0
"""So long after its last row a file that is no more under its name is read to its end."""
_SMALL, _PAUSE_S = 4096, 0.005  # rows that come one by one are taken some at a time


@dataclass(frozen=True, slots=True, kw_only=True)
class Patience:
    """How long more is waited for.

    Attributes:
        follow: whether a file is read on when its end is reached, because it grows.
        idle_s: stop when nothing came for this long; None to wait for ever.
        should_stop: asked before more is read; True to stop.
        advance: told how many more bytes were read.
        warn: told in words why reading ended before the user wanted it to.
    """

    follow: bool = False
    idle_s: float | None = None
    should_stop: Callable[[], bool] = lambda: False
    advance: Callable[[float], None] = lambda more: None
    warn: Callable[[str], None] = lambda text: None


def byte_blocks(
    path: Path | None, patience: Patience, *, tell_pauses: bool = False
) -> Iterator[bytes]:
    """Read a file or standard input; whoever waits for more sees at once what there is.

    Args:
        path: the file, or None for standard input.
        patience: how long more is waited for.
        tell_pauses: whether an empty block says each time that more is now waited for.

    Yields:
        Blocks of at least one byte, apart from those.

    Raises:
        FileAccessError: the file cannot be read, or has become shorter while it was followed.
    """
    name = "standard input" if path is None else str(path)
    try:
        handle = _standard_input() if path is None else os.open(path, os.O_RDONLY)
        try:
            blocks = _blocks(handle, patience, path)
            yield from (block for block in blocks if block or tell_pauses)
        finally:
            if path is not None:
                os.close(handle)
    except FileAccessError:
        raise
    except OSError as error:
        raise FileAccessError(f"cannot read {name}: {error.strerror or error}") from error


def _standard_input() -> int:
    if sys.stdin is None:
        raise FileAccessError("cannot read standard input: it is closed")
    return sys.stdin.fileno()


def _blocks(handle: int, patience: Patience, path: Path | None) -> Iterator[bytes]:
    is_file = stat.S_ISREG(os.fstat(handle).st_mode)
    done, last_s = 0, time.monotonic()
    while not patience.should_stop():
        if is_file or select.select([handle], [], [], _POLL_S)[0]:
            block = os.read(handle, BLOCK)
            if block:
                done += len(block)
                patience.advance(len(block))
                yield block
                last_s = time.monotonic()
                if len(block) < _SMALL:
                    time.sleep(_PAUSE_S)
                continue
            # The writer of a pipe that has closed it will not come back.
            if not (is_file and patience.follow):
                return
            if _is_over(handle, path, done, time.monotonic() - last_s, patience.warn):
                return
            yield b""
            time.sleep(_POLL_S)
        if patience.idle_s is not None and time.monotonic() - last_s >= patience.idle_s:
            return


def _is_over(
    handle: int,
    path: Path | None,
    done: int,
    idle_s: float,
    warn: Callable[[str], None],
) -> bool:
    """Return whether nothing will come of a followed file, because another stands in its place."""
    if os.fstat(handle).st_size < done:
        raise FileAccessError(f"{path} has become shorter while it was followed")
    if path is None or idle_s < _GONE_S or _is_at(path, handle):
        return False
    warn(
        f"{path} was moved, deleted or replaced while it was followed; it was read to its end, and "
        "no other file is; start again to follow the new one"
    )
    return True


def _is_at(path: Path, handle: int) -> bool:
    """Return whether the open file still stands under its name."""
    try:
        return os.path.samestat(path.stat(), os.fstat(handle))
    except OSError:
        return False
