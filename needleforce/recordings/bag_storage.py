"""The messages of a ROS 2 bag as bytes: its files, MCAP whole, cut or growing, and SQLite.

MCAP is read from its start, without the index at its end, so that a file whose end is missing is
read like any other. `mcap` parses the records, `rosbags` reads SQLite.
"""

import io
import re
import tempfile
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
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
from needleforce.recordings.follow import BLOCK, FollowOptions, byte_blocks

BAG_SUFFIXES = (".mcap", ".db3")
_FILES = (*BAG_SUFFIXES, *(f"{suffix}.zstd" for suffix in BAG_SUFFIXES))
METADATA = "metadata.yaml"
_LONGEST_METADATA = 1 << 20  # bytes
_ALIAS = re.compile(r"(?m)(?:^|[\s\[{,:-])[&*][A-Za-z0-9_]")
"""YAML can refer to itself; what ROS writes does not, and what does can expand to any size."""


class BagTopic(NamedTuple):
    """A topic of a bag.

    Attributes:
        name: such as `/joint_states`.
        kind: its message type, such as `sensor_msgs/msg/JointState`.
        encoding: how messages are serialised; `cdr` for ROS 2.
        definition: the text of the type's definition if the bag holds it, else empty.
        is_idl: whether that text is IDL rather than a `.msg` file.
    """

    name: str
    kind: str
    encoding: str
    definition: str = ""
    is_idl: bool = False


class RawMessage(NamedTuple):
    """A serialised message: its topic, when it was recorded on the recorder's clock, its bytes."""

    topic: BagTopic
    log_ns: int
    data: bytes


NONE_YET = RawMessage(BagTopic("", "", ""), 0, b"")
"""Stands in place of a message wherever a bag that still grows has been read as far as it goes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BagFiles:
    """A bag: one file, or a folder of files that follow each other.

    Attributes:
        paths: the files in order.
        expected: how many messages the metadata speak of; None if there are none.
        warnings: what is wrong with the folder.
    """

    paths: tuple[Path, ...]
    expected: int | None = None
    warnings: tuple[str, ...] = ()


def is_bag(path: Path) -> bool:
    """Return whether a path names a ROS 2 bag: by its suffix, or as a folder that holds one."""
    return path.name.lower().endswith(_FILES) or (path.is_dir() and bool(_storage(path)))


def bag_files(path: Path) -> BagFiles:
    """Find the files of a bag.

    Args:
        path: a `.mcap` or `.db3` file, or a folder of them with or without `metadata.yaml`.

    Raises:
        FileAccessError: it cannot be read.
        FormatError: the folder holds no such file.
    """
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
    expected = metadata.get("message_count")
    return BagFiles(
        paths=paths or tuple(found),
        expected=expected if isinstance(expected, int) else None,
        warnings=warnings,
    )


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
    """Read messages in the order in which they were recorded.

    Args:
        files: the bag.
        faults: what is wrong with its files is appended here, one sentence each.
        max_bytes: a chunk or message may take an eighth of it when unpacked.
        topics: names of those to read; all if None.

    Yields:
        The messages; of a damaged or cut MCAP file those that can be had.

    Raises:
        FileAccessError: a file cannot be read, or a library is missing.
        FormatError: a file is not what its suffix says, is a damaged SQLite file, or holds a part
            that is too large.
    """
    for path in files.paths:
        found: list[str] = []
        with (
            _format_errors(path, found, faults),
            _plain(readable_path(path), found, max_bytes) as plain,
        ):
            if plain.name.lower().endswith(".db3"):
                messages = _sqlite_messages(plain, found, topics)
            else:
                messages = _whole_mcap_messages(plain, found, max_bytes // PART, topics)
            yield from _with_data_unpacked(messages, found, max_bytes // PART)


def growing_messages(
    path: Path,
    options: FollowOptions,
    faults: list[str],
    max_bytes: int,
    topics: Collection[str] | None = None,
) -> Iterator[RawMessage]:
    """Read the messages of an MCAP file as a recorder writes them, until it finishes the file.

    Args:
        path: the file.
        options: how long more is waited for.
        faults: as for `bag_messages`; that the recorder was not done is none if the user stops.
        max_bytes: see `bag_messages`.
        topics: names of those to read; all if None.

    Yields:
        The messages, and `NONE_YET` each time before more is waited for.

    Raises:
        FileAccessError: the file cannot be read, or a library is missing.
        FormatError: it is no MCAP file.
    """
    found: list[str] = []
    with _format_errors(path, found, faults):
        blocks = byte_blocks(path, options, with_pauses=True)
        reader = _McapReader(found, max_bytes // PART, is_growing=True)
        yield from _with_data_unpacked(reader.messages(blocks, topics), found, max_bytes // PART)
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


def _whole_mcap_messages(
    path: Path, faults: list[str], limit: int, topics: Collection[str] | None
) -> Iterator[RawMessage]:
    reader = _McapReader(faults, limit)
    expected = None
    with path.open("rb") as stream:
        expected = reader.read_summary(stream, path.stat().st_size)
        stream.seek(0)
        yield from reader.messages(iter(lambda: stream.read(BLOCK), b""), topics)
    if faults and expected is not None and reader.count < expected:
        faults.append(f"has {reader.count} of {expected} messages left")


def _with_data_unpacked(
    messages: Iterator[RawMessage], faults: list[str], limit: int
) -> Iterator[RawMessage]:
    """Unpack messages that are compressed one by one, which no serialised message looks like."""
    damaged = 0
    for message in messages:
        if not message.data.startswith(_ZSTD_MAGIC):
            yield message
            continue
        data, is_whole = _unpacked(message.data, "zstd", limit)
        require_size(len(data), limit, f"a message of {message.topic.name}")
        if is_whole:
            yield message._replace(data=data)
        damaged += not is_whole
    if damaged:
        faults.append(f"has {damaged} damaged messages")


@contextmanager
def _plain(path: Path, faults: list[str], max_bytes: int) -> Iterator[Path]:
    """Give the file itself, or its content in a temporary file if it is compressed as a whole."""
    if not path.name.endswith(".zstd"):
        yield path
        return
    with tempfile.TemporaryDirectory() as folder:
        plain = Path(folder) / path.name.removesuffix(".zstd")
        size = 0
        with path.open("rb") as source, plain.open("wb") as target:
            stream = _zstandard().ZstdDecompressor().stream_reader(source, read_across_frames=True)
            try:
                while part := stream.read(BLOCK):
                    require_size(size := size + len(part), max_bytes, "as a compressed file")
                    target.write(part)
            except _zstandard().ZstdError:
                faults.append("is cut short or damaged")
        yield plain


_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
MAGIC = b"\x89MCAP0\r\n"
_FOOTER, _MESSAGE, _CHUNK, _DATA_END, _LAST = 0x02, 0x05, 0x06, 0x0F, 0x0F
_PRIVATE = 0x80
"""Records from here on are a recorder's own."""
_END_SIZES = {_FOOTER: 20, _DATA_END: 4}
_HEAD = Struct("<BQ")
_MESSAGE_HEAD = Struct("<HIQQ")
_LATEST_NS = (1 << 63) - 1
_CUT_SHORT = "is cut short"


