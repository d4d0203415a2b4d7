"""The records of an MCAP file in the order in which they stand, as far as they can be read.

The index at the end is not needed: a recording whose end is missing is read like any other. The
layout is that of https://mcap.dev/spec.
"""

from collections.abc import Generator, Iterator
from struct import Struct
from typing import BinaryIO, NamedTuple
from zlib import crc32

from recordings.bag_storage.mcap_compression import decompressed
from recordings.errors import FormatError
from recordings.sources.growing_file import GrowingFile

MAGIC = b"\x89MCAP0\r\n"
FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, DATA_END = 0x02, 0x03, 0x04, 0x05, 0x06, 0x0F

_HEAD = Struct("<BQ")
_CHUNK_HEAD = Struct("<QQQII")
_SIZE = Struct("<Q")
_FOOTER = Struct("<BQQQI8s")
_READ = (SCHEMA, CHANNEL, MESSAGE, CHUNK)
_BLOCK = 1 << 24  # bytes

CUT_SHORT = "is cut short"


class Record(NamedTuple):
    """A schema, channel or message.

    Attributes:
        opcode: which of them.
        body: its bytes.
    """

    opcode: int
    body: bytes


PAUSE = Record(0, b"")
"""Stands in place of a record wherever a file that still grows has been read as far as it goes."""


def mcap_records(stream: BinaryIO | GrowingFile, faults: list[str]) -> Iterator[Record]:
    """Read schemas, channels and messages, those inside chunks included.

    Args:
        stream: an MCAP file, open at its start. One that grows may end after any record.
        faults: what is wrong with the file is appended here, one phrase each.

    Yields:
        The records; of a damaged or cut chunk those that can be had.

    Raises:
        FormatError: it is not an MCAP file.
    """
    if (head := (yield from _read(stream, len(MAGIC)))) != MAGIC:
        raise FormatError("is not an MCAP file: it does not begin as one" if head else "is empty")
    at = len(MAGIC)
    while len(head := (yield from _read(stream, _HEAD.size))) == _HEAD.size:
        opcode, size = _HEAD.unpack(head)
        if opcode in (DATA_END, FOOTER):
            return
        body = yield from _read(stream, size)
        is_whole = len(body) == size
        if opcode == CHUNK:
            yield from _chunk(body, at, faults)
        elif is_whole and opcode in _READ:
            yield Record(opcode, body)
        if not is_whole:
            break
        at += _HEAD.size + size
    if head or not isinstance(stream, GrowingFile):
        faults.append(CUT_SHORT)


def summary_records(stream: BinaryIO | GrowingFile) -> Iterator[Record]:
    """Read schemas and channels from the end of a file; the chunk that held them may be damaged.

    Args:
        stream: an MCAP file, open at its start, where it is left again.

    Yields:
        The records; none if the file was not finished, or grows.
    """
    if isinstance(stream, GrowingFile):
        return
    length = stream.seek(0, 2)
    stream.seek(max(length - _FOOTER.size, 0))
    end = stream.read()
    start = length
    if len(end) == _FOOTER.size and end.endswith(MAGIC):
        opcode, _, start, _, _, _ = _FOOTER.unpack(end)
        start = start if opcode == FOOTER and 0 < start < length else length
    stream.seek(start)
    summary = stream.read()
    stream.seek(0)
    yield from (record for record in _split(summary) if record.opcode in (SCHEMA, CHANNEL))


def _read(stream: BinaryIO | GrowingFile, size: int) -> Generator[Record, None, bytes]:
    """Return `size` bytes, or what is left; a damaged size must not ask for all memory at once."""
    parts: list[bytes] = []
    while size > 0:
        part = stream.read(min(size, _BLOCK))
        if part is None:
            yield PAUSE
            continue
        if not part:
            break
        parts.append(part)
        size -= len(part)
    return b"".join(parts)


def _chunk(body: bytes, at: int, faults: list[str]) -> Iterator[Record]:
    if len(body) < _CHUNK_HEAD.size:
        return
    *_, full_size, crc, name_size = _CHUNK_HEAD.unpack_from(body)
    start = _CHUNK_HEAD.size + name_size
    if len(body) < start + _SIZE.size:
        return
    compression = body[_CHUNK_HEAD.size : start].decode(errors="replace")
    (packed_size,) = _SIZE.unpack_from(body, start)
    packed = body[start + _SIZE.size :][:packed_size]
    data, is_sound = decompressed(packed, compression)
    is_whole = is_sound and len(data) == full_size
    if is_whole and crc and crc32(data) != crc:
        faults.append(f"has a chunk at byte {at} whose checksum is wrong, which was left out")
        return
    sound = yield from _split(data)
    if sound < full_size and len(packed) == packed_size:
        faults.append(
            f"has a damaged chunk at byte {at}, of which {sound} of {full_size} bytes are sound"
        )


def _split(data: bytes) -> Generator[Record, None, int]:
    """Yield the records of a chunk, and return how many bytes they take."""
    at = 0
    while at + _HEAD.size <= len(data):
        opcode, size = _HEAD.unpack_from(data, at)
        start = at + _HEAD.size
        if start + size > len(data):
            break
        at = start + size
        if opcode in _READ:
            yield Record(opcode, data[start:at])
    return at
