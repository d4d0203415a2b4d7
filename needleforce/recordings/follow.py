"""The bytes of a file, of a pipe, or of a file that still grows, as they come."""

import os
import select
import stat
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

from needleforce.recordings.errors import (
    START_AGAIN,
    FileAccessError,
    file_errors,
    readable_path,
)

STANDARD_STREAM = "-"
"""Stands in place of a file for standard input or standard output."""

MAX_BLOCK_BYTES = 1 << 18
"""The most bytes that are read, or unpacked, at a time."""

POLL_S = 0.05
"""Time between two looks for more bytes."""

BINARY = {
    b"\x89MCA": ".mcap",
    b"SQLi": ".db3",
    b"PK\x03\x04": ".npz",
    b"PAR1": ".parquet",
    b"ARRO": ".feather",
}
"""How files begin that are no text, and their suffixes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FollowOptions:
    """How long more is waited for, and who hears of it.

    Attributes:
        follow: Whether a file is read on when its end is reached, because it grows.
        idle_s: Reading stops when nothing came for this long; None to wait for ever.
        should_stop: Asked before more is read.
        progress: Gets the fraction read, where it is known.
        warn: Gets in words what is waited for.
    """

    follow: bool = False
    idle_s: float | None = None
    should_stop: Callable[[], bool] = lambda: False
    progress: Callable[[float], None] = lambda _: None
    warn: Callable[[str], None] = lambda text: None


def byte_blocks(path: Path | None, options: FollowOptions) -> Iterator[bytes]:
    """Yield the bytes of a file, or of standard input, at once as they come.

    Args:
        path: Of the file or pipe; None for standard input.
        options: Whether, and for how long, more is waited for.

    Raises:
        FileAccessError: It cannot be read, or was shortened, rewritten, renamed or
            removed while it was followed.
    """
    with file_errors("standard input" if path is None else path):
        if path is not None:
            # Without O_NONBLOCK a pipe that nobody writes would block here, deaf to
            # Ctrl-C.
            handle = os.open(readable_path(path), os.O_RDONLY | os.O_NONBLOCK)
        elif sys.stdin is None:
            raise FileAccessError("cannot read standard input: it is closed")
        else:
            handle = sys.stdin.fileno()

        try:
            yield from _blocks_of_handle(handle, options, path)
        finally:
            if path is not None:
                os.close(handle)


def _blocks_of_handle(
    handle: int, options: FollowOptions, path: Path | None
) -> Iterator[bytes]:
    """Yield the bytes of an open file or pipe, at once as they come."""
    is_file = stat.S_ISREG(os.fstat(handle).st_mode)
    is_followed = options.follow and is_file
    watched_path = path if is_followed else None
    checked_bytes = 256  # before the place of reading show whether it was written anew
    read_bytes = 0
    tail = b""
    latest_s = time.monotonic()
    while not options.should_stop():
        if is_file or select.select([handle], [], [], POLL_S)[0]:
            _require_unchanged(handle, watched_path, read_bytes, tail)
            block = os.read(handle, MAX_BLOCK_BYTES)
            if block:
                read_bytes += len(block)
                tail = (tail + block)[-checked_bytes:]
                if is_file and not is_followed:
                    options.progress(read_bytes / max(os.fstat(handle).st_size, 1))

                yield block
                latest_s = time.monotonic()
                # Rows that come one by one are taken some at a time.
                if len(block) < 4096:
                    time.sleep(0.005)

                continue

            # The writer of a pipe that has closed it will not come back.
            if not is_followed:
                return

            time.sleep(POLL_S)

        idle_s = time.monotonic() - latest_s
        if options.idle_s is not None and idle_s >= options.idle_s:
            return


def _require_unchanged(
    handle: int, path: Path | None, read_bytes: int, tail: bytes
) -> None:
    """Refuse a followed file that was truncated, also if it grew since, or is gone.

    Args:
        handle: Of the open file.
        path: At which it should still be; None for what is not followed, or has none.
        read_bytes: How much of it was read.
        tail: The last of the bytes read.
    """
    if path is None:
        return

    status = os.fstat(handle)
    is_at_end = status.st_size == read_bytes
    if is_at_end and not (path.exists() and os.path.samestat(path.stat(), status)):
        raise FileAccessError(
            f"{path} was renamed or removed while it was followed",
            START_AGAIN,
        )

    if status.st_size < read_bytes:
        raise FileAccessError(
            f"{path} has become shorter while it was followed", START_AGAIN
        )

    if os.pread(handle, len(tail), read_bytes - len(tail)) != tail:
        raise FileAccessError(
            f"{path} was written anew while it was followed", START_AGAIN
        )


def head_of(
    blocks: Iterable[bytes],
    size: int = 4,  # of the beginnings in `BINARY`
) -> tuple[bytes, Iterator[bytes]]:
    """Return the first bytes, if there are so many, and all blocks with them."""
    blocks = iter(blocks)
    head = b""
    while len(head) < size and (block := next(blocks, b"")):
        head += block

    return head[:size], chain([head] if head else [], blocks)
