"""ROS messages as columns of numbers, and rows as messages; `rosbags` has their types.

Bags are written as MCAP, with checksums, or as SQLite.
"""

import re
from collections.abc import Callable, Iterator, Mapping
from functools import cache, lru_cache
from operator import attrgetter
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from needleforce.recordings.bag_messages import BagTopic
from needleforce.recordings.errors import FormatError, LogError, optional_library
from needleforce.recordings.table import NS_PER_S, Columns, Labels, to_nanoseconds

STANDARD = "ROS2_HUMBLE"
"""Whose standard messages are meant where a bag holds no definitions."""
CDR = "cdr"
_NAMES = ("name", "names", "joint_names")
"""Fields that name the elements of the arrays beside them."""
_VECTORS = (("x", "y", "z", "w"), ("x", "y", "z"), ("x", "y"))
_STAMP = {("header", "stamp", "sec"), ("header", "stamp", "nanosec")}
_MOST_ELEMENTS = 64
"""Longer arrays are images and point clouds, not signals."""
_LONGEST_DEFINITION = 1 << 18  # characters
_MOST_UNROLLED = 2000
"""`rosbags` generates code for each element of an array of texts or messages."""
_TYPE_NAME = re.compile(r"[A-Za-z]\w*(/[A-Za-z]\w*)*", re.ASCII)
_FIELD_NAME = re.compile(r"[A-Za-z_]\w*", re.ASCII)
_BASE, _NAME, _ARRAY = 1, 2, 3  # kinds of fields, as rosbags numbers them
_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


@cache
def standard_types() -> Any:
    """Return the type store of ROS's own messages; `FileAccessError` without rosbags."""
    library = optional_library("rosbags.typesys", "ROS 2 bags")
    return library.get_typestore(getattr(library.Stores, STANDARD))


@lru_cache(maxsize=256)
def _types_of(kind: str, definition: str) -> Any:
    """Return a store with a type as the bag defines it, else as ROS does."""
    standard = standard_types()
    library = optional_library("rosbags.typesys", "ROS 2 bags")
    if definition and len(definition) <= _LONGEST_DEFINITION:
        try:
            found = dict(library.get_types_from_msg(definition, kind))
            _require_plain(found)
            store = library.get_typestore(library.Stores.EMPTY)
            store.register(found)
            store.get_msgdef(kind)
        except Exception:
            # The parser raises whatever a damaged definition makes it run into; some types of a
            # bag are of no interest.
            pass
        else:
            return store
    if kind not in standard.fielddefs:
        raise FormatError(f"holds messages of the type {kind}, without its definition")
    return standard


def _require_plain(types: Mapping[str, Any]) -> None:
    """Refuse definitions whose names would not stay names in the code that `rosbags` generates."""
    unrolled = 0
    for kind, (constants, fields) in types.items():
        names = [entry[0] for entry in (*constants, *fields)]
        if not (_TYPE_NAME.fullmatch(kind) and all(map(_FIELD_NAME.fullmatch, names))):
            raise ValueError(f"{kind!r} has names that ROS does not allow")
        for _, (node, rest) in fields:
            if node == _ARRAY and (rest[0][0] == _NAME or rest[0][1][0] == "string"):
                unrolled += rest[1]
    if unrolled > _MOST_UNROLLED:
        raise ValueError(f"arrays of {unrolled} texts or messages")


class Content(NamedTuple):
    """What a message holds."""

    stamp_ns: int | None  # of the source; 0 if never set, None if the type has none
    names: tuple[str, ...]  # of joints
    values: dict[str, Any]  # by column; none for arrays that are empty or long
    named: frozenset[str]  # columns with one number for each name


def width_of(value: Any) -> int | None:
    """Return how many numbers a value of `Content` holds; None for a single number."""
    return len(value) if isinstance(value, tuple | np.ndarray) else None


