"""The messages of one MCAP file, read from its start as far as it goes.

The streaming reader of the library `mcap` reads records. It is given those that are
there whole, of a file that may still grow; the index at the end is not needed.
"""

import io
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from zlib import crc32

from needleforce.recordings.bags.messages import (
    NONE_YET,
    BagTopic,
    RawMessage,
    require_magic,
    unpack_chunk,
)
from needleforce.recordings.errors import optional_library, require_size
from needleforce.recordings.follow import FollowOptions, byte_blocks, head_of

MAGIC = b"\x89MCAP0\r\n"
"""How the file begins and ends."""

_RECORD_HEAD = struct.Struct("<BQ")
"""Number and size, with which a record begins."""


class McapReader:
    """Reads the messages of one MCAP file; its end may be missing.

    Args:
        path: Of the file.
        faults: Gets what is wrong with it, without a subject.
        limit: The most bytes of a record, and of what a chunk holds when unpacked.
    """

    def __init__(self, path: Path, faults: list[str], limit: int) -> None:
        self._library = optional_library("mcap.stream_reader", "MCAP files")
        self._opcodes = optional_library("mcap.opcode", "MCAP files").Opcode
        self._path = path
        self._faults = faults
        self._limit = limit
        self._schemas: dict[int, Any] = {}
        self._topics: dict[int, BagTopic] = {}
        self._position = 0  # in the file, of the first byte held
        self._is_over = False
        self._is_damaged = False

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
            start = 0 if self._position else len(MAGIC)
            end = self._end_of_whole(held, start)
            yield from self._read(bytes(held[start:end]))
            self._position += end
            if self._is_damaged:
                place = f"is damaged at byte {self._position}"
                self._faults.append(f"{place}; what follows cannot be read")

            del held[:end]
            if self._is_over:
                return
            if is_growing:
                yield NONE_YET

        # A growing file may end after any record, and anywhere if it is the user who
        # stops.
        if not is_growing or (held and not options.should_stop()):
            self._faults.append("is cut short")
        if held[:1] == bytes([self._opcodes.CHUNK]):
            # The data are the last part of a chunk.
            _, size = _RECORD_HEAD.unpack_from(held.ljust(_RECORD_HEAD.size, b"\0"))
            missing = size + _RECORD_HEAD.size - len(held)
            yield from self._read(bytes(held), missing)

    def _end_of_whole(self, held: bytearray, start: int) -> int:
        """Return where the last record ends that is there whole, before any damage."""
        end = start
        while not self._is_over and len(held) - end >= _RECORD_HEAD.size:
            opcode, size = _RECORD_HEAD.unpack_from(held, end)
            self._is_damaged = self._is_no_record(opcode, size)
            if self._is_damaged:
                self._is_over = True
                break
            if end + _RECORD_HEAD.size + size > len(held):
                break

            end += _RECORD_HEAD.size + size
            self._is_over = opcode == self._opcodes.DATA_END

        return end

    def _is_no_record(self, opcode: int, size: int) -> bool:
        """Return whether bytes that stand for a record cannot be one.

        After a lost byte any bytes stand for a record.

        Raises:
            FormatError: It may be one, but is larger than allowed.
        """
        if self._limit < size <= self._path.stat().st_size:
            require_size(size, self._limit, "holds a record that")

        is_private = opcode >= 0x80
        is_known = 0 < opcode <= self._opcodes.DATA_END or is_private
        is_wrong_end = opcode == self._opcodes.DATA_END and size != 4
        return not is_known or size > self._limit or is_wrong_end

    def _records(self, data: bytes) -> Iterator[Any]:
        """Yield the records in bytes, as far as they are right."""
        reader = self._library.StreamReader(
            io.BytesIO(data), skip_magic=True, emit_chunks=True
        )
        try:
            yield from reader.records
        except Exception:
            # The end is an error for the library, as a footer is missing; damaged bytes
            # end in whatever it runs into.
            return

    def _read(self, data: bytes, missing: int = 0) -> Iterator[RawMessage]:
        """Yield the messages in whole records; remember schemas and topics.

        Args:
            data: The records.
            missing: Bytes that the last one, a chunk, lacks at its end.
        """
        library = self._library
        for record in self._records(data + bytes(missing)):
            if isinstance(record, library.Schema):
                self._schemas[record.id] = record
            elif isinstance(record, library.Channel):
                self._add_topic(record)
            elif isinstance(record, library.Message):
                if record.channel_id in self._topics and record.log_time < 1 << 63:
                    topic = self._topics[record.channel_id]
                    yield RawMessage(topic, record.log_time, record.data)
                elif "has damaged messages" not in self._faults:
                    self._faults.append("has damaged messages")
            elif isinstance(record, library.Chunk):
                yield from self._read_chunk(record, missing)

    def _add_topic(self, channel: Any) -> None:
        """Remember the topic of messages."""
        schema = self._schemas.get(channel.schema_id)
        definition = ""
        if schema is not None and schema.encoding == "ros2msg":
            definition = schema.data.decode(errors="replace")

        self._topics[channel.id] = BagTopic(
            name=channel.topic,
            kind=schema.name if schema is not None else "",
            encoding=channel.message_encoding,
            definition=definition,
        )

    def _read_chunk(self, chunk: Any, missing: int) -> Iterator[RawMessage]:
        """Yield the messages in a chunk, as far as its records are right."""
        size = chunk.uncompressed_size
        require_size(size, self._limit, "holds a chunk that")
        data = chunk.data[: max(len(chunk.data) - missing, 0)]
        if missing and not data:
            return
        if chunk.compression:
            data = unpack_chunk(data, chunk.compression, size, ("zstd", "lz4"))

        checksum = chunk.uncompressed_crc
        if not missing and checksum and crc32(data) != checksum:
            self._faults.append(
                "has a chunk whose checksum is wrong, which was left out"
            )
        elif not missing and len(data) < size:
            self._faults.append("has a damaged chunk")
            yield from self._read(data)
        else:
            yield from self._read(data)
