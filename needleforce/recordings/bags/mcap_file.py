"""The messages of one MCAP file, read from its start as far as it goes.

The format is a sequence of records, each with its number and size; chunks are records
that hold records, compressed or not. The library `mcap` parses schemas, channels and
chunks. The index at the end of the file is not needed.
"""

import io
import struct
from collections.abc import Iterator
from enum import IntEnum
from pathlib import Path
from typing import Any, NamedTuple
from zlib import crc32

from needleforce.recordings.bags.chunks import unpack_chunk
from needleforce.recordings.bags.messages import (
    NONE_YET,
    BagTopic,
    RawMessage,
    require_magic,
)
from needleforce.recordings.errors import (
    optional_library,
    require_size,
)
from needleforce.recordings.follow import FollowOptions, byte_blocks, head_of

MAGIC = b"\x89MCAP0\r\n"
"""How the file begins and ends."""

MAX_STAMP_NS = (1 << 63) - 1
"""Later stamps do not fit int64; damaged messages may have them."""

COMPRESSIONS = ("zstd", "lz4")
"""Of chunks, besides none."""

_RECORD_HEAD = struct.Struct("<BQ")
"""Number and size, with which a record begins."""

_MESSAGE_HEAD = struct.Struct("<HIQQ")
"""Channel, sequence, and when it was recorded and published."""


class _Opcode(IntEnum):
    """Numbers of records; none lies between the end of the data and private ones."""

    SCHEMA = 0x03
    CHANNEL = 0x04
    MESSAGE = 0x05
    CHUNK = 0x06
    DATA_END = 0x0F
    PRIVATE = 0x80


_DATA_END_BYTES = 4
"""Size of the record that ends the data."""

_PARSERS = {
    _Opcode.SCHEMA: "Schema",
    _Opcode.CHANNEL: "Channel",
    _Opcode.CHUNK: "Chunk",
}
"""Classes of the library that parse records."""


class _Record(NamedTuple):
    """Where a record stands in bytes.

    Attributes:
        opcode: Its number, see `_Opcode`; of damaged bytes any.
        start: Where its content begins.
        end: Where its content ends; it may lie behind the bytes.
    """

    opcode: int
    start: int
    end: int


class _Schema(NamedTuple):
    """The type of messages: its name, and its definition if that is one of ROS 2."""

    kind: str
    definition: str


def _records(data: bytes | bytearray, start: int = 0) -> Iterator[_Record]:
    """Yield the records in bytes from a place on; the last may end behind them."""
    while len(data) - start >= _RECORD_HEAD.size:
        opcode, size = _RECORD_HEAD.unpack_from(data, start)
        start += _RECORD_HEAD.size
        yield _Record(opcode, start, start + size)
        start += size


