"""The messages of a ROS 2 bag as bytes: `rosbags` reads SQLite, `mcap` the records
of MCAP.
"""

import heapq
import io
import re
import struct
from collections.abc import Iterator
from contextlib import suppress
from itertools import chain
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple
from zlib import crc32

from needleforce.recordings.errors import (
    FileAccessError,
    FormatError,
    file_errors,
    optional_library,
    readable_path,
    require_size,
)
from needleforce.recordings.follow import FollowOptions, byte_blocks, head_of

BAG_SUFFIXES = (".mcap", ".db3")
METADATA = "metadata.yaml"  # beside the files of a bag that is a folder
_LATEST_NS = (1 << 63) - 1
_MOST_OPEN = 64  # files
_PARTS = 8  # one chunk or message of a bag may take this fraction (1/8) of the limit


class BagTopic(NamedTuple):
    """A topic of a bag, with the definition of its message type if the bag holds it.

    Attributes:
        kind: Such as sensor_msgs/msg/JointState.
        encoding: Cdr for ROS 2.
    """

    name: str
    kind: str
    encoding: str
    definition: str = ""


class RawMessage(NamedTuple):
    """A serialised message: its topic, when it was recorded on the recorder's clock,
    its bytes.
    """

    topic: BagTopic
    log_ns: int
    data: bytes


NONE_YET = RawMessage(BagTopic("", "", ""), 0, b"")
"""Stands in place of a message wherever more of a growing bag may have to be waited
for."""


def is_bag(path: Path) -> bool:
    """Return whether a path names a ROS 2 bag: by its suffix, or as a folder that
    holds one.
    """
    return path.name.lower().endswith(BAG_SUFFIXES) or (
        path.is_dir() and bool(_storage(path))
    )


def _storage(folder: Path) -> list[Path]:
    """Return the files of messages in a folder; those of a split bag are numbered."""
    with file_errors(folder):
        found = [
            p for p in folder.iterdir() if p.is_file() and p.name.endswith(BAG_SUFFIXES)
        ]
    return sorted(
        found, key=lambda p: [int(x) for x in re.findall(r"\d{1,99}", p.name)] or [0]
    )


def read_messages(
    path: Path, faults: list[str], max_bytes: int, options: FollowOptions | None = None
) -> Iterator[RawMessage]:
    """Read messages as they were recorded; of a damaged or cut MCAP file those that can
    be had.

    `faults` gets what is wrong with the files, one sentence each. With options, a
    growing MCAP file is followed until its recorder finishes it, and `NONE_YET` comes
    each time before more is waited for. A chunk or message may take an eighth of
    `max_bytes` when unpacked.
    """
    optional_library("rosbags.typesys", "ROS 2 bags")

    def messages(file: Path) -> Iterator[RawMessage]:
        found: list[str] = []
        try:
            with file_errors(file):
                if file.name.lower().endswith(".db3"):
                    yield from _sqlite_messages(readable_path(file), found)
                else:
                    yield from _McapReader(file, found, max_bytes // _PARTS).messages(
                        options
                    )
        except FormatError as error:
            raise FormatError(f"{file} {error}") from error
        finally:
            faults.extend(f"{file.name} {fault}" for fault in found)

    found = _storage(path) if path.is_dir() else [path]
    if not found:
        raise FormatError(
            f"{path} is a folder without {' or '.join(BAG_SUFFIXES)} files; those that end in "
            ".zstd must be unpacked: zstd -d"
        )
    files = list(map(messages, found))
    # Files may have been recorded side by side; of a bag split into many, one at a time
    # is open.
    if len(files) > _MOST_OPEN:
        return chain.from_iterable(files)
    return heapq.merge(*files, key=attrgetter("log_ns"))


def _unpacked(packed: bytes, compression: str, size: int) -> bytes:
    """Return what compressed bytes hold as far as it can be had, little more than
    `size` bytes.
    """
    zstd = optional_library("zstandard", "bags compressed with zstd")
    if compression == "zstd":
        stream = zstd.ZstdDecompressor().stream_reader(packed)
    elif compression == "lz4":
        lz4 = optional_library("lz4.frame", "MCAP files with lz4 chunks")
        stream = lz4.open(io.BytesIO(packed))
    else:
        raise FormatError(
            f"has chunks compressed with {compression!r}; zstd and lz4 can be read"
        )
    found = bytearray()
    with suppress(zstd.ZstdError, RuntimeError, EOFError):
        # In blocks: what precedes a damaged place is kept, and a bomb is left before it
        # grows.
        while len(found) <= size and (part := stream.read(1 << 16)):
            found += part
    return bytes(found)


MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")  # number and size, with which a record begins
_MESSAGE_HEAD = struct.Struct(
    "<HIQQ"
)  # channel, sequence, when it was recorded and published
_SCHEMA = 0x03
_CHANNEL = 0x04
_MESSAGE = 0x05
_CHUNK = 0x06
_DATA_END = 0x0F
_PRIVATE = 0x80
"""Numbers of records: none lies between the end of the data and private ones."""
_PARSED = {_SCHEMA: "Schema", _CHANNEL: "Channel", _CHUNK: "Chunk"}


def _records(data: bytes | bytearray, at: int = 0) -> Iterator[tuple[int, int, int]]:
    """Yield number, start and end of the content of records; the last may end behind
    the data.
    """
    while len(data) - at >= _HEAD.size:
        opcode, size = _HEAD.unpack_from(data, at)
        at += _HEAD.size
        yield opcode, at, at + size
        at += size


class _McapReader:
    """Reads the messages of one MCAP file from its start as far as it goes; its end may
    miss.

    A record, and what a chunk holds when unpacked, may have `limit` bytes.
    """

    def __init__(self, path: Path, faults: list[str], limit: int) -> None:
        self._library = optional_library("mcap.records", "MCAP files")
        self._stream = optional_library("mcap.data_stream", "MCAP files").ReadDataStream
        self._path = path
        self._faults = faults
        self._limit = limit
        self._schemas: dict[int, tuple[str, str]] = {}
        self._channels: dict[int, BagTopic] = {}
        self._at = 0
        self._is_over = False

    def messages(self, options: FollowOptions | None) -> Iterator[RawMessage]:
        """Yield the messages, and `NONE_YET` before more of a growing file is waited
        for.
        """
        held = bytearray()
        growing = options is not None
        options = options or FollowOptions()
        head, blocks = head_of(byte_blocks(self._path, options), len(MAGIC))
        _require_magic(head, MAGIC, "MCAP")
        for block in blocks:
            held += block
            yield from self._whole_records(held)
            if self._is_over:
                return
            if growing:
                yield NONE_YET
        # A growing file may end after any record, and anywhere if it is the user who
        # stops.
        if not growing or (held and not options.should_stop()):
            self._faults.append("is cut short")
        for opcode, start, _ in _records(held):
            # The data are the last part of a chunk.
            if opcode == _CHUNK:
                yield from self._taken(opcode, bytes(held[start:]), is_whole=False)

    def _whole_records(self, held: bytearray) -> Iterator[RawMessage]:
        """Take the records that are there whole out of the bytes held."""
        done = 0 if self._at else len(MAGIC)
        for opcode, start, end in _records(held, done):
            size = end - start
            if self._limit < size <= self._path.stat().st_size:
                require_size(size, self._limit, "holds a record that")
            # After a lost byte any bytes stand for a record: no record can be so.
            is_known = 0 < opcode <= _DATA_END or opcode >= _PRIVATE
            if (
                not is_known
                or size > self._limit
                or (opcode == _DATA_END and size != 4)
            ):
                self._is_over = True
                at = self._at + done
                self._faults.append(
                    f"is damaged at byte {at}; what follows cannot be read"
                )
            if self._is_over or end > len(held):
                break
            yield from self._taken(opcode, bytes(held[start:end]))
            done = end
            self._is_over = opcode == _DATA_END
            if self._is_over:
                break
        self._at += done
        del held[:done]

    def _taken(
        self, opcode: int, data: bytes, *, is_whole: bool = True
    ) -> Iterator[RawMessage]:
        """Yield the messages in a record, and learn schemas and channels."""
        if opcode == _MESSAGE:
            if (message := self._message(data)) is not None:
                yield message
            return
        if opcode not in _PARSED:
            return
        try:
            record = getattr(self._library, _PARSED[opcode]).read(
                self._stream(io.BytesIO(data))
            )
        except Exception:
            # Damaged bytes end in whatever the parser runs into.
            self._faults += ["has a damaged record"] * is_whole
            return
        if opcode == _CHUNK:
            yield from self._chunk(record, is_whole=is_whole)
        elif opcode == _SCHEMA:
            text = (
                record.data.decode(errors="replace")
                if record.encoding == "ros2msg"
                else ""
            )
            self._schemas[record.id] = record.name, text
        else:
            kind, text = self._schemas.get(record.schema_id, ("", ""))
            self._channels[record.id] = BagTopic(
                record.topic, kind, record.message_encoding, text
            )

    def _message(self, data: bytes) -> RawMessage | None:
        # By hand, since the parser of the library takes ten times as long.
        if len(data) >= _MESSAGE_HEAD.size:
            channel, _, log_ns, _ = _MESSAGE_HEAD.unpack_from(data)
            topic = self._channels.get(channel)
            if topic is not None and log_ns <= _LATEST_NS:
                return RawMessage(topic, log_ns, data[_MESSAGE_HEAD.size :])
        if "has damaged messages" not in self._faults:
            self._faults.append("has damaged messages")
        return None

    def _chunk(self, chunk: Any, *, is_whole: bool) -> Iterator[RawMessage]:
        data = chunk.data
        size = chunk.uncompressed_size
        require_size(size, self._limit, "holds a chunk that")
        if chunk.compression:
            data = _unpacked(data, chunk.compression, size)[:size]
        if (
            is_whole
            and chunk.uncompressed_crc
            and crc32(data) != chunk.uncompressed_crc
        ):
            self._faults.append(
                "has a chunk whose checksum is wrong, which was left out"
            )
            return
        done = 0
        for opcode, start, end in _records(data):
            if end > len(data) or opcode == _CHUNK:
                break
            yield from self._taken(opcode, data[start:end])
            done = end
        if is_whole and done < size:
            self._faults.append(
                f"has a damaged chunk, of which {done} of {size} bytes are right"
            )


