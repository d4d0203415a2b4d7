"""The messages of a ROS 2 bag as bytes: `rosbags` reads SQLite, `mcap` parses MCAP records."""

import io
import re
import tempfile
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from struct import Struct
from typing import Any, NamedTuple
from zlib import crc32

from needleforce.recordings.errors import (
    PART,
    FileAccessError,
    FormatError,
    file_errors,
    optional_library,
    readable_path,
    require_size,
)
from needleforce.recordings.follow import BLOCK, FollowOptions, byte_blocks, unpacked

BAG_SUFFIXES = (".mcap", ".db3")
_FILES = (*BAG_SUFFIXES, *(f"{suffix}.zstd" for suffix in BAG_SUFFIXES))
METADATA = "metadata.yaml"
_LONGEST_METADATA = 1 << 20  # bytes
_ALIAS = re.compile(r"(?m)(?:^|[\s\[{,:-])[&*][A-Za-z0-9_]")
"""YAML can refer to itself; what ROS writes does not, and what does can expand to any size."""


class BagTopic(NamedTuple):
    """A topic of a bag, with the definition of its message type if the bag holds it."""

    name: str
    kind: str  # such as sensor_msgs/msg/JointState
    encoding: str  # cdr for ROS 2
    definition: str = ""
    is_idl: bool = False  # rather than a .msg file


class RawMessage(NamedTuple):
    """A serialised message: its topic, when it was recorded on the recorder's clock, its bytes."""

    topic: BagTopic
    log_ns: int
    data: bytes


NONE_YET = RawMessage(BagTopic("", "", ""), 0, b"")
"""Stands in place of a message wherever a bag that still grows has been read as far as it goes."""


class BagFiles(NamedTuple):
    """A bag: one file, or a folder of files that follow each other."""

    paths: tuple[Path, ...]
    expected: int | None = None  # messages, as the metadata say
    warnings: tuple[str, ...] = ()


def is_bag(path: Path) -> bool:
    """Return whether a path names a ROS 2 bag: by its suffix, or as a folder that holds one."""
    return path.name.lower().endswith(_FILES) or (path.is_dir() and bool(_storage(path)))


def bag_files(path: Path) -> BagFiles:
    """Find the files of a bag: a `.mcap` or `.db3` file, or those in a folder."""
    if not path.is_dir():
        return BagFiles(paths=(path,))
    found = _storage(path)
    if not found:
        raise FormatError(f"{path} is a folder without {' or '.join(BAG_SUFFIXES)} files")
    metadata, warnings = _metadata(path / METADATA)
    listed = metadata.get("relative_file_paths")
    names = [Path(str(name)).name for name in listed] if isinstance(listed, list) else []
    here = {file.name: file for file in found}
    paths = tuple(here[name] for name in dict.fromkeys(names) if name in here)
    if paths and (missing := [name for name in names if name not in here]):
        warnings += (f"files of the bag that are missing: {', '.join(missing)}",)
    count = metadata.get("message_count")
    return BagFiles(paths or tuple(found), count if isinstance(count, int) else None, warnings)


def _storage(folder: Path) -> list[Path]:
    """Return the files of messages in a folder, numbers in their names in order of size."""
    with file_errors(folder):
        found = [p for p in folder.iterdir() if p.is_file() and p.name.endswith(_FILES)]
    return sorted(found, key=lambda p: [int(x) for x in re.findall(r"\d{1,99}", p.name)] or [0])