class TopicDecoder:
    """Decodes the messages of one topic; `FormatError` if its type is not known.

    A column is called by its topic and the fields that lead to it: `/joint_states/position`.
    Vectors are one column of several numbers: `/ft/wrench/force_xyz`. In a `...Stamped` message
    the one field beside the header goes unnamed, and so does `data`: `/depth_mm`.
    """

    def __init__(self, topic: BagTopic) -> None:
        if topic.encoding != CDR:
            raise FormatError(f"is encoded as {topic.encoding!r}; ROS 2 has {CDR!r}")
        self._kind = topic.kind
        self._types = _types_of(topic.kind, topic.definition)
        try:
            places = dict(self._places((), topic.kind))
            fields = [name for name, _ in self._types.get_msgdef(topic.kind).fields]
        except (KeyError, RecursionError) as error:
            raise FormatError(f"has the type {topic.kind}, whose definition is damaged") from error
        self.has_stamp = places.keys() >= _STAMP
        if self.has_stamp:
            places = {path: kind for path, kind in places.items() if path not in _STAMP}
        self._names = next((name for name in _NAMES if name in fields), None)
        self._columns = list(_columns(topic, list(places.items())))

    def _places(self, path: tuple[str, ...], kind: str) -> Iterator[tuple[tuple[str, ...], Any]]:
        """Yield the paths to numbers in a type, with the base type, and whether it is an array."""
        for name, (node, rest) in self._types.get_msgdef(kind).fields:
            if node == _NAME:
                yield from self._places((*path, name), rest)
            elif node == _BASE and rest[0] != "string":
                yield (*path, name), (rest[0], False)
            elif node >= _ARRAY and rest[0][0] == _BASE and rest[0][1][0] != "string":
                yield (*path, name), (rest[0][1][0], True)

    def decode(self, data: bytes) -> Content:
        """Decode a message; `FormatError` if it does not fit its type."""
        if data.startswith(_ZSTD_MAGIC):
            raise FormatError("is compressed message by message; unpack it with: ros2 bag convert")
        try:
            message = self._types.deserialize_cdr(data, self._kind)
        except Exception as error:
            # Damaged bytes end in whatever the generated code runs into.
            raise FormatError(f"does not fit its type {self._kind}") from error
        given = getattr(message, self._names) if self._names is not None else []
        names = tuple(given) if isinstance(given, list) else ()
        # Empty or repeated names identify no joint: their order then has to.
        names = names if all(names) and len(set(names)) == len(names) else ()
        values, named = {}, set()
        for column, get, is_array, is_beside_names in self._columns:
            value = get(message)
            if is_array:
                if not 0 < len(value) <= _MOST_ELEMENTS:
                    continue
                if is_beside_names and len(value) == len(names):
                    named.add(column)
            values[column] = value
        stamp_ns = None
        if self.has_stamp:
            stamp_ns = message.header.stamp.sec * NS_PER_S + message.header.stamp.nanosec
        return Content(stamp_ns, names, values, frozenset(named))


def _columns(
    topic: BagTopic, places: list[tuple[tuple[str, ...], Any]]
) -> Iterator[tuple[str, Callable[[Any], Any], bool, bool]]:
    """Yield name, getter, whether it is an array, and whether it stands beside names."""
    at = 0
    while at < len(places):
        path, (_, is_array) = places[at]
        width = next((len(v) for v in _VECTORS if _is_vector(places[at : at + len(v)], v)), 0)
        inside = [place for place, _ in places[at : at + (width or 1)]]
        is_beside = is_array and len(path) == 1
        if width:
            path = (*path[:-2], "_".join((*path[-2:-1], "".join(p[-1] for p in inside))))
        if topic.kind.endswith("Stamped"):
            path = path[1:] or path
        name = topic.name if path == ("data",) else "/".join((topic.name, *path))
        yield name, attrgetter(*map(".".join, inside)), is_array, is_beside
        at += width or 1


def _is_vector(places: list[tuple[tuple[str, ...], Any]], components: tuple[str, ...]) -> bool:
    return (
        tuple(path[-1] for path, _ in places) == components
        and len({(path[:-1], kind) for path, kind in places}) == 1
        and not places[0][1][1]
    )


_DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
_OK, _WARN = 0, 1
_METADATA_VERSION = 8
"""Of the metadata of an SQLite bag: the latest that ROS 2 Humble reads."""
_CHUNK_BYTES = 1 << 20

Make = Callable[[Any, int], Any]
"""Makes a message from a row of the topic's columns and its time stamp in ns."""


class OutTopic(NamedTuple):
    """A topic to write: one message for each row of `columns`, made by `make`."""

    name: str
    kind: str
    columns: tuple[str, ...]
    make: Make