def _require_magic(head: bytes, magic: bytes, what: str) -> None:
    if not head:
        raise FormatError("is empty")
    if not head.startswith(magic[: len(head)]):
        raise FormatError(f"is not an {what} file: it does not begin as one")


_SQLITE_MAGIC = b"SQLite format 3\x00"


def _sqlite_messages(path: Path, faults: list[str]) -> Iterator[RawMessage]:
    """Read an SQLite bag in order of recording; a damaged one is refused."""
    path = path.resolve()
    if set("?#%") & set(str(path)) or not path.suffix.islower():
        # rosbags makes a URI of the path, without quoting.
        raise FileAccessError(
            f"cannot read {path}: a bag in an SQLite file needs a path without ?, # and %, and the "
            "suffix .db3 in small letters; give another name, or use .mcap"
        )
    with path.open("rb") as stream:
        _require_magic(stream.read(len(_SQLITE_MAGIC)), _SQLITE_MAGIC, "SQLite")
    journal = Path(f"{path}-wal")
    if journal.exists() and journal.stat().st_size:
        faults.append(
            f"has messages in {journal.name} that are not read; add them with: "
            f"sqlite3 {path.name} 'PRAGMA wal_checkpoint'"
        )
    rosbag2 = optional_library("rosbags.rosbag2", "ROS 2 bags")
    apsw = optional_library("apsw", "ROS 2 bags")
    damage = (ValueError, TypeError, KeyError, AttributeError, MemoryError)
    try:
        with rosbag2.Reader(path) as reader:
            topics = {found.id: _sqlite_topic(found) for found in reader.connections}
            for connection, log_ns, data in reader.messages():
                # In SQLite any value may stand in any column.
                if type(log_ns) is not int or type(data) is not bytes:
                    raise TypeError(
                        f"{log_ns!r:.40} and {type(data)} for a time stamp and bytes"
                    )
                yield RawMessage(topics[connection.id], log_ns, data)
    except (rosbag2.ReaderError, apsw.Error, *damage) as error:
        if "missing tables" in str(error):
            raise FormatError(
                "is not a bag: it has no tables messages and topics"
            ) from error
        raise FormatError(
            f"is cut short or damaged ({error}); its messages may be had with: "
            f"sqlite3 {path.name} .recover | sqlite3 recovered.db3"
        ) from error


def _sqlite_topic(found: Any) -> BagTopic:
    if not (isinstance(found.topic, str) and isinstance(found.msgtype, str)):
        raise TypeError(f"{found.topic!r:.40} is no name of a topic")
    text = found.msgdef.data if found.msgdef.format.name == "MSG" else ""
    return BagTopic(
        found.topic, found.msgtype, str(found.ext.serialization_format), text
    )