def _metadata(path: Path) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Return what `metadata.yaml` says; a bag can be read without it."""
    if not path.exists():
        return {}, (f"the bag has no {METADATA}: its recorder did not finish it",)
    yaml = optional_library("ruamel.yaml", "bags in folders")
    try:
        if not path.is_file() or path.stat().st_size > _LONGEST_METADATA:
            raise ValueError("it is no file, or too long")
        text = path.read_text(encoding="utf-8")
        if _ALIAS.search(text):
            raise ValueError("it refers to itself")
        information = yaml.YAML(typ="safe").load(text)["rosbag2_bagfile_information"]
        return dict(information), ()
    except (OSError, ValueError, TypeError, KeyError, RecursionError, yaml.error.YAMLError):
        return {}, (f"{METADATA} is damaged and was left aside",)


def bag_messages(
    files: BagFiles, faults: list[str], max_bytes: int, topics: Collection[str] | None = None
) -> Iterator[RawMessage]:
    """Read messages as they were recorded; of a damaged or cut MCAP file those that can be had.

    What is wrong with the files is appended to `faults`, one sentence each. A chunk or message may
    take an eighth of `max_bytes` when unpacked. Only some topics are read, all if None.
    """
    limit = max_bytes // PART
    for path in files.paths:
        found: list[str] = []
        with (
            _format_errors(path, found, faults),
            _plain(readable_path(path), found, max_bytes) as plain,
        ):
            if plain.name.lower().endswith(".db3"):
                yield from _with_data_unpacked(_sqlite_messages(plain, found, topics), found, limit)
                continue
            reader = _McapReader(found, limit)
            with plain.open("rb") as stream:
                reader.read_summary(stream, plain.stat().st_size)
                stream.seek(0)
                blocks = iter(lambda stream=stream: stream.read(BLOCK), b"")
                yield from _with_data_unpacked(reader.messages(blocks, topics), found, limit)


def growing_messages(
    path: Path,
    options: FollowOptions,
    faults: list[str],
    max_bytes: int,
    topics: Collection[str] | None = None,
) -> Iterator[RawMessage]:
    """Read an MCAP file as a recorder writes it, until it is finished, see `bag_messages`.

    Yields `NONE_YET` each time before more is waited for. That the recorder was not done is no
    fault if the user stops.
    """
    found: list[str] = []
    with _format_errors(path, found, faults):
        blocks = byte_blocks(path, options, with_pauses=True)
        messages = _McapReader(found, max_bytes // PART, is_growing=True).messages(blocks, topics)
        yield from _with_data_unpacked(messages, found, max_bytes // PART)
        if options.should_stop() and _CUT_SHORT in found:
            found.remove(_CUT_SHORT)


@contextmanager
def _format_errors(path: Path, found: list[str], faults: list[str]) -> Iterator[None]:
    """Name the file in errors, and in what was found to be wrong with it."""
    try:
        with file_errors(path):
            yield
    except FormatError as error:
        raise FormatError(f"{path} {error}") from error
    finally:
        faults += [f"{path.name} {fault}" for fault in found]


def _with_data_unpacked(
    messages: Iterator[RawMessage], faults: list[str], limit: int
) -> Iterator[RawMessage]:
    """Unpack messages that are compressed one by one, which no serialised message looks like."""
    damaged = 0
    for message in messages:
        if not message.data.startswith(_ZSTD_MAGIC):
            yield message
            continue
        data, is_whole = unpacked(message.data, "zstd", limit)
        require_size(len(data), limit, f"a message of {message.topic.name}")
        damaged += not is_whole
        if is_whole:
            yield message._replace(data=data)
    if damaged:
        faults.append(f"has {damaged} damaged messages")


@contextmanager
def _plain(path: Path, faults: list[str], max_bytes: int) -> Iterator[Path]:
    """Give the file itself, or its content in a temporary file if it is compressed as a whole."""
    is_packed = path.name.endswith(".zstd")
    # rosbags makes a URI of an SQLite file's path without quoting it, and takes no .DB3.
    if path.suffix.islower() and not (is_packed or set("?#%") & set(str(path.absolute()))):
        yield path
        return
    with tempfile.TemporaryDirectory() as folder:
        plain = Path(folder) / f"bag{Path(path.name.removesuffix('.zstd')).suffix.lower()}"
        if not is_packed:
            plain.symlink_to(path.absolute())
            yield plain
            return
        zstd, size = optional_library("zstandard", "bags compressed with zstd"), 0
        with path.open("rb") as source, plain.open("wb") as target:
            stream = zstd.ZstdDecompressor().stream_reader(source, read_across_frames=True)
            try:
                while part := stream.read(BLOCK):
                    require_size(size := size + len(part), max_bytes, "as a compressed file")
                    target.write(part)
            except zstd.ZstdError:
                faults.append("is cut short or damaged")
        yield plain


MAGIC = b"\x89MCAP0\r\n"
_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK = 0x03, 0x04, 0x05, 0x06
_END_SIZES = {0x02: 20, 0x0F: 4}
"""The footer and the end of the data, with their sizes: the regular end."""
_LAST, _PRIVATE = 0x0F, 0x80
"""No record has a number between these."""
_HEAD = Struct("<BQ")
_MESSAGE_HEAD = Struct("<HIQQ")
_LATEST_NS = (1 << 63) - 1
_CUT_SHORT = "is cut short"


class _McapReader:
    """Reads the messages of one MCAP file from its start as far as it goes; its end may miss.

    A record, and what a chunk holds when unpacked, may have `limit` bytes. A file that is growing
    may end after any record without being cut.
    """

    def __init__(self, faults: list[str], limit: int, *, is_growing: bool = False) -> None:
        self._library = optional_library("mcap.stream_reader", "MCAP files")
        self._faults, self._limit, self._is_growing = faults, limit, is_growing
        self._schemas: dict[int, BagTopic] = {}
        self._topics: dict[int, BagTopic] = {}
        self._damaged = self._size = 0

    def read_summary(self, stream: io.BufferedReader, size: int) -> None:
        """Learn topics from the end of the file; the chunk that held them may be damaged."""
        library, self._size = optional_library("mcap.reader", "MCAP files"), size
        # A file that was cut has no summary: whatever stands at its end is none.
        with suppress(Exception):
            limit = min(size, self._limit)
            summary = library.SeekingReader(stream, record_size_limit=limit).get_summary()
            for record in (*summary.schemas.values(), *summary.channels.values()):
                self._learn(record)

    def messages(
        self, blocks: Iterable[bytes], topics: Collection[str] | None
    ) -> Iterator[RawMessage]:
        """Yield the messages of some topics, `NONE_YET` for each empty block."""
        for opcode, body, is_whole in self._records(blocks):
            if opcode:
                yield from self._wanted(opcode, body, topics, is_whole=is_whole)
            else:
                yield NONE_YET
        if self._damaged:
            self._faults.append(
                f"has {self._damaged} damaged messages, or messages whose topic is not known"
            )

    def _records(self, blocks: Iterable[bytes]) -> Iterator[tuple[int, bytes, bool]]:
        """Yield number and content of each record, and whether it is whole; 0 for a pause."""
        held, at = bytearray(), 0
        for block in blocks:
            if not block:
                yield 0, b"", True
            held += block
            if not at and len(held) >= len(MAGIC):
                _require_mcap(held)
                at = len(MAGIC)
                del held[:at]
            while at and len(held) >= _HEAD.size:
                end = self._end(held, at)
                if not end:
                    return
                if end > len(held):
                    break
                yield held[0], bytes(held[_HEAD.size : end]), True
                del held[:end]
                at += end
        yield from self._rest(held, at)

    def _rest(self, held: bytearray, at: int) -> Iterator[tuple[int, bytes, bool]]:
        """Say that the file is cut, and yield the piece of a chunk at its end."""
        if not at:
            _require_mcap(held)
        if held or not self._is_growing:
            self._faults.append(_CUT_SHORT)
        if len(held) > _HEAD.size and held[0] == _CHUNK:
            yield _CHUNK, bytes(held[_HEAD.size :]), False

    def _end(self, held: bytearray, at: int) -> int:
        """Return where the next record ends, beyond `held` if it has not come; 0 if none follows.

        After a lost byte any number stands for a record and its size.
        """
        opcode, size = _HEAD.unpack_from(held)
        if _END_SIZES.get(opcode) == size:
            return 0
        is_known = 0 < opcode <= _LAST or opcode >= _PRIVATE
        if not is_known or opcode in _END_SIZES or size > max(self._limit, self._size):
            self._faults.append(f"is damaged at byte {at}; what follows cannot be read")
            return 0
        require_size(size, self._limit, "holds a record that")
        return _HEAD.size + size

    def _wanted(
        self, opcode: int, body: bytes, topics: Collection[str] | None, *, is_whole: bool
    ) -> Iterator[RawMessage]:
        """Yield the messages in a record, and learn schemas and channels."""
        if opcode == _CHUNK:
            for inner, part in self._chunk_records(body, is_whole):
                if inner != _CHUNK:
                    yield from self._wanted(inner, part, topics, is_whole=True)
        elif opcode == _MESSAGE:
            message = self._message(body)
            if message is not None and (topics is None or message.topic.name in topics):
                yield message
        elif opcode in (_SCHEMA, _CHANNEL):
            kind = self._library.Schema if opcode == _SCHEMA else self._library.Channel
            # A damaged one is left out: its messages are counted as damaged.
            with suppress(Exception):
                self._learn(kind.read(self._library.ReadDataStream(io.BytesIO(body))))

    def _chunk_records(self, body: bytes, is_whole: bool) -> Iterator[tuple[int, bytes]]:
        try:
            chunk = self._library.Chunk.read(self._library.ReadDataStream(io.BytesIO(body)))
        except Exception:
            self._faults += ["has a damaged chunk"] * is_whole
            return
        data, size = chunk.data, chunk.uncompressed_size
        require_size(size, self._limit, "holds a chunk that")
        if chunk.compression:
            data = unpacked(data, chunk.compression, size)[0][:size]
        crc = chunk.uncompressed_crc
        if is_whole and crc and len(data) == size and crc32(data) != crc:
            self._faults.append("has a chunk whose checksum is wrong, which was left out")
            return
        at = 0
        while at + _HEAD.size <= len(data):
            opcode, length = _HEAD.unpack_from(data, at)
            start, end = at + _HEAD.size, at + _HEAD.size + length
            if end > len(data):
                break
            yield opcode, data[start:end]
            at = end
        if is_whole and at < size:
            self._faults.append(f"has a damaged chunk, of which {at} of {size} bytes are right")

    def _message(self, body: bytes) -> RawMessage | None:
        """Return a message, or None if it cannot be one."""
        topic, log_ns = None, 0
        if len(body) >= _MESSAGE_HEAD.size:
            number, _, log_ns, _ = _MESSAGE_HEAD.unpack_from(body)
            topic = self._topics.get(number)
        if topic is None or log_ns > _LATEST_NS:
            self._damaged += 1
            return None
        return RawMessage(topic, log_ns, body[_MESSAGE_HEAD.size :])

    def _learn(self, record: Any) -> None:
        if isinstance(record, self._library.Schema):
            definition = record.data.decode(errors="replace")
            is_idl = record.encoding in ("ros2idl", "omgidl")
            self._schemas[record.id] = BagTopic("", record.name, "", definition, is_idl)
        else:
            schema = self._schemas.get(record.schema_id) or BagTopic("", "", "")
            self._topics[record.id] = schema._replace(
                name=record.topic, encoding=record.message_encoding
            )


def _require_mcap(head: bytearray) -> None:
    if not head.startswith(MAGIC):
        raise FormatError("is not an MCAP file: it does not begin as one" if head else "is empty")


_SQLITE_MAGIC = b"SQLite format 3\x00"


def _sqlite_messages(
    path: Path, faults: list[str], topics: Collection[str] | None
) -> Iterator[RawMessage]:
    """Read an SQLite bag in order of recording; a damaged one is refused."""
    name = path.resolve().name
    recover = f"its messages may be had with: sqlite3 {name} .recover | sqlite3 recovered.db3"
    _check_sqlite(path.resolve(), faults, recover)
    rosbag2 = optional_library("rosbags.rosbag2", "ROS 2 bags")
    apsw = optional_library("apsw", "ROS 2 bags")
    unfit = 0
    try:
        with rosbag2.Reader(path) as reader:
            known = _sqlite_topics(reader, faults)
            wanted = [
                c
                for c in reader.connections
                if c.id in known and (topics is None or known[c.id].name in topics)
            ]
            for connection, log_ns, data in reader.messages(wanted) if wanted else ():
                if isinstance(log_ns, int) and isinstance(data, bytes):
                    yield RawMessage(known[connection.id], log_ns, data)
                else:
                    unfit += 1
    except (FileAccessError, FormatError):
        raise
    except (
        *(rosbag2.ReaderError, apsw.Error),
        *(ValueError, TypeError, KeyError, AttributeError, MemoryError),
    ) as error:
        if "missing tables" in str(error):
            raise FormatError("is not a bag: it has no tables messages and topics") from error
        raise FormatError(f"is damaged ({error}); {recover}") from error
    if unfit:
        faults.append(f"has {unfit} messages whose time stamp or data are of another type")


def _sqlite_topics(reader: Any, faults: list[str]) -> dict[int, BagTopic]:
    known = {}
    for found in reader.connections:
        if isinstance(found.topic, str) and isinstance(found.msgtype, str):
            encoding, is_idl = found.ext.serialization_format, found.msgdef.format.name == "IDL"
            known[found.id] = BagTopic(
                found.topic, found.msgtype, str(encoding), found.msgdef.data, is_idl
            )
        else:
            faults.append(f"has a topic, number {found.id}, whose name or type is no text")
    return known


def _check_sqlite(path: Path, faults: list[str], recover: str) -> None:
    """Refuse a file that was cut, which its header shows (https://sqlite.org/fileformat2.html)."""
    with path.open("rb") as stream:
        head = stream.read(100)
    if not head.startswith(_SQLITE_MAGIC[: len(head)]):
        raise FormatError("is not an SQLite file: it does not begin as one")
    if not head:
        raise FormatError("is empty")
    page, pages = int.from_bytes(head[16:18], "big"), int.from_bytes(head[28:32], "big")
    if len(head) < 100 or (65536 if page == 1 else page) * pages > path.stat().st_size:
        raise FormatError(f"is cut short; {recover}")
    journal = Path(f"{path}-wal")
    if journal.exists() and journal.stat().st_size:
        faults.append(
            f"has messages in {journal.name} that are not read; add them with: "
            f"sqlite3 {path.name} 'PRAGMA wal_checkpoint'"
        )
