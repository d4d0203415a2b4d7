"""The bytes of a file, of a pipe, or of a file that still grows, as they come."""

import codecs
import io
import os
import select
import stat
import sys
import time
import zlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

from needleforce.recordings.errors import (
    FileAccessError,
    FormatError,
    file_errors,
    readable_path,
)

BLOCK = 1 << 18  # the most bytes that are read, or unpacked, at a time
STANDARD_STREAM = "-"  # instead of a file: standard input or standard output

_POLL_S = 0.05
# rows that come one by one are taken some at a time
_SMALL = 4096
_PAUSE_S = 0.005
_CHECKED_TAIL = (
    256  # Bytes before the place of reading that show if a file was written anew
)


@dataclass(frozen=True, slots=True, kw_only=True)
class FollowOptions:
    """How long more is waited for, and who hears of it.

    Attributes:
        follow: A file is read on when its end is reached, because it grows.
        should_stop: Asked before more is read.
        progress: Gets the fraction read, where it is known.
        warn: Gets in words what is waited for.
    """

    follow: bool = False
    idle_s: float | None = (
        None  # stop when nothing came for this long; None to wait for ever
    )
    should_stop: Callable[[], bool] = lambda: False
    progress: Callable[[float], None] = lambda _: None
    warn: Callable[[str], None] = lambda text: None


