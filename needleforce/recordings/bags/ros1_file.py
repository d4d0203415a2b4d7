"""The messages of one ROS 1 bag, read from its start as far as it goes.

The library `rosbags` parses the records; its own reader refuses a bag whose recorder
was killed, since that has no index.
"""

import io
import os
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

from needleforce.recordings.bags.messages import (
    ROS1,
    BagTopic,
    RawMessage,
    require_magic,
    unpack_chunk,
)
from needleforce.recordings.errors import FormatError, optional_library, require_size

MAGIC = b"#ROSBAG V2.0\n"
"""How the file begins."""


class Ros1Reader:
    """Reads the messages of one ROS 1 bag; its end may be missing.

    Args:
        path: Of the file.
        faults: Gets what is wrong with it, without a subject.
        limit: The most bytes of a record, and of what a chunk holds when unpacked.
    """

    def __init__(self, path: Path, faults: list[str], limit: int) -> None:
        self._library = optional_library("rosbags.rosbag1.reader", "ROS 1 bags")
        self._path = path
        self._faults = faults
        self._limit = limit
        self._topics: dict[int, BagTopic] = {}

    def messages(self) -> Iterator[RawMessage]:
        """Yield the messages in the order of the file."""
        with self._path.open("rb") as stream:
            require_magic(stream.read(len(MAGIC)), MAGIC, "ROS 1 bag (version 2.0)")
            yield from self._read(stream, self._path.stat().st_size, in_chunk=False)

    def _read(
        self, stream: IO[bytes], end: int, *, in_chunk: bool
    ) -> Iterator[RawMessage]:
        """Yield the messages in the records of a stream, as far as they are right.

        Args:
            stream: Of the file, or of an unpacked chunk.
            end: Place of its end.
            in_chunk: Whether it is a chunk, which holds no other.
        """
        reader = self._library
        try:
            while stream.tell() < end:
                header = reader.Header.read(stream)
                size = reader.read_uint32(stream)
                require_size(size, self._limit, "holds a record that")
                data = stream.read(size)
                if len(data) < size:
                    self._note("has a damaged chunk" if in_chunk else "is cut short")

                yield from self._read_record(header, data, size, in_chunk=in_chunk)
        except FormatError:
            raise
        except (reader.ReaderError, ValueError, KeyError, struct.error):
            is_cut = not in_chunk and stream.seek(0, os.SEEK_CUR) >= end
            damage = "is damaged; what follows the damage in its part is lost"
            self._note("is cut short" if is_cut else damage)

    def _note(self, fault: str) -> None:
        """Report a fault once."""
        if fault not in self._faults:
            self._faults.append(fault)

    def _read_record(
        self, header: Any, data: bytes, size: int, *, in_chunk: bool
    ) -> Iterator[RawMessage]:
        """Yield the messages in a record; remember topics.

        Args:
            header: Its fields.
            data: Its content, which may be cut short.
            size: How many bytes it should have.
            in_chunk: Whether it is part of a chunk.

        Raises:
            ValueError: It is damaged, as a chunk within a chunk is.
        """
        operation = int.from_bytes(header.get("op", b""), "little")
        if operation == self._library.RecordType.CHUNK:
            if in_chunk:
                raise ValueError("a chunk within a chunk")

            yield from self._read_chunk(header, data, is_whole=len(data) == size)
        elif len(data) < size:
            return
        elif operation == self._library.RecordType.CONNECTION:
            self._add_topic(header, data)
        elif operation == self._library.RecordType.MSGDATA:
            topic = self._topics[header.get_uint32("conn")]
            yield RawMessage(topic, header.get_time("time"), data)

    def _add_topic(self, header: Any, data: bytes) -> None:
        """Remember the topic of messages."""
        sized = struct.pack("<I", len(data)) + data
        fields = self._library.Header.read(io.BytesIO(sized))
        self._topics[header.get_uint32("conn")] = BagTopic(
            name=header.get_string("topic"),
            kind=self._library.normalize_msgtype(fields.get_string("type")),
            encoding=ROS1,
            definition=fields["message_definition"].decode(errors="replace"),
        )

    def _read_chunk(
        self, header: Any, data: bytes, *, is_whole: bool
    ) -> Iterator[RawMessage]:
        """Yield the messages in a chunk."""
        compression = header.get_string("compression")
        if compression != "none":
            size = header.get_uint32("size")
            require_size(size, self._limit, "holds a chunk that")
            data = unpack_chunk(data, compression, size, ("bz2", "lz4"))
            if is_whole and len(data) < size:
                self._note("has a damaged chunk")

        yield from self._read(io.BytesIO(data), len(data), in_chunk=True)
