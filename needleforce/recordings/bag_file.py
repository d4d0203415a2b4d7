"""ROS bags as a table: topics are columns, the messages of one topic are the rows.

`rosbags` reads the files (.bag, .db3, .mcap); other topics are interpolated.
"""

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import fields, is_dataclass, replace
from itertools import islice
from operator import attrgetter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from needleforce.recordings.bag_topics import standard_types
from needleforce.recordings.channel_request import ChannelRequest
from needleforce.recordings.channels import KNOWLEDGE
from needleforce.recordings.errors import (
    RECOVER,
    UNPACK,
    ColumnError,
    FormatError,
    RecordingError,
    file_errors,
    optional_library,
    require_size,
)
from needleforce.recordings.joint_names import order_joints
from needleforce.recordings.table import MAX_LIST_NUMBERS, Table
from needleforce.recordings.time_stamps import (
    NS_PER_S,
    first_valid_stamp,
    interpolate,
    start_of_clock,
    to_seconds,
)

BAG_SUFFIXES = (".mcap", ".db3", ".bag")
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


class Topic:
    """A topic: where the numbers of its messages are, and what was read of them.

    Attributes:
        name: Such as /joint_states.
        kind: The type of its messages.
        connections: Of the bag.
        count: Messages in the bag.
        columns: What gets the numbers of a column from a message, by its name.
        widths: How many numbers a column has in a row; None for a single one.
        named: Columns whose numbers belong to joints.
        joints: Names of joints, in the order of their numbers.
        known: Columns that are channels by the type of the messages, by channel.
    """

    def __init__(self, reader: Any, connections: Sequence[Any]) -> None:
        self.name = connections[0].topic
        self.kind = connections[0].msgtype
        self.connections = connections
        self.count = sum(each.msgcount for each in connections)
        self.columns: dict[str, attrgetter] = {}
        self.widths: dict[str, int | None] = {}
        self.named: set[str] = set()
        self.joints: tuple[str, ...] = ()
        known_fields = KNOWLEDGE.messages.get(self.kind, {})
        part = known_fields.get("q", "").rpartition("/")[0]
        self._joint_names = attrgetter(".".join((*part.split("/"), "name")).strip("."))
        for _, _, data in islice(reader.messages(connections), 20):
            self._learn(reader.deserialize(data, self.kind), {*known_fields.values()})

        self.known = {
            channel: column
            for channel, field in known_fields.items()
            if (column := self._column(tuple(field.split("/")))) in self.columns
        }

    def _column(self, path: tuple[str, ...]) -> str:
        """Return the name of a column by the fields that lead to it."""
        path = path[1:] or path if self.kind.endswith("Stamped") else path
        return self.name if path == ("data",) else "/".join((self.name, *path))

    def _learn(self, message: Any, known_fields: set[str]) -> None:
        """Find the numbers of a message, and the joints that it names."""
        names = self.names(message)
        self.joints += tuple(name for name in names if name not in self.joints)
        for path, paths in _numbers_in(message):
            column = self._column(path)
            get = attrgetter(*(".".join(each) for each in paths))
            size = np.size(get(message))
            if not 0 < size <= MAX_LIST_NUMBERS or path[-2:-1] == ("stamp",):
                continue

            is_single = np.ndim(get(message)) == 0
            self.columns.setdefault(column, get)
            self.widths.setdefault(column, None if is_single else size)
            is_of_joints = len(path) == 1 or "/".join(path) in known_fields
            if names and size == len(names) and is_of_joints:
                self.named.add(column)

    def names(self, message: Any) -> tuple[str, ...]:
        """Return the joints that a message names; none if they are not unique."""
        names: Any = ()
        with suppress(AttributeError):
            names = self._joint_names(message)

        names = tuple(names) if isinstance(names, list) else ()
        return names if all(names) and len({*names}) == len(names) else ()

    def read(
        self, reader: Any, needed: Sequence[str], joints: Sequence[str]
    ) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
        """Return stamps of source and recorder in ns, and needed columns, (n, k)."""
        stamps: list[tuple[int, int]] = []
        rows: dict[str, list[Any]] = {name: [] for name in needed}
        for _, log_ns, data in reader.messages(self.connections):
            message = reader.deserialize(data, self.kind)
            names = self.names(message)
            if names and joints and not {*names} & {*joints}:
                continue

            stamp = getattr(getattr(message, "header", None), "stamp", None)
            stamp_ns = stamp.sec * NS_PER_S + stamp.nanosec if stamp else 0
            stamps.append((stamp_ns, log_ns))
            for name, values in rows.items():
                width = self.widths[name] or 1
                numbers = np.atleast_1d(self.columns[name](message))
                if name in self.named:
                    width = len(joints)
                    by_joint = dict(zip(names, numbers, strict=False))
                    numbers = [by_joint.get(joint, np.nan) for joint in joints]

                fits = len(numbers) == width
                values.append(numbers if fits else np.full(width, np.nan))

        columns = {name: np.array(values, np.float64) for name, values in rows.items()}
        stamps_ns, logs_ns = np.array(stamps, np.int64).reshape(-1, 2).T
        return stamps_ns, logs_ns, columns