def byte_blocks(path: Path | None, options: FollowOptions) -> Iterator[bytes]:
    """Read a file, or standard input if None; whoever waits for more gets at once what
    there is.

    `FileAccessError` if it cannot be read, or was shortened, rewritten, renamed or
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
            yield from _blocks(handle, options, path)
        finally:
            if path is not None:
                os.close(handle)


def _blocks(handle: int, options: FollowOptions, path: Path | None) -> Iterator[bytes]:
    is_file = stat.S_ISREG(os.fstat(handle).st_mode)
    done = 0
    tail = b""
    last_s = time.monotonic()
    follows = options.follow and is_file
    while not options.should_stop():
        if is_file or select.select([handle], [], [], _POLL_S)[0]:
            _require_unchanged(handle, path, done, tail if follows else None)
            block = os.read(handle, BLOCK)
            if block:
                done += len(block)
                tail = (tail + block)[-_CHECKED_TAIL:]
                if is_file and not follows:
                    options.progress(done / max(os.fstat(handle).st_size, 1))
                yield block
                last_s = time.monotonic()
                if len(block) < _SMALL:
                    time.sleep(_PAUSE_S)
                continue
            # The writer of a pipe that has closed it will not come back.
            if not follows:
                return
            time.sleep(_POLL_S)
        if options.idle_s is not None and time.monotonic() - last_s >= options.idle_s:
            return


def _require_unchanged(
    handle: int, path: Path | None, done: int, tail: bytes | None
) -> None:
    """Refuse a followed file that was truncated, also if it has grown since, or is
    gone.
    """
    if tail is None or path is None:
        return
    now = os.fstat(handle)
    if now.st_size == done and not (
        path.exists() and os.path.samestat(path.stat(), now)
    ):
        raise FileAccessError(
            f"{path} was renamed or removed while it was followed; start again"
        )
    if now.st_size < done:
        raise FileAccessError(f"{path} has become shorter while it was followed")
    if os.pread(handle, len(tail), done - len(tail)) != tail:
        raise FileAccessError(
            f"{path} was written anew while it was followed; start again"
        )


BINARY = {
    b"\x89MCA": ".mcap",
    b"SQLi": ".db3",
    b"PK\x03\x04": ".npz",
    b"PAR1": ".parquet",
}
"""How files begin that are no text, and their suffixes."""


def head_of(blocks: Iterable[bytes], size: int = 4) -> tuple[bytes, Iterator[bytes]]:
    """Return the first bytes, if there are so many, and all blocks."""
    blocks = iter(blocks)
    head = b""
    while len(head) < size and (more := next(blocks, b"")):
        head += more
    return head[:size], chain([head] if head else [], blocks)


_GZIP = b"\x1f\x8b"
_GZIP_WINDOW = (
    31  # for zlib: the largest window, with the head and the checksum of gzip
)
_LONGEST_LINE = 1 << 24  # characters
_WINDOWS = {
    0xDC00 + byte: bytes([byte]).decode("cp1252", "replace") for byte in range(128, 256)
}
"""What bytes that are no UTF-8, as Python escapes them, mean in Windows text."""


class TextLines:
    """Iterates over the whole lines of a text, in lists of those that came together.

    Text compressed with gzip is unpacked, whatever its suffix, line ends may be of any
    kind, and what is not UTF-8 is read as Windows text.
    """

    def __init__(self, blocks: Iterable[bytes]) -> None:
        self._blocks = blocks
        decoder = codecs.getincrementaldecoder("utf-8-sig")("surrogateescape")
        self._decoder = io.IncrementalNewlineDecoder(decoder, translate=True)
        self._count = 0
        self._fault = ""
        self._is_blank = True
        self.tail = ""  # once all is read: what stands behind the last line end
        self.size = 0  # bytes of text so far
        self.warnings: list[str] = []  # what was lost or guessed

    def __iter__(self) -> Iterator[list[str]]:
        """Yield the lines, without their ends; `FormatError` if there is no text."""
        for block in self._unpacked():
            self.size += len(block)
            text, nul, _ = block.partition(b"\x00")
            yield from self._split(self._decoder.decode(text))
            if nul:
                self._fault = (
                    "the file goes on with NUL bytes, as power loss may leave them"
                )
                break
        yield from self._split(self._decoder.decode(b"", final=True))
        if self._fault:
            self._fault += f"; what follows line {self._count} is lost"
            if "damaged" in self._fault:
                self._fault += ", and lines before it may be wrong: gzip shows that there is damage, not where"
            self.warnings.append(self._fault)
            # What follows the last line end is a piece of a line.
            self.tail = ""
        if self._is_blank:
            what = "is not text" if "NUL" in self._fault else "is empty"
            raise FormatError(f"it {what}; expected a header row and rows of numbers")

    def forgive_end(self) -> None:
        """Leave out a piece of a line at the end, and do not blame the source for
        it.
        """
        self.tail = ""
        if "cut short" in self._fault:
            self.warnings.remove(self._fault)

    def _unpacked(self) -> Iterator[bytes]:
        head, blocks = head_of(self._blocks)
        if head in BINARY:
            kind = BINARY[head][1:]
            raise FormatError(
                f"it is {kind}, not text; give it as a file, under its own suffix"
            )
        if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
            raise FormatError(
                "it is UTF-16 text; save it as UTF-8 (in Excel: CSV UTF-8)"
            )
        yield from self._gunzipped(blocks) if head.startswith(_GZIP) else blocks

    def _gunzipped(self, blocks: Iterable[bytes]) -> Iterator[bytes]:
        """Yield blocks of at most `BLOCK` bytes: a megabyte of gzip can hold a
        gigabyte.
        """
        member = zlib.decompressobj(_GZIP_WINDOW)
        is_open = False
        try:
            for packed in blocks:
                # Members may follow each other, and zeros the last.
                while packed and (is_open or (packed := packed.lstrip(b"\x00"))):
                    yield member.decompress(packed, BLOCK)
                    packed = member.unconsumed_tail
                    is_open = not member.eof
                    if member.eof:
                        packed = member.unused_data
                        member = zlib.decompressobj(_GZIP_WINDOW)
        except zlib.error:
            self._fault = "the compressed file is damaged"
        else:
            self._fault = "the compressed file is cut short" if is_open else ""

    def _split(self, escaped: str) -> Iterator[list[str]]:
        text = escaped if escaped.isascii() else escaped.translate(_WINDOWS)
        note = "the file is not UTF-8; it was read as Windows text (cp1252)"
        if text != escaped and note not in self.warnings:
            self.warnings.append(note)
        self._is_blank = self._is_blank and not text.strip()
        *lines, self.tail = (self.tail + text).split("\n")
        if len(self.tail) > _LONGEST_LINE:
            raise FormatError(f"it is not text; line {self._count + 1} does not end")
        if lines:
            self._count += len(lines)
            yield lines
