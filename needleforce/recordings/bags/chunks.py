"""Chunks of bags: records that were compressed together."""

import bz2
import io
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import IO, Any

from needleforce.recordings.errors import (
    FormatError,
    RecordingCode,
    optional_library,
)

BLOCK_BYTES = 1 << 16
"""A chunk is unpacked in blocks of this size: what precedes a damaged place is kept,
and a bomb is left before it grows."""


def _open_bz2(packed: bytes) -> Any:
    return bz2.BZ2File(io.BytesIO(packed))


def _open_lz4(packed: bytes) -> Any:
    lz4 = optional_library("lz4.frame", "bags with lz4 chunks")
    return lz4.open(io.BytesIO(packed))


def _open_zstd(packed: bytes) -> Any:
    zstd = optional_library("zstandard", "bags compressed with zstd")
    return zstd.ZstdDecompressor().stream_reader(packed)


_OPENERS: dict[str, Callable[[bytes], IO[bytes]]] = {
    "bz2": _open_bz2,
    "lz4": _open_lz4,
    "zstd": _open_zstd,
}
"""What opens a chunk, by the name of its compression."""


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
            RecordingCode.BAG,
        )

    stream = _OPENERS[compression](packed)
    unpacked = bytearray()
    # Each library has an error of its own for damaged bytes.
    with suppress(Exception):
        while len(unpacked) < size and (block := stream.read(BLOCK_BYTES)):
            unpacked += block

    return bytes(unpacked[:size])