def _numbers_in(
    message: Any, path: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], list[tuple[str, ...]]]]:
    """Yield the fields that lead to numbers: single ones, vectors and arrays."""
    names = tuple(f.name for f in fields(message) if not f.name.startswith("__"))
    axes = "".join(names)
    if axes in ("xyzw", "xyz", "xy") and isinstance(getattr(message, names[0]), float):
        vector = "_".join((*path[-1:], axes))
        yield (*path[:-1], vector), [(*path, name) for name in names]
        return

    for name in names:
        value = getattr(message, name)
        if is_dataclass(value):
            yield from _numbers_in(value, (*path, name))
        elif isinstance(value, int | float | np.ndarray) and name != "seq":
            yield (*path, name), [(*path, name)]


def _recover(path: Path, target: Path) -> None:
    """Copy the messages of an MCAP without its end, as far as they go."""
    library = optional_library("mcap.stream_reader", "cut MCAP files")
    writer = optional_library("mcap.writer", "cut MCAP files").Writer(str(target))
    writer.start("ros2")
    schemas = {0: 0}
    channels: dict[int, int] = {}
    with path.open("rb") as stream, suppress(Exception):  # whatever the end becomes
        reader = library.StreamReader(stream, record_size_limit=path.stat().st_size)
        for record in reader.records:
            if isinstance(record, library.Schema):
                schemas[record.id] = writer.register_schema(
                    record.name, record.encoding, record.data
                )
            elif isinstance(record, library.Channel):
                channels[record.id] = writer.register_channel(
                    record.topic,
                    record.message_encoding,
                    schemas[record.schema_id],
                    record.metadata,
                )
            elif isinstance(record, library.Message):
                channel = channels[record.channel_id]
                writer.add_message(
                    channel, record.log_time, record.data, record.publish_time
                )

    writer.finish()


def _files_to_read(path: Path, folder: Path) -> tuple[list[Path], list[str]]:
    """Return the files of a bag, and a note on each that was cut short.

    Args:
        path: Of the bag.
        folder: Gets what is left of those that were cut short.
    """
    magic = b"\x89MCAP0\r\n"
    files: list[Path] = []
    notes: list[str] = []
    for number, file in enumerate(_files_in(path) if path.is_dir() else [path]):
        with file.open("rb") as stream:
            is_mcap = stream.read(len(magic)) == magic
            stream.seek(-len(magic), 2) if is_mcap else None
            is_cut = is_mcap and stream.read() != magic

        files.append(folder / f"{number}.mcap" if is_cut else file)
        if is_cut:
            _recover(file, files[-1])
            notes.append(f"{file.name} is cut short; it was read up to there")

    is_whole_folder = not notes and (path / METADATA).exists()
    return [path] if is_whole_folder else files, notes


@contextmanager
def _open_bag(path: Path) -> Iterator[tuple[Any, list[Topic], list[str]]]:
    """Open a bag; yield its reader, its topics with numbers, and notes.

    Raises:
        FormatError: It is no bag, damaged, or without numbers.
    """
    library = optional_library("rosbags.highlevel", "ROS bags")
    with TemporaryDirectory() as folder, file_errors(path):
        files, notes = _files_to_read(path, Path(folder))
        try:
            with library.AnyReader(files, default_typestore=standard_types()) as reader:
                by_name: dict[str, list[Any]] = {}
                for connection in reader.connections:
                    by_name.setdefault(connection.topic, []).append(connection)

                topics = [Topic(reader, each) for each in by_name.values()]
                topics = [topic for topic in topics if topic.columns]
                if not topics:
                    raise FormatError(
                        f"{path} holds no topic with numbers: {', '.join(by_name)}",
                        UNPACK,
                    )

                yield reader, topics, notes
        except (RecordingError, OSError):
            raise
        except Exception as error:  # whatever damaged bytes make the library run into
            raise FormatError(
                f"{path} cannot be read as a bag ({error})", RECOVER
            ) from error


