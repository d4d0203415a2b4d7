"""ROS bags as a table: topics are columns, each with the stamps of its messages.

`rosbags` reads the files (.bag, .db3, .mcap).
"""

import re
from array import array
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import fields, is_dataclass, replace
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory, mkdtemp
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from needleforce.recordings.errors import (
    FormatError,
    UnpackedSize,
    damage_errors,
    file_errors,
    optional_library,
)
from needleforce.recordings.table import MAX_LIST_NUMBERS, Table
from needleforce.recordings.time_stamps import NS_PER_S
from needleforce.recordings.writers import standard_types

BAG_SUFFIXES = (".mcap", ".db3", ".bag", ".mcap.zstd", ".db3.zstd")
METADATA = "metadata.yaml"


def is_bag(path: Path) -> bool:
    """Return whether a path names a ROS bag: by its suffix, or as a folder of one."""
    has_suffix = path.name.lower().endswith(BAG_SUFFIXES)
    return has_suffix or (path.is_dir() and bool(_files_in(path)))


def _files_in(folder: Path) -> list[Path]:
    """Return the files of messages in a folder; those of a split bag are numbered."""
    files = [each for each in folder.iterdir() if each.name.endswith(BAG_SUFFIXES)]
    return sorted(
        files, key=lambda p: [int(n) for n in re.findall(r"\d{1,99}", p.name)]
    )


class _Signal(NamedTuple):
    """Numbers of a message.

    Attributes:
        path: The fields that lead to them.
        values: The numbers, a single one or shape (k,).
        joints: That they belong to; none where the message does not say.
    """

    path: tuple[str, ...]
    values: Any
    joints: tuple[str, ...] = ()


def _signals(topic: str, message: Any) -> dict[str, _Signal]:
    """Return the signals of a message by the names of their columns."""
    is_stamped = message.__msgtype__.endswith("Stamped")
    signals: dict[str, _Signal] = {}
    for signal in _numbers_in(message):
        path = signal.path[1:] or signal.path if is_stamped else signal.path
        column = topic if path == ("data",) else "/".join((topic, *path))
        signals[column] = signal

    return signals


def _numbers_in(message: Any, path: tuple[str, ...] = ()) -> Iterator[_Signal]:
    """Yield the numbers of a message: single ones, vectors and arrays."""
    values = {
        f.name: getattr(message, f.name)
        for f in fields(message)
        if not f.name.startswith("__") and f.name not in ("header", "stamp", "seq")
    }
    axes = "".join(values)
    if axes in ("xyzw", "xyz", "xy"):
        yield _Signal((*path[:-1], "_".join((*path[-1:], axes))), [*values.values()])
        return

    names = values.get("name")
    joints = tuple(names) if isinstance(names, list) else ()
    if not all(joints) or len({*joints}) < len(joints):
        joints = ()

    for name, value in values.items():
        if is_dataclass(value):
            yield from _numbers_in(value, (*path, name))
        elif isinstance(value, int | float | np.ndarray):
            are_of_joints = np.shape(value) == (len(joints),)
            yield _Signal((*path, name), value, joints if are_of_joints else ())


def _recover(path: Path, target: Path) -> None:
    """Copy the messages of an MCAP without its end, as far as they go."""
    library = optional_library("mcap.reader", "cut MCAP files")
    writer = optional_library("mcap.writer", "cut MCAP files").Writer(str(target))
    writer.start("ros2")
    channels: dict[int, int] = {}
    with path.open("rb") as stream, suppress(Exception):  # whatever the end becomes
        reader = library.NonSeekingReader(stream, record_size_limit=path.stat().st_size)
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            if channel.id not in channels:
                schema_id = writer.register_schema(
                    schema.name, schema.encoding, schema.data
                )
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, schema_id, channel.metadata
                )
            writer.add_message(
                channels[channel.id],
                message.log_time,
                message.data,
                message.publish_time,
            )

    writer.finish()


def _whole_file(
    file: Path, folder: Path, notes: list[str], unpacked: UnpackedSize
) -> Path:
    """Return a file of messages that is neither packed nor cut short.

    Args:
        file: As it was found.
        folder: Gets what is unpacked, or what is left of a file that was cut short.
        notes: Get one on a file that was.
        unpacked: Counts what is unpacked.

    Raises:
        FormatError: The recording is too large.
    """
    magic = b"\x89MCAP0\r\n"
    if file.suffix == ".zstd":
        library = optional_library("zstandard", "compressed bags")
        target = Path(mkdtemp(dir=folder), file.stem)
        with file.open("rb") as packed, target.open("wb") as stream:
            for chunk in library.ZstdDecompressor().read_to_iter(packed):
                unpacked.add(len(chunk), file)
                stream.write(chunk)

        file = target

    with file.open("rb") as stream:
        if stream.read(len(magic)) != magic:
            return file

        stream.seek(-len(magic), 2)
        if stream.read() == magic:
            return file

    notes.append(f"{file.name} is cut short; it was read up to there")
    whole = Path(mkdtemp(dir=folder), file.name)
    _recover(file, whole)
    return whole


@contextmanager
def _open_bag(
    paths: Sequence[Path], notes: list[str], unpacked: UnpackedSize
) -> Iterator[Any]:
    """Open the files of a bag with rosbags; `FormatError` if it is none, or damaged.

    Args:
        paths: Files of the bag, or folders of such.
        notes: Get one on each file that was cut short.
        unpacked: Counts what is unpacked.
    """
    library = optional_library("rosbags.highlevel", "ROS bags")
    readable: list[Path] = []
    with (
        TemporaryDirectory() as folder,
        file_errors(paths[0]),
        damage_errors(paths[0], "bag"),
    ):
        for path in paths:
            files = _files_in(path) if path.is_dir() else [path]
            whole = [_whole_file(f, Path(folder), notes, unpacked) for f in files]
            # The metadata of a folder fit its files as they are.
            is_bag_folder = whole == files and (path / METADATA).exists()
            readable += [path] if is_bag_folder else whole

        with library.AnyReader(readable, default_typestore=standard_types()) as reader:
            yield reader


