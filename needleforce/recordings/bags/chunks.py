"""Chunks of bags: records that were compressed together.

The libraries unpack a chunk at once, however large it becomes, and lose all of one that
is damaged. Here it is unpacked in blocks.
"""

import bz2
import io
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

from needleforce.recordings.errors import (
    UNPACK,
    FormatError,
    optional_library,
)


def unpack_chunk(
    packed: bytes, compression: str, size: int, compressions: Sequence[str]
) -> bytes:
    """Return what a compressed chunk holds, as far as it can be had.

    Args:
        packed: Its bytes.
        compression: Name of its compression.
        size: No more bytes are returned.
        compressions: Those that the format of the bag has.

    Raises:
        FormatError: Its compression is none of them.
    """
    if compression not in compressions:
        raise FormatError(
            f"has chunks compressed with {compression!r}; "
            f"{' and '.join(compressions)} can be read",
            UNPACK,
        )

    stream = _open(packed, compression)
    unpacked = bytearray()
    block_bytes = 1 << 16  # what precedes a damaged place is kept
    # Each library has an error of its own for damaged bytes.
    with suppress(Exception):
        while len(unpacked) < size and (block := stream.read(block_bytes)):
            unpacked += block

    return bytes(unpacked[:size])


def _open(packed: bytes, compression: str) -> Any:
    """Return a stream that unpacks some bytes."""
    if compression == "bz2":
        return bz2.BZ2File(io.BytesIO(packed))
    if compression == "lz4":
        return optional_library("lz4.frame", "bags with lz4 chunks").open(
            io.BytesIO(packed)
        )

    zstd = optional_library("zstandard", "bags compressed with zstd")
    return zstd.ZstdDecompressor().stream_reader(packed)