def bag_topics(columns: Columns, labels: Labels) -> list[OutTopic]:
    """Decide which topics are written.

    `q_rad`, `dq_rad_s` and `tau_Nm` become a `JointState`; `ft_force_N` with `ft_torque_Nm`, and
    `force_x_in_...`, `torque_x_in_...` and so on, become a `WrenchStamped`; every other column
    but `t_s` becomes a `Float64` of its own.
    """
    topics = [*_joint_states(columns, labels), *_wrenches(columns, labels)]
    taken = {"t_s", *(name for topic in topics for name in topic.columns)}
    for name in (n for n in columns if n not in taken):
        topic = f"{labels.prefix}/{re.sub(r'[^A-Za-z0-9_]', '_', name)}"
        if columns[name].ndim == 1:
            topics.append(_number(topic, name, None))
        else:
            width = columns[name].shape[1]
            topics += [_number(f"{topic}_{i + 1}", name, i) for i in range(width)]
    return topics


def _header(stamp_ns: int, frame: str) -> Any:
    types = standard_types().types
    stamp = types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, NS_PER_S))
    return types["std_msgs/msg/Header"](stamp, frame)


def _joint_states(columns: Columns, labels: Labels) -> Iterator[OutTopic]:
    signals = {"position": "q_rad", "velocity": "dq_rad_s", "effort": "tau_Nm"}
    here = {f: n for f, n in signals.items() if n in columns and columns[n].ndim == 2}
    if not here:
        return
    width = columns[next(iter(here.values()))].shape[1]
    here = {field: name for field, name in here.items() if columns[name].shape[1] == width}
    names = list(labels.joint_names)
    if len(names) != width:
        names = [f"joint_{i + 1}" for i in range(width)]
    kind, empty = "sensor_msgs/msg/JointState", dict.fromkeys(signals, np.empty(0))
    cls = standard_types().types[kind]

    def make(row: Any, stamp_ns: int) -> Any:
        return cls(_header(stamp_ns, ""), names, **empty | dict(zip(here, row, strict=True)))

    yield OutTopic("/joint_states", kind, tuple(here.values()), make)


def _wrenches(columns: Columns, labels: Labels) -> Iterator[OutTopic]:
    """Yield the wrench of a sensor, and the one estimated, whose torque may be missing."""
    sensor = ("ft_force_N", "ft_torque_Nm")
    if all(name in columns and columns[name].shape[1:] == (3,) for name in sensor):
        yield _wrench("/ft_sensor/wrench", "ft_sensor", sensor, lambda row: row)
    names: dict[str, str] = {}
    for name, values in columns.items():
        if values.ndim == 1 and (match := re.fullmatch(r"(force|torque)_([xyz])_in_\w+", name)):
            names.setdefault(match[1] + match[2], name)
    if all(f"force{xyz}" in names for xyz in "xyz"):
        places = {part: i for i, part in enumerate(names)}

        def parts(row: Any) -> tuple[Any, Any]:
            given = [*row, 0.0]
            force, torque = (
                [given[places.get(part + xyz, -1)] for xyz in "xyz"] for part in ("force", "torque")
            )
            return force, torque

        yield _wrench(f"{labels.prefix}/wrench", labels.frame, tuple(names.values()), parts)


def _wrench(
    name: str, frame: str, columns: tuple[str, ...], parts: Callable[[Any], tuple[Any, Any]]
) -> OutTopic:
    kind, types = "geometry_msgs/msg/WrenchStamped", standard_types().types
    vector, wrench = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Wrench"]

    def make(row: Any, stamp_ns: int) -> Any:
        force, torque = parts(row)
        return types[kind](_header(stamp_ns, frame), wrench(vector(*force), vector(*torque)))

    return OutTopic(name, kind, columns, make)


def _number(topic: str, column: str, element: int | None) -> OutTopic:
    """A number without a header: its time stamp is the one of the record."""
    kind = "std_msgs/msg/Float64"
    cls = standard_types().types[kind]

    def make(row: Any, _: int) -> Any:
        return cls(row[0] if element is None else row[0][element])

    return OutTopic(topic, kind, (column,), make)