def _head(topics: Sequence[Topic]) -> Table:
    """Return all columns of a bag without rows, to look columns up by name."""
    known: dict[str, tuple[str, ...]] = {}
    columns = {"t_s": np.empty(0)}
    for topic in topics:
        for name, width in topic.widths.items():
            columns[name] = np.empty(0 if width is None else (0, width))
        for channel, column in topic.known.items():
            known[channel] = (*known.get(channel, ()), column)

    return Table(
        columns=columns,
        joint_names={name: topic.joints for topic in topics for name in topic.named},
        seconds=frozenset({"t_s"}),
        known=known,
    )


def bag_head(path: Path) -> Table:
    """Return the columns of a bag without rows."""
    with _open_bag(path) as (_, topics, _):
        return _head(topics)


def read_bag(path: Path, request: ChannelRequest, max_bytes: int) -> Table:
    """Read a ROS bag as a table with a column `t_s`.

    Args:
        path: Of the bag, a file or a folder.
        request: Which channels are read; none for all columns.
        max_bytes: The most memory that the messages may take.

    Raises:
        RecordingError: It cannot be read, or lacks what is asked for.
    """
    with _open_bag(path) as (reader, topics, notes):
        head = _head(topics)
        is_whole = request == ChannelRequest()
        needed = frozenset(head.columns) if is_whole else request.columns(head)
        if not needed:
            return head

        chosen = [topic for topic in topics if not needed.isdisjoint(topic.columns)]
        reference = _find_reference(request.mapping.reference_topic, chosen)
        chosen.sort(key=lambda topic: topic is not reference)
        columns: dict[str, np.ndarray] = {}
        joint_names: dict[str, tuple[str, ...]] = {}
        at_ns = np.zeros(0, np.int64)
        offset_ns = 0  # of the clock of the reference from the recorder's
        for topic in chosen:
            names = [name for name in topic.columns if name in needed]
            order, noted = order_joints(
                topic.name, topic.joints, request.mapping, request.joints
            )
            stamps_ns, logs_ns, values = topic.read(reader, names, order)
            require_size(sum(v.nbytes for v in values.values()), max_bytes, topic.name)
            is_set = stamps_ns != 0
            if topic is reference and is_set.any():
                offset_ns = int(np.median((stamps_ns - logs_ns)[is_set]))

            # A simulated clock may begin at zero; on any other that is no stamp.
            is_simulated = 0 < stamps_ns.max(initial=0) < 86_400 * NS_PER_S
            stamps_ns = np.where(is_set | is_simulated, stamps_ns, logs_ns + offset_ns)
            if topic is reference:
                at_ns = stamps_ns
            else:
                values = interpolate(at_ns, stamps_ns, values)
                if abs(len(stamps_ns) - len(at_ns)) > 1:
                    noted.append(
                        f"{topic.name} was interpolated to the stamps of "
                        f"{reference.name}"
                    )

            notes += noted
            joint_names |= dict.fromkeys(topic.named & {*names}, order)
            columns |= {
                name: array[:, 0] if topic.widths[name] is None else array
                for name, array in values.items()
            }

        known = {
            channel: kept
            for channel, names in head.known.items()
            if (kept := tuple(name for name in names if name in columns))
        }
        start_ns = start_of_clock(first_valid_stamp(at_ns))
        return replace(
            head,
            columns={"t_s": to_seconds(at_ns, start_ns), **columns},
            joint_names=joint_names,
            start_ns=start_ns,
            known=known,
            warnings=tuple(notes),
        )


def _find_reference(name: str | None, topics: Sequence[Topic]) -> Topic:
    """Return the topic whose messages are the rows: the mapping's, or the fullest.

    Raises:
        ColumnError: That of the mapping is not read.
    """
    most = max(topic.count for topic in topics)
    for topic in topics:
        if topic.name == name or (name is None and topic.count >= 0.9 * most):
            return topic

    raise ColumnError(
        f"reference_topic = {name!r} is no topic that is read; topics are: "
        f"{', '.join(topic.name for topic in topics)}"
    )