def _zstandard() -> Any:
    return optional_library("zstandard", "bags compressed with zstd")


def _unpacked(packed: bytes, compression: str, size: int) -> tuple[bytes, bool]:
    """Return what compressed bytes hold, little more than `size` bytes, and whether it is all."""
    if compression == "zstd":
        damage: tuple[type[Exception], ...] = (_zstandard().ZstdError,)
        stream = _zstandard().ZstdDecompressor().stream_reader(packed)
    elif compression == "lz4":
        damage = (RuntimeError, EOFError)
        stream = optional_library("lz4.frame", "MCAP files with lz4 chunks").open(
            io.BytesIO(packed)
        )
    else:
        raise FormatError(f"has chunks compressed with {compression!r}; zstd and lz4 can be read")
    parts: list[bytes] = []
    total = 0
    try:
        # In blocks: what precedes a damaged place is kept, and a bomb is left before it grows.
        while total <= size and (part := stream.read(1 << 16)):
            parts.append(part)
            total += len(part)
    except damage:
        return b"".join(parts), False
    return b"".join(parts), True


class _McapReader:
    """Reads the messages of one MCAP file, as far as they can be read.

    Args:
        faults: what is wrong with the file is appended here, one phrase each.
        limit: the most bytes of a record, and of what a chunk holds when unpacked.
        is_growing: whether the file may end after any record without being cut.
    """

    def __init__(self, faults: list[str], limit: int, *, is_growing: bool = False) -> None:
        self._records = optional_library("mcap.stream_reader", "MCAP files")
        self._faults, self._limit, self._is_growing = faults, limit, is_growing
        self._schemas: dict[int, BagTopic] = {}
        self._topics: dict[int, BagTopic] = {}
        self._damaged = 0
        self.count = 0
        """Messages so far, of any topic."""

    def read_summary(self, stream: io.BufferedReader, size: int) -> int | None:
        """Learn types and topics from the end of the file; the chunk that held them may be damaged.

        Returns:
            How many messages the file should hold; None if it was not finished.
        """
        library = optional_library("mcap.reader", "MCAP files")
        try:
            reader = library.SeekingReader(stream, record_size_limit=min(size, self._limit))
            summary = reader.get_summary()
        except Exception:
            # A cut file: whatever stands at its end is no summary.
            return None
        for record in (*summary.schemas.values(), *summary.channels.values()):
            self._learn(record)
        return summary.statistics.message_count if summary.statistics else None

    def messages(
        self, blocks: Iterable[bytes], topics: Collection[str] | None
    ) -> Iterator[RawMessage]:
        """Yield the messages of some topics, `NONE_YET` for each empty block."""
        for opcode, body, is_whole in self._framed(blocks):
            if not opcode:
                yield NONE_YET
            for inner, part in self._contents(opcode, body, is_whole):
                message = self._message(inner, part)
                if message is not None and (topics is None or message.topic.name in topics):
                    yield message
        if self._damaged:
            self._faults.append(
                f"has {self._damaged} damaged messages, or messages whose topic is not known"
            )

    def _framed(self, blocks: Iterable[bytes]) -> Iterator[tuple[int, bytes, bool]]:
        """Yield opcode, bytes and whether they are whole of each record; opcode 0 for a pause."""
        held, at = bytearray(), 0
        is_ours = False
        for block in blocks:
            if not block:
                yield 0, b"", True
                continue
            held += block
            if not is_ours and len(held) >= len(MAGIC):
                is_ours = held.startswith(MAGIC)
                if not is_ours:
                    break
                at = len(MAGIC)
                del held[:at]
            while is_ours and len(held) >= _HEAD.size:
                opcode, size = _HEAD.unpack_from(held)
                end = _HEAD.size + size
                if opcode in _END_SIZES and size == _END_SIZES[opcode]:
                    return
                if not self._is_possible(opcode, size):
                    self._faults.append(f"is damaged at byte {at}; what follows cannot be read")
                    return
                if len(held) < end:
                    break
                yield opcode, bytes(held[_HEAD.size : end]), True
                del held[:end]
                at += end
        if not is_ours:
            held_any = bool(held)
            raise FormatError(
                "is not an MCAP file: it does not begin as one" if held_any else "is empty"
            )
        if held or not self._is_growing:
            self._faults.append(_CUT_SHORT)
        if len(held) > _HEAD.size:
            yield held[0], bytes(held[_HEAD.size :]), False

    def _is_possible(self, opcode: int, size: int) -> bool:
        """Return whether a record can be one; after a lost byte any number stands for its size."""
        if opcode in _END_SIZES or not opcode > 0:
            return False
        if _LAST < opcode < _PRIVATE:
            return False
        if size > 1 << 48:
            return False
        require_size(size, self._limit, "holds a record that")
        return True

    def _contents(self, opcode: int, body: bytes, is_whole: bool) -> Iterator[tuple[int, bytes]]:
        """Yield the records in a chunk, or the record itself."""
        if opcode != _CHUNK:
            if opcode and is_whole:
                yield opcode, body
            return
        try:
            stream = self._records.ReadDataStream(io.BytesIO(body))
            chunk = self._records.Chunk.read(stream)
        except Exception:
            self._faults += ["has a damaged chunk"] * is_whole
            return
        data, is_right = self._chunk_data(chunk, is_whole)
        at = 0
        while is_right and at + _HEAD.size <= len(data):
            inner, size = _HEAD.unpack_from(data, at)
            start, end = at + _HEAD.size, at + _HEAD.size + size
            if end > len(data):
                break
            yield inner, data[start:end]
            at = end
        if is_right and is_whole and at < chunk.uncompressed_size:
            self._faults.append(
                f"has a damaged chunk, of which {at} of {chunk.uncompressed_size} bytes are right"
            )

    def _chunk_data(self, chunk: Any, is_whole: bool) -> tuple[bytes, bool]:
        """Unpack a chunk as far as it goes; False if its checksum shows that it is wrong."""
        size = chunk.uncompressed_size
        require_size(size, self._limit, "holds a chunk that")
        if not chunk.compression:
            data = chunk.data
        else:
            data, _ = _unpacked(chunk.data, chunk.compression, size)
        crc = chunk.uncompressed_crc
        if is_whole and crc and len(data) == size and crc32(data) != crc:
            self._faults.append("has a chunk whose checksum is wrong, which was left out")
            return b"", False
        return data[:size], True

    def _message(self, opcode: int, body: bytes) -> RawMessage | None:
        if opcode != _MESSAGE:
            try:
                stream = io.BytesIO(_HEAD.pack(opcode, len(body)) + body)
                reader = self._records.StreamReader(stream, skip_magic=True)
                self._learn(next(iter(reader.records), None))
            except Exception:
                # A damaged schema or channel: its messages are counted as damaged.
                return None
            return None
        if len(body) < _MESSAGE_HEAD.size:
            self._damaged += 1
            return None
        number, _, log_ns, _ = _MESSAGE_HEAD.unpack_from(body)
        topic = self._topics.get(number)
        if topic is None or log_ns > _LATEST_NS:
            self._damaged += 1
            return None
        self.count += 1
        return RawMessage(topic, log_ns, body[_MESSAGE_HEAD.size :])

    def _learn(self, record: Any) -> None:
        if isinstance(record, self._records.Schema):
            definition = record.data.decode(errors="replace")
            is_idl = record.encoding in ("ros2idl", "omgidl")
            self._schemas[record.id] = BagTopic("", record.name, "", definition, is_idl)
        elif isinstance(record, self._records.Channel):
            schema = self._schemas.get(record.schema_id) or BagTopic("", "", "")
            self._topics[record.id] = schema._replace(
                name=record.topic, encoding=record.message_encoding
            )


