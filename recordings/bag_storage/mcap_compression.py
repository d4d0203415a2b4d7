"""Unpacking a chunk of an MCAP file, also one that is cut or damaged."""

import sys
from typing import Any

from recordings.errors import FormatError
from recordings.optional_library import optional_library

_BLOCK = 1 << 14  # bytes


def decompressed(packed: bytes, compression: str) -> tuple[bytes, bool]:
    """Return what a chunk holds, and whether that is all of it.

    Args:
        packed: its bytes.
        compression: `zstd`, `lz4`, or empty.

    Raises:
        FormatError: it is compressed in another way.
        FileAccessError: the library is not installed.
    """
    if not compression:
        return packed, True
    if compression == "zstd":
        return _unpack(zstd_library().ZstdDecompressor(), packed)
    if compression == "lz4":
        lz4 = optional_library("lz4.frame", "MCAP files with lz4 chunks")
        return _unpack(lz4.LZ4FrameDecompressor(), packed)
    raise FormatError(f"has chunks compressed with {compression!r}; zstd and lz4 can be read")


def zstd_library() -> Any:
    """Return the library of zstd: Python's own since 3.14, before that a copy of it."""
    name = "compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd"
    return optional_library(name, "bags compressed with zstd")


def _unpack(unpacker: Any, packed: bytes) -> tuple[bytes, bool]:
    parts: list[bytes] = []
    try:
        # In blocks, so that what precedes a damaged place is kept.
        for start in range(0, len(packed), _BLOCK):
            parts.append(unpacker.decompress(packed[start : start + _BLOCK]))
            if unpacker.eof:
                break
    except (RuntimeError, EOFError, ValueError, zstd_library().ZstdError):
        return b"".join(parts), False
    return b"".join(parts), unpacker.eof
