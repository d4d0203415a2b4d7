"""The messages of one ROS 1 bag, read from its start as far as it goes.

The format, version 2.0, is a sequence of records: a header of named fields, then data,
each with its size. Chunks are records that hold records, compressed or not. The index
at the end is not needed, so a recorder that was killed costs only its last chunk.
"""

import io
import struct
from collections.abc import Iterator, Mapping
from enum import IntEnum
from pathlib import Path
from typing import IO, NamedTuple

from needleforce.recordings.bags.chunks import unpack_chunk
from needleforce.recordings.bags.messages import (
    ROS1,
    BagTopic,
    RawMessage,
    require_magic,
)
from needleforce.recordings.errors import (
    FormatError,
    optional_library,
    require_size,
)
from needleforce.recordings.time_stamps import NS_PER_S

MAGIC = b"#ROSBAG V2.0\n"
"""How the file begins."""

COMPRESSIONS = ("bz2", "lz4")
"""Of chunks, besides none."""

_SIZE = struct.Struct("<I")
_TIME = struct.Struct("<II")


class _Opcode(IntEnum):
    """Numbers of the records that are read."""

    MESSAGE = 0x02
    CHUNK = 0x05
    CONNECTION = 0x07


class _Record(NamedTuple):
    """A record.

    Attributes:
        fields: Of its header, by name.
        data: Its content.
        is_whole: Whether it is all there.
    """

    fields: Mapping[str, bytes]
    data: bytes
    is_whole: bool

    @property
    def opcode(self) -> int:
        """Its number; of damaged bytes any."""
        return int.from_bytes(self.fields.get("op", b""), "little")

    @property
    def connection(self) -> int:
        """The number of the topic that it belongs to."""
        return _SIZE.unpack(self.fields["conn"])[0]

    def text(self, name: str) -> str:
        """Return a field of its header as text."""
        return self.fields[name].decode(errors="replace")


def _fields(header: bytes) -> dict[str, bytes]:
    """Return the fields of a header, `name=value` each, by name.

    Raises:
        ValueError: The bytes are no header.
    """
    fields: dict[str, bytes] = {}
    start = 0
    while start < len(header):
        end = start + _SIZE.size + _SIZE.unpack_from(header, start)[0]
        name, equals, value = header[start + _SIZE.size : end].partition(b"=")
        if not equals or end > len(header):
            raise ValueError("a field without a name")
        fields[name.decode()] = value
        start = end

    return fields


def _records(stream: IO[bytes], limit: int) -> Iterator[_Record]:
    """Yield the records of a stream; the last may be cut short.

    Raises:
        ValueError: The bytes are no records.
        FormatError: One is larger than allowed.
    """
    while head := stream.read(_SIZE.size):
        header = _read_sized(stream, head, limit)
        size = stream.read(_SIZE.size)
        if header is None or len(size) < _SIZE.size:
            yield _Record({}, b"", is_whole=False)
            return

        (length,) = _SIZE.unpack(size)
        require_size(length, limit, "holds a record that")
        data = stream.read(length)
        yield _Record(_fields(header), data, is_whole=len(data) == length)


def _read_sized(stream: IO[bytes], head: bytes, limit: int) -> bytes | None:
    """Return as many bytes as four bytes say; None where the stream ends before."""
    if len(head) < _SIZE.size:
        return None
    (length,) = _SIZE.unpack(head)
    require_size(length, limit, "holds a header that")
    data = stream.read(length)
    return data if len(data) == length else None


class Ros1Reader:
    """Reads the messages of one ROS 1 bag; its end may be missing.

    Args:
        path: Of the file.
        faults: Gets what is wrong with it, without a subject.
        limit: The most bytes of a record, and of what a chunk holds when unpacked.
    """

    def __init__(self, path: Path, faults: list[str], limit: int) -> None:
        self._path = path
        self._faults = faults
        self._limit = limit
        self._topics: dict[int, BagTopic] = {}

    def messages(self) -> Iterator[RawMessage]:
        """Yield the messages in the order of the file."""
        with self._path.open("rb") as stream:
            require_magic(stream.read(len(MAGIC)), MAGIC, "ROS 1 bag (version 2.0)")
            yield from self._read(stream, in_chunk=False)

    def _read(self, stream: IO[bytes], *, in_chunk: bool) -> Iterator[RawMessage]:
        """Yield the messages in the records of a stream, as far as they are right.

        Args:
            stream: Of the file, or of an unpacked chunk.
            in_chunk: Whether it is a chunk, which holds no other.
        """
        try:
            for record in _records(stream, self._limit):
                if not record.is_whole:
                    self._note("has a damaged chunk" if in_chunk else "is cut short")

                yield from self._read_record(record, in_chunk=in_chunk)
        except (ValueError, KeyError, struct.error) as error:
            if isinstance(error, FormatError):
                raise
            self._note("is damaged; what follows the damage in its part is lost")

    def _read_record(self, record: _Record, *, in_chunk: bool) -> Iterator[RawMessage]:
        """Yield the messages in a record; remember topics.

        Raises:
            ValueError: It is damaged, as a chunk within a chunk is.
        """
        if record.opcode == _Opcode.CHUNK:
            if in_chunk:
                raise ValueError("a chunk within a chunk")

            yield from self._read_chunk(record)
        elif record.opcode == _Opcode.CONNECTION and record.is_whole:
            self._add_topic(record)
        elif record.opcode == _Opcode.MESSAGE and record.is_whole:
            yield self._message(record)

    def _note(self, fault: str) -> None:
        """Report a fault once."""
        if fault not in self._faults:
            self._faults.append(fault)

    def _add_topic(self, record: _Record) -> None:
        """Remember the topic of messages."""
        normalize = optional_library(
            "rosbags.typesys.msg", "ROS bags"
        ).normalize_msgtype
        fields = _fields(record.data)
        self._topics[record.connection] = BagTopic(
            name=record.text("topic"),
            kind=normalize(fields["type"].decode()),
            encoding=ROS1,
            definition=fields["message_definition"].decode(errors="replace"),
        )

    def _message(self, record: _Record) -> RawMessage:
        """Return the message in a record."""
        seconds, nanoseconds = _TIME.unpack(record.fields["time"])
        log_ns = seconds * NS_PER_S + nanoseconds
        return RawMessage(self._topics[record.connection], log_ns, record.data)

    def _read_chunk(self, record: _Record) -> Iterator[RawMessage]:
        """Yield the messages in a chunk."""
        compression = record.text("compression")
        data = record.data
        if compression != "none":
            (size,) = _SIZE.unpack(record.fields["size"])
            require_size(size, self._limit, "holds a chunk that")
            data = unpack_chunk(data, compression, size, COMPRESSIONS)
            if record.is_whole and len(data) < size:
                self._note("has a damaged chunk")

        yield from self._read(io.BytesIO(data), in_chunk=True)
