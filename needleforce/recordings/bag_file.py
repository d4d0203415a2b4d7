"""ROS bags as a table: topics are columns, the messages of one topic are the rows.

`rosbags` reads the files (.bag, .db3, .mcap); other topics are interpolated.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
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
from needleforce.recordings.channels import KNOWLEDGE, MessageLayout
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
from needleforce.recordings.table import (
    MAX_LIST_NUMBERS,
    Table,
    ToolMass,
    choose_tool_mass,
)
from needleforce.recordings.time_stamps import (
    NS_PER_S,
    first_valid_stamp,
    interpolate,
    start_of_clock,
    to_seconds,
)

BAG_SUFFIXES = (".mcap", ".db3", ".bag")
METADATA = "metadata.yaml"
MCAP_MAGIC = b"\x89MCAP0\r\n"

_VECTORS = (tuple("xyzw"), tuple("xyz"), tuple("xy"))
_NAME_FIELDS = ("name", "names", "joint_names")


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
        connections: Of the bag.
        count: Messages in the bag.
        columns: What gets the numbers of a column from a message, by its name.
        named: Columns whose numbers belong to joints.
        joints: Names of joints, in the order of their numbers.
        known: Columns that are channels by the type of the messages, by channel.
        tool_mass: What the first message says hangs on the flange.
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
        self.layout = KNOWLEDGE.messages.get(self.kind, MessageLayout())
        self.tool_mass: ToolMass | None = None
        part = self.layout.channels.get("q", "").rpartition("/")[0]
        self._name_path = f"{part}/name".strip("/") if part else ""
        for _, _, data in islice(reader.messages(connections), 20):
            self._learn(reader.deserialize(data, self.kind))

        self.known = {
            channel: column
            for channel, field in self.layout.channels.items()
            if (column := self._column(tuple(field.split("/")))) in self.columns
        }

    def _column(self, path: tuple[str, ...]) -> str:
        """Return the name of a column by the fields that lead to it."""
        path = path[1:] or path if self.kind.endswith("Stamped") else path
        return self.name if path == ("data",) else "/".join((self.name, *path))

    def _learn(self, message: Any) -> None:
        """Find the numbers of a message, and the joints that it names."""
        names = self.names(message)
        self.joints += tuple(name for name in names if name not in self.joints)
        for path, paths in _numbers_in(message):
            column = self._column(path)
            get = attrgetter(*(".".join(each) for each in paths))
            size = np.size(get(message))
            if not 0 < size <= MAX_LIST_NUMBERS or path[-2:-1] == ("stamp",):
                continue

            self.columns.setdefault(column, get)
            is_single = len(paths) == 1 and np.ndim(get(message)) == 0
            self.widths.setdefault(column, None if is_single else size)
            beside = (
                self.layout.channels and "/".join(path) in self.layout.channels.values()
            )
            if names and size == len(names) and (len(path) == 1 or beside):
                self.named.add(column)

        masses = [
            ToolMass(float(self.columns[c](message)), c) if c in self.columns else None
            for c in (self._column(tuple(f.split("/"))) for f in self.layout.masses)
        ]
        parts = [mass for mass in masses[1:] if mass is not None]
        first = masses[0] if masses else None
        self.tool_mass = self.tool_mass or choose_tool_mass(first, parts)

    def names(self, message: Any) -> tuple[str, ...]:
        """Return the joints that a message names; none if they are not unique."""
        if self._name_path:
            names = attrgetter(self._name_path.replace("/", "."))(message)
        else:
            names = next(
                (getattr(message, f) for f in _NAME_FIELDS if hasattr(message, f)), ()
            )

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

            header = getattr(message, "header", None)
            stamp = getattr(header, "stamp", None)
            stamp_ns = stamp.sec * NS_PER_S + stamp.nanosec if stamp else 0
            stamps.append((stamp_ns, log_ns))
            for name, values in rows.items():
                numbers = np.atleast_1d(self.columns[name](message))
                if name in self.named and names:
                    by_joint = dict(zip(names, numbers, strict=False))
                    numbers = [by_joint.get(joint, np.nan) for joint in joints or names]

                width = (
                    len(joints)
                    if name in self.named and joints
                    else self.widths[name] or 1
                )
                values.append(
                    numbers if len(numbers) == width else np.full(width, np.nan)
                )

        columns = {name: np.array(values, np.float64) for name, values in rows.items()}
        stamps_ns, logs_ns = np.array(stamps, np.int64).reshape(-1, 2).T
        return stamps_ns, logs_ns, columns


def _numbers_in(
    message: Any, path: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], list[tuple[str, ...]]]]:
    """Yield the fields that lead to numbers: single ones, vectors and arrays."""
    names = tuple(f.name for f in fields(message) if not f.name.startswith("__"))
    if names in _VECTORS and isinstance(getattr(message, names[0]), float):
        yield (
            (*path[:-1], "_".join((*path[-1:], "".join(names)))),
            [(*path, n) for n in names],
        )
        return

    for name in names:
        value = getattr(message, name)
        if is_dataclass(value):
            yield from _numbers_in(value, (*path, name))
        elif isinstance(value, int | float | np.ndarray) and (*path, name) != (
            "header",
            "seq",
        ):
            yield (*path, name), [(*path, name)]


def _is_cut(path: Path) -> bool:
    """Return whether a file is an MCAP of which the end is missing."""
    if path.suffix.lower() != ".mcap":
        return False

    with path.open("rb") as stream:
        is_mcap = stream.read(len(MCAP_MAGIC)) == MCAP_MAGIC
        stream.seek(max(stream.tell(), path.stat().st_size - len(MCAP_MAGIC)))
        return is_mcap and stream.read() != MCAP_MAGIC


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
    files = _files_in(path) if path.is_dir() else [path]
    cut = [each for each in files if _is_cut(each)]
    if not cut and (path / METADATA).exists():
        return [path], []

    for number, each in enumerate(cut):
        target = folder / f"{number}.mcap"
        _recover(each, target)
        files[files.index(each)] = target
    return files, [f"{each.name} is cut short; it was read up to there" for each in cut]


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
    for topic in topics:
        for channel, column in topic.known.items():
            known[channel] = (*known.get(channel, ()), column)

    return Table(
        columns={
            name: np.empty((0,) if width is None else (0, width))
            for topic in topics
            for name, width in topic.widths.items()
        },
        joint_names={name: topic.joints for topic in topics for name in topic.named},
        known=known,
        tool_mass=next((each.tool_mass for each in topics if each.tool_mass), None),
    )


def bag_head(path: Path) -> tuple[Table, dict[str, int]]:
    """Return the columns of a bag without rows, and how many messages a topic has."""
    with _open_bag(path) as (_, topics, _):
        return _head(topics), {topic.name: topic.count for topic in topics}


def _find_reference(request: ChannelRequest, topics: Sequence[Topic]) -> str:
    """Return the topic whose messages are the rows: the mapping's, or the fullest.

    Raises:
        ColumnError: That of the mapping is not read.
    """
    reference = request.mapping.reference_topic
    if reference is None:
        most = max(topic.count for topic in topics)
        return next(topic.name for topic in topics if topic.count >= 0.9 * most)

    names = [topic.name for topic in topics]
    if reference not in names:
        raise ColumnError(
            f"reference_topic = {reference!r} is no topic that is read; topics "
            f"are: {', '.join(names)}"
        )

    return reference


def read_bag(path: Path, request: ChannelRequest | None, max_bytes: int) -> Table:
    """Read a ROS bag as a table with a column `t_s`.

    Args:
        path: Of the bag, a file or a folder.
        request: Which channels are read; None for all columns.
        max_bytes: The most memory that the messages may take.

    Raises:
        RecordingError: It cannot be read, or lacks what is asked for.
    """
    with _open_bag(path) as (reader, topics, notes):
        head = _head(topics)
        needed = None if request is None else request.columns(head)
        if request is not None and not needed:
            return head

        request = request or ChannelRequest()

        chosen = {
            topic.name: (
                topic,
                [c for c in topic.columns if needed is None or c in needed],
            )
            for topic in topics
        }
        chosen = {name: pair for name, pair in chosen.items() if pair[1]}
        reference = _find_reference(request, [topic for topic, _ in chosen.values()])
        columns: dict[str, np.ndarray] = {}
        joint_names: dict[str, tuple[str, ...]] = {}
        at_ns = np.zeros(0, np.int64)
        offset_ns = 0  # of the clock of the reference from the recorder's
        for name in (reference, *(each for each in chosen if each != reference)):
            topic, names = chosen[name]
            order, noted = order_joints(
                name, topic.joints, request.mapping, request.joints
            )
            notes += noted
            stamps_ns, logs_ns, values = topic.read(reader, names, order)
            if name == reference and stamps_ns.any():
                offset_ns = int(np.median((stamps_ns - logs_ns)[stamps_ns != 0]))

            # A simulated clock may begin at zero; on any other that is no stamp.
            is_simulated = 0 < stamps_ns.max(initial=0) < 86_400 * NS_PER_S
            if not is_simulated:
                stamps_ns = np.where(stamps_ns == 0, logs_ns + offset_ns, stamps_ns)

            require_size(sum(v.nbytes for v in values.values()), max_bytes, name)
            notes += _current_notes(topic, request.mapping.channels)
            if name == reference:
                at_ns = stamps_ns
            else:
                span_s = np.ptp(stamps_ns) / NS_PER_S if stamps_ns.size else 0.0
                limit_ns = NS_PER_S * max(
                    0.1, 5.0 * span_s / max(len(stamps_ns) - 1, 1)
                )
                values = {
                    n: interpolate(at_ns, stamps_ns, v, limit_ns)
                    for n, v in values.items()
                }
                if abs(len(stamps_ns) - len(at_ns)) > 1:
                    notes.append(
                        f"{name} was interpolated to the stamps of {reference}"
                    )

            joint_names |= dict.fromkeys(topic.named & {*names}, order)
            columns |= {
                n: v[:, 0] if topic.widths[n] is None else v for n, v in values.items()
            }

        start_ns = start_of_clock(first_valid_stamp(at_ns))
        return replace(
            head,
            columns={"t_s": to_seconds(at_ns, start_ns), **columns},
            joint_names=joint_names,
            start_ns=start_ns,
            known={
                c: k
                for c, names in head.known.items()
                if (k := tuple(n for n in names if n in columns))
            },
            warnings=tuple(notes),
        )


def _current_notes(topic: Topic, channels: Mapping[str, Any]) -> list[str]:
    """Return a note where efforts are those of a driver that sends motor currents."""
    joints = ("shoulder_pan_joint", "elbow_joint", "wrist_3_joint")
    is_ur = all(any(each.endswith(joint) for each in topic.joints) for joint in joints)
    spec = channels.get("tau")
    if not is_ur or (spec is not None and spec.scale != 1.0):
        return []

    return [
        f"{topic.name}: the driver of Universal Robots sends motor currents in A as "
        "effort, unless it was set to send torques; give the torque constants of the "
        "joints in Nm/A as `scale` of `tau`"
    ]