def _messages(reader: Any, topic: str) -> Iterator[tuple[int, Any]]:
    """Yield the messages of a topic, each with the time it was recorded [ns]."""
    connections = [each for each in reader.connections if each.topic == topic]
    for connection, log_ns, data in reader.messages(connections):
        yield log_ns, reader.deserialize(data, connection.msgtype)


def _head(reader: Any, path: Path, notes: Sequence[str]) -> Table:
    """Return all columns of a bag without rows, as its first messages have them.

    Args:
        reader: Of rosbags.
        path: For messages.
        notes: What is odd about the files.

    Raises:
        FormatError: There is none.
    """
    first_messages = 20  # in which every joint is named, and arrays are filled
    columns: dict[str, np.ndarray] = {}
    clocks: dict[str, str] = {}
    joint_names: dict[str, tuple[str, ...]] = {}
    empty: dict[str, None] = {}
    topics = dict.fromkeys(each.topic for each in reader.connections)
    for topic in topics:
        for _, message in islice(_messages(reader, topic), first_messages):
            for column, signal in _signals(topic, message).items():
                size = np.size(signal.values)
                if not size:
                    empty[column] = None
                if not 0 < size <= MAX_LIST_NUMBERS:
                    continue

                clocks[column] = topic
                columns.setdefault(column, np.empty((0, *np.shape(signal.values))))
                if signal.joints:
                    named = (*joint_names.get(column, ()), *signal.joints)
                    joint_names[column] = (*dict.fromkeys(named),)
                    columns[column] = np.empty((0, len(joint_names[column])))

    if not columns:
        raise FormatError(
            f"{path} holds no topic with numbers: {', '.join(topics)}",
            "Record the topics with numbers again.",
        )

    return Table(
        columns=columns,
        joint_names=joint_names,
        clocks=clocks,
        warnings=tuple(notes),
        empty=tuple(column for column in empty if column not in columns),
    )


def read_bag(
    paths: Sequence[Path], select: Callable[[Table], Table], unpacked: UnpackedSize
) -> Table:
    """Read a ROS bag as a table whose columns have the stamps of their topic.

    Args:
        paths: Files of the bag, or folders of such.
        select: Returns of all columns, without rows, those that are needed, with the
            joints that are; all are returned without rows if none is.
        unpacked: Counts what is unpacked.

    Raises:
        RecordingError: It cannot be read, or lacks what is asked for.
    """
    notes: list[str] = []
    with _open_bag(paths, notes, unpacked) as reader:
        whole = _head(reader, paths[0], notes)
        head = select(whole)
        if not head.columns:
            return whole

        columns: dict[str, np.ndarray] = {}
        both_ns: dict[str, NDArray[np.int64]] = {}
        for topic in dict.fromkeys(head.clocks[name] for name in head.columns):
            names = [name for name in head.columns if head.clocks[name] == topic]
            both_ns[topic], rows = _read_topic(reader, topic, names, head)
            columns |= rows

    stamped = [both for both in both_ns.values() if both[0].any()]
    sources_ns, logs_ns = max(stamped, key=np.size, default=np.ones((2, 1), np.int64))
    # Of the sources' clock from the recorder's, by the fullest topic.
    offset_ns = int(np.median((sources_ns - logs_ns)[sources_ns != 0]))
    stamps_ns: dict[str, NDArray[np.int64]] = {}
    for topic, (sources_ns, logs_ns) in both_ns.items():
        # A simulated clock may begin at zero; on any other that is no stamp.
        is_simulated = 0 < sources_ns.max(initial=0) < 86_400 * NS_PER_S
        is_set = (sources_ns != 0) | is_simulated
        stamps_ns[topic] = np.where(is_set, sources_ns, logs_ns + offset_ns)

    ordered = {name: columns[name] for name in head.columns}
    return replace(head, columns=ordered, stamps_ns=stamps_ns)


def _read_topic(
    reader: Any, topic: str, names: Sequence[str], head: Table
) -> tuple[NDArray[np.int64], dict[str, np.ndarray]]:
    """Return stamps of source and recorder [ns], shape (2, n), and columns by name.

    Messages about none of the joints in the head are left out.
    """
    wanted = {joint for name in names for joint in head.joint_names.get(name, ())}
    stamps_ns: list[tuple[int, int]] = []
    rows = {name: array("d") for name in names}
    for log_ns, message in _messages(reader, topic):
        signals = _signals(topic, message)
        named = {joint for signal in signals.values() for joint in signal.joints}
        if named and wanted and named.isdisjoint(wanted):
            continue

        stamp = getattr(getattr(message, "header", None), "stamp", None)
        stamp_ns = stamp.sec * NS_PER_S + stamp.nanosec if stamp else 0
        stamps_ns.append((stamp_ns, log_ns))
        for name, numbers in rows.items():
            signal = signals.get(name, _Signal((), []))
            values = np.atleast_1d(signal.values)
            if joints := head.joint_names.get(name):
                by_joint = dict(zip(signal.joints, values, strict=False))
                values = [by_joint.get(joint, np.nan) for joint in joints]

            width = head.width(name)
            numbers.extend(values if len(values) == width else [np.nan] * width)

    columns = {
        name: np.frombuffer(numbers).reshape(-1, *head.columns[name].shape[1:])
        for name, numbers in rows.items()
    }
    return np.array(stamps_ns, np.int64).reshape(-1, 2).T, columns