class _BagWriter:
    """Writes each row as one message on each topic, stamped with the row's time."""

    def __init__(self, labels: Labels) -> None:
        self._types, self._labels = standard_types(), labels
        self._topics: list[tuple[Any, OutTopic]] | None = None
        self._diagnostics: Any = None
        self._latest: dict[str, int] = {}

    def append(self, columns: Columns) -> None:
        """Write rows of checked columns, the same in every call; with `t_s`.

        Raises:
            LogError: there is no time stamp, or one that no message can carry.
        """
        stamps_ns, labels = _stamps(columns, self._labels.start_ns), self._labels
        if self._topics is None:
            topics = bag_topics(columns, labels)
            self._topics = [(self._connect(topic.name, topic.kind), topic) for topic in topics]
            if any(name in columns for name in labels.events):
                self._diagnostics = self._connect("/diagnostics", _DIAGNOSTICS)
        series = []
        for connection, topic in self._topics:
            values = (columns[name].astype(np.float64, order="C") for name in topic.columns)
            cells = (v.tolist() if v.ndim == 1 else v for v in values)
            series.append((connection, topic.kind, topic.make, list(zip(*cells, strict=True))))
        changes = [column for name in labels.events if (column := self._changes(columns, name))]
        serialize = self._types.serialize_cdr
        for row, stamp_ns in enumerate(stamps_ns.tolist()):
            for connection, kind, make, rows in series:
                self._write(connection, stamp_ns, serialize(make(rows[row], stamp_ns), kind))
            for statuses in changes:
                if row in statuses:
                    event = self._types.types[_DIAGNOSTICS](
                        _header(stamp_ns, labels.frame), [statuses[row]]
                    )
                    self._write(self._diagnostics, stamp_ns, serialize(event, _DIAGNOSTICS))

    def _changes(self, columns: Columns, name: str) -> dict[int, Any]:
        """Return row and status where a column of `Labels.events` changes."""
        texts, types = self._labels.events[name], self._types.types
        values = np.nan_to_num(columns.get(name, ())).astype(np.int64).tolist()
        changes = {}
        for row, value in enumerate(values if texts else ()):
            text = texts[min(max(value, 0), len(texts) - 1)].format(value)
            # The first value of all is a change.
            if self._latest.get(name) != value and text:
                changes[row] = types["diagnostic_msgs/msg/DiagnosticStatus"](
                    level=_OK if value == 0 else _WARN,
                    name=f"{self._labels.prefix.strip('/')}: {name}",
                    message=text,
                    hardware_id="",
                    values=[types["diagnostic_msgs/msg/KeyValue"](key=name, value=str(value))],
                )
            self._latest[name] = value
        return changes

    def flush(self) -> None:
        """Nothing can be read before the end."""

    def _connect(self, name: str, kind: str) -> Any:
        raise NotImplementedError

    def _write(self, connection: Any, stamp_ns: int, data: Any) -> None:
        raise NotImplementedError


def _stamps(columns: Columns, start_ns: int) -> NDArray[np.int64]:
    t_s = columns.get("t_s")
    if t_s is None or t_s.ndim != 1:
        raise LogError(f"a bag needs time stamps: a column t_s; there is {list(columns)}")
    if not np.isfinite(t_s).all():
        raise LogError("a bag needs a time stamp in every row; one is not finite")
    stamps_ns = to_nanoseconds(t_s, start_ns)
    if stamps_ns.size and stamps_ns.min() < 0:
        raise LogError(f"a bag cannot hold time stamps before zero; t_s reaches {t_s.min()} s")
    return stamps_ns


class SqliteBagWriter(_BagWriter):
    """Writes a new folder with an SQLite file and its metadata."""

    def __init__(self, folder: Path, labels: Labels) -> None:
        super().__init__(labels)
        library = optional_library("rosbags.rosbag2", "ROS 2 bags")
        self._bag = library.Writer(
            folder, version=_METADATA_VERSION, storage_plugin=library.StoragePlugin.SQLITE3
        )
        self._bag.open()

    def _connect(self, name: str, kind: str) -> Any:
        return self._bag.add_connection(name, kind, typestore=self._types)

    def _write(self, connection: Any, stamp_ns: int, data: Any) -> None:
        self._bag.write(connection, stamp_ns, data)

    def finish(self) -> None:
        """Write the index and the metadata."""
        self._bag.close()


class McapWriter(_BagWriter):
    """Writes a bag as one MCAP file; chunks are compressed and carry checksums."""

    def __init__(self, stream: BinaryIO, labels: Labels) -> None:
        super().__init__(labels)
        library = optional_library("mcap.writer", "MCAP files")
        self._bag = library.Writer(stream, chunk_size=_CHUNK_BYTES, enable_data_crcs=True)
        self._bag.start(profile="ros2", library="needleforce")

    def _connect(self, name: str, kind: str) -> int:
        text, _ = self._types.generate_msgdef(kind, ros_version=2)
        schema = self._bag.register_schema(kind, "ros2msg", text.encode())
        return self._bag.register_channel(name, CDR, schema)

    def _write(self, connection: int, stamp_ns: int, data: Any) -> None:
        self._bag.add_message(connection, stamp_ns, data, stamp_ns)

    def finish(self) -> None:
        """Write the index."""
        self._bag.finish()