class McapReader:
    """Reads the messages of one MCAP file; its end may be missing.

    Args:
        path: Of the file.
        faults: Gets what is wrong with it, without a subject.
        limit: The most bytes of a record, and of what a chunk holds when unpacked.
    """

    def __init__(self, path: Path, faults: list[str], limit: int) -> None:
        self._library = optional_library("mcap.records", "MCAP files")
        self._stream = optional_library("mcap.data_stream", "MCAP files").ReadDataStream
        self._path = path
        self._faults = faults
        self._limit = limit
        self._schemas: dict[int, _Schema] = {}
        self._channels: dict[int, BagTopic] = {}
        self._position = 0  # in the file, of the first byte held
        self._is_over = False

    def messages(self, options: FollowOptions | None) -> Iterator[RawMessage]:
        """Yield the messages, and `NONE_YET` before more of a growing file comes.

        Args:
            options: For a file that grows; None for one that is read to its end.
        """
        is_growing = options is not None
        options = options or FollowOptions()
        held = bytearray()
        head, blocks = head_of(byte_blocks(self._path, options), len(MAGIC))
        require_magic(head, MAGIC, "MCAP")
        for block in blocks:
            held += block
            yield from self._read_whole_records(held)
            if self._is_over:
                return
            if is_growing:
                yield NONE_YET

        # A growing file may end after any record, and anywhere if it is the user who
        # stops.
        if not is_growing or (held and not options.should_stop()):
            self._faults.append("is cut short")

        for record in _records(held):
            # The data are the last part of a chunk.
            if record.opcode == _Opcode.CHUNK:
                data = bytes(held[record.start :])
                yield from self._read_record(record.opcode, data, is_whole=False)

    def _read_whole_records(self, held: bytearray) -> Iterator[RawMessage]:
        """Yield the messages of records that are there whole, and drop their bytes."""
        read_end = 0 if self._position else len(MAGIC)
        for record in _records(held, read_end):
            if self._is_damaged(record):
                self._is_over = True
                position = self._position + read_end
                self._faults.append(
                    f"is damaged at byte {position}; what follows cannot be read"
                )

            if self._is_over or record.end > len(held):
                break

            data = bytes(held[record.start : record.end])
            yield from self._read_record(record.opcode, data)
            read_end = record.end
            self._is_over = record.opcode == _Opcode.DATA_END
            if self._is_over:
                break

        self._position += read_end
        del held[:read_end]

    def _is_damaged(self, record: _Record) -> bool:
        """Return whether bytes that stand for a record cannot be one.

        After a lost byte any bytes stand for a record.

        Raises:
            FormatError: It may be one, but is larger than allowed.
        """
        size = record.end - record.start
        if self._limit < size <= self._path.stat().st_size:
            require_size(size, self._limit, "holds a record that")

        opcode = record.opcode
        is_known = 0 < opcode <= _Opcode.DATA_END or opcode >= _Opcode.PRIVATE
        is_wrong_end = opcode == _Opcode.DATA_END and size != _DATA_END_BYTES
        return not is_known or size > self._limit or is_wrong_end

    def _read_record(
        self, opcode: int, data: bytes, *, is_whole: bool = True
    ) -> Iterator[RawMessage]:
        """Yield the messages in a record; remember schemas and channels."""
        if opcode == _Opcode.MESSAGE:
            message = self._read_message(data)
            if message is not None:
                yield message

            return

        if opcode not in _PARSERS:
            return

        parser = getattr(self._library, _PARSERS[_Opcode(opcode)])
        try:
            content = parser.read(self._stream(io.BytesIO(data)))
        except Exception:
            # Damaged bytes end in whatever the parser runs into.
            if is_whole:
                self._faults.append("has a damaged record")

            return

        if opcode == _Opcode.CHUNK:
            yield from self._read_chunk(content, is_whole=is_whole)
        elif opcode == _Opcode.SCHEMA:
            self._add_schema(content)
        else:
            self._add_channel(content)

    def _add_schema(self, schema: Any) -> None:
        """Remember the type of messages."""
        is_ros = schema.encoding == "ros2msg"
        definition = schema.data.decode(errors="replace") if is_ros else ""
        self._schemas[schema.id] = _Schema(schema.name, definition)

    def _add_channel(self, channel: Any) -> None:
        """Remember the topic of messages."""
        schema = self._schemas.get(channel.schema_id, _Schema("", ""))
        self._channels[channel.id] = BagTopic(
            name=channel.topic,
            kind=schema.kind,
            encoding=channel.message_encoding,
            definition=schema.definition,
        )

    def _read_message(self, data: bytes) -> RawMessage | None:
        """Return the message in a record; None if it is damaged.

        It is read by hand, since the parser of the library takes ten times as long.
        """
        if len(data) >= _MESSAGE_HEAD.size:
            channel, _, log_ns, _ = _MESSAGE_HEAD.unpack_from(data)
            topic = self._channels.get(channel)
            if topic is not None and log_ns <= MAX_STAMP_NS:
                return RawMessage(topic, log_ns, data[_MESSAGE_HEAD.size :])

        if "has damaged messages" not in self._faults:
            self._faults.append("has damaged messages")

        return None

    def _read_chunk(self, chunk: Any, *, is_whole: bool) -> Iterator[RawMessage]:
        """Yield the messages in a chunk, as far as its records are right."""
        data = chunk.data
        size = chunk.uncompressed_size
        require_size(size, self._limit, "holds a chunk that")
        if chunk.compression:
            data = unpack_chunk(data, chunk.compression, size, COMPRESSIONS)

        checksum = chunk.uncompressed_crc
        if is_whole and checksum and crc32(data) != checksum:
            self._faults.append(
                "has a chunk whose checksum is wrong, which was left out"
            )
            return

        read_end = 0
        for record in _records(data):
            if record.end > len(data) or record.opcode == _Opcode.CHUNK:
                break

            content = data[record.start : record.end]
            yield from self._read_record(record.opcode, content)
            read_end = record.end

        if is_whole and read_end < size:
            self._faults.append(
                f"has a damaged chunk, of which {read_end} of {size} bytes are right"
            )