_SQLITE_MAGIC = b"SQLite format 3\x00"
_RECOVER = "its messages may be had with: sqlite3 {name} .recover | sqlite3 recovered.db3"


def _sqlite_messages(
    path: Path, faults: list[str], topics: Collection[str] | None
) -> Iterator[RawMessage]:
    """Read an SQLite bag in order of recording; a damaged one is refused."""
    _check_sqlite(path, faults)
    rosbag2 = optional_library("rosbags.rosbag2", "ROS 2 bags")
    apsw = optional_library("apsw", "ROS 2 bags")
    recover = _RECOVER.format(name=path.name)
    unfit = 0
    try:
        with rosbag2.Reader(path) as reader:
            known = {}
            for found in reader.connections:
                if isinstance(found.topic, str) and isinstance(found.msgtype, str):
                    known[found.id] = BagTopic(
                        found.topic,
                        found.msgtype,
                        str(found.ext.serialization_format),
                        found.msgdef.data,
                        found.msgdef.format.name == "IDL",
                    )
                else:
                    faults.append(f"has a topic, number {found.id}, whose name or type is no text")
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
    except rosbag2.ReaderError as error:
        if "missing tables" in str(error):
            raise FormatError("is not a bag: it has no tables messages and topics") from error
        raise FormatError(f"is damaged ({error}); {recover}") from error
    except (apsw.Error, ValueError, TypeError, KeyError, AttributeError, MemoryError) as error:
        raise FormatError(f"is damaged ({error}); {recover}") from error
    if unfit:
        faults.append(f"has {unfit} messages whose time stamp or data are of another type")


def _check_sqlite(path: Path, faults: list[str]) -> None:
    """Refuse a file that was cut, which SQLite does not always see.

    The layout of its header is that of https://sqlite.org/fileformat2.html.
    """
    with path.open("rb") as stream:
        head = stream.read(100)
    if not head.startswith(_SQLITE_MAGIC):
        begins = len(head) < len(_SQLITE_MAGIC) and _SQLITE_MAGIC.startswith(head)
        what = "is cut short" if begins else "is not an SQLite file: it does not begin as one"
        raise FormatError(what if head else "is empty")
    page = int.from_bytes(head[16:18], "big")
    pages = int.from_bytes(head[28:32], "big")
    if len(head) < 100 or (65536 if page == 1 else page) * pages > path.stat().st_size:
        raise FormatError(f"is cut short; {_RECOVER.format(name=path.name)}")
    journal = Path(f"{path}-wal")
    if journal.exists() and journal.stat().st_size:
        faults.append(
            f"has messages in {journal.name} that are not read; add them with: "
            f"sqlite3 {path.name} 'PRAGMA wal_checkpoint'"
        )
