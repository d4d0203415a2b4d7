"""Blocks of bytes unpacked, if they are compressed with gzip."""

import zlib
from collections.abc import Iterable, Iterator

_MAGIC = b"\x1f\x8b"
_GZIP_WINDOW = 31  # zlib's code for "expect a gzip header"


class Unpacked:
    """Iterates over the content of blocks that may be compressed, whatever the file's suffix.

    Args:
        blocks: as read.
    """

    def __init__(self, blocks: Iterable[bytes]) -> None:
        self._blocks = iter(blocks)
        self.fault = ""
        """Once all is read: what is wrong with the compressed data, if anything."""
        self.is_damaged = False
        """Whether what was unpacked may be wrong: damage is seen blocks later, or at the end."""
        self.checked = 0
        """Members whose checksum was right; what was yielded until then is sound."""

    def __iter__(self) -> Iterator[bytes]:
        """Yield blocks of at least one byte."""
        head = b""
        for block in self._blocks:
            head += block
            if len(head) >= len(_MAGIC):
                break
        if head.startswith(_MAGIC):
            yield from self._unpack(head)
            return
        if head:
            yield head
        yield from self._blocks

    def _unpack(self, data: bytes) -> Iterator[bytes]:
        while data.startswith(_MAGIC):
            member = zlib.decompressobj(_GZIP_WINDOW)
            while not member.eof:
                try:
                    content = member.decompress(data)
                except zlib.error:
                    self.fault, self.is_damaged = "is damaged", True
                    return
                if content:
                    yield content
                self.checked += member.eof
                data = member.unused_data if member.eof else next(self._blocks, b"")
                if not (data or member.eof):
                    self.fault = "is cut short"
                    return
            # Appended members, as `cat a.gz b.gz` or a logger that reopens its file gives.
            while len(data) < len(_MAGIC) and (more := next(self._blocks, b"")):
                data += more
