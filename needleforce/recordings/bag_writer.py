"""Rows of a table as a ROS 2 bag: standard messages, in MCAP with checksums, or in SQLite."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from needleforce.recordings.bag_topics import CDR, standard_types
from needleforce.recordings.errors import LogError, optional_library
from needleforce.recordings.table import NS_PER_S, Columns, Labels, to_nanoseconds

TIME = "t_s"
JOINT_STATES, DIAGNOSTICS = "/joint_states", "/diagnostics"
FT_WRENCH, FT_FRAME = "/ft_sensor/wrench", "ft_sensor"
_JOINT_SIGNALS = {"position": "q_rad", "velocity": "dq_rad_s", "effort": "tau_Nm"}
_FT_SIGNALS = {"force": "ft_force_N", "torque": "ft_torque_Nm"}
_COMPONENT = re.compile(r"(force|torque)_([xyz])_in_\w+")
_XYZ = "xyz"
_DIAGNOSTIC_ARRAY = "diagnostic_msgs/msg/DiagnosticArray"
_OK, _WARN = 0, 1

_VERSION = 8
"""Of the metadata: the latest that ROS 2 Humble reads."""
_FOREVER = (9223372036, 854775807)
_DEPTH = 10
_CHUNK_BYTES = 1 << 20

Make = Callable[[Any, int], Any]
"""Makes a message from a row of the topic's columns and its time stamp in ns."""


class OutTopic(NamedTuple):
    """A topic to write, one message for each row.

    `make` makes a message of the values of `columns` in one row and a time stamp in ns.
    """

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
    found = (_joint_states(columns, labels), _ft_wrench(columns), _wrench(columns, labels))
    topics = [topic for topic in found if topic is not None]
    taken = {TIME, *(name for topic in topics for name in topic.columns)}
    for name, values in columns.items():
        if name in taken:
            continue
        topic = f"{labels.prefix}/{re.sub(r'[^A-Za-z0-9_]', '_', name)}"
        if values.ndim == 1:
            topics.append(_number(topic, name, None))
        else:
            topics += [_number(f"{topic}_{i + 1}", name, i) for i in range(values.shape[1])]
    return topics


def _header(stamp_ns: int, frame: str) -> Any:
    types = standard_types().types
    stamp = types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, NS_PER_S))
    return types["std_msgs/msg/Header"](stamp, frame)


def _joint_states(columns: Columns, labels: Labels) -> OutTopic | None:
    here = {f: n for f, n in _JOINT_SIGNALS.items() if n in columns and columns[n].ndim == 2}
    if not here:
        return None
    width = columns[next(iter(here.values()))].shape[1]
    here = {field: name for field, name in here.items() if columns[name].shape[1] == width}
    names = list(labels.joint_names)
    if len(names) != width:
        names = [f"joint_{i + 1}" for i in range(width)]
    kind, none = "sensor_msgs/msg/JointState", np.empty(0)
    cls = standard_types().types[kind]
    fields = dict.fromkeys(_JOINT_SIGNALS, none)

    def make(row: Any, stamp_ns: int) -> Any:
        return cls(_header(stamp_ns, ""), names, **fields | dict(zip(here, row, strict=True)))

    return OutTopic(JOINT_STATES, kind, tuple(here.values()), make)


def _wrench_topic(
    name: str, frame: str, columns: tuple[str, ...], parts: Callable[[Any], tuple[Any, Any]]
) -> OutTopic:
    kind, types = "geometry_msgs/msg/WrenchStamped", standard_types().types
    vector, wrench = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Wrench"]

    def make(row: Any, stamp_ns: int) -> Any:
        force, torque = parts(row)
        return types[kind](_header(stamp_ns, frame), wrench(vector(*force), vector(*torque)))

    return OutTopic(name, kind, columns, make)


def _ft_wrench(columns: Columns) -> OutTopic | None:
    names = tuple(_FT_SIGNALS.values())
    if not all(name in columns and columns[name].shape[1:] == (3,) for name in names):
        return None
    return _wrench_topic(FT_WRENCH, FT_FRAME, names, lambda row: row)


def _wrench(columns: Columns, labels: Labels) -> OutTopic | None:
    sources: dict[tuple[str, str], str] = {}
    for name, values in columns.items():
        if values.ndim == 1 and (match := _COMPONENT.fullmatch(name)):
            sources.setdefault((match[1], match[2]), name)
    if not all(("force", xyz) in sources for xyz in _XYZ):
        return None
    names = tuple(sources.values())
    places = [
        [names.index(sources[part, xyz]) if (part, xyz) in sources else None for xyz in _XYZ]
        for part in ("force", "torque")
    ]

    def parts(row: Any) -> tuple[Any, Any]:
        force, torque = ([0.0 if i is None else row[i] for i in part] for part in places)
        return force, torque

    return _wrench_topic(f"{labels.prefix}/wrench", labels.frame, names, parts)


def _number(topic: str, column: str, element: int | None) -> OutTopic:
    """A number without a header: its time stamp is the one of the record."""
    cls = standard_types().types["std_msgs/msg/Float64"]

    def make(row: Any, _: int) -> Any:
        return cls(row[0] if element is None else row[0][element])

    return OutTopic(topic, "std_msgs/msg/Float64", (column,), make)


class _Events:
    """Changes of columns as diagnostic messages, from chunk to chunk."""

    def __init__(self, labels: Labels) -> None:
        self._labels = labels
        self._latest: dict[str, int] = {}

    def messages(self, columns: Columns, stamps_ns: NDArray[np.int64]) -> list[tuple[int, Any]]:
        """Return row and message of each event, in order."""
        events: list[tuple[int, Any]] = []
        for name, texts in self._labels.events.items():
            if name not in columns or not stamps_ns.size or not texts:
                continue
            values = np.nan_to_num(columns[name]).astype(np.int64)
            # Before the first row there was no value: any that it has is a change.
            before = np.roll(values, 1)
            before[0] = self._latest.get(name, int(values[0]) - 1)
            self._latest[name] = int(values[-1])
            for row in np.flatnonzero(values != before).tolist():
                value = int(values[row])
                if text := texts[min(max(value, 0), len(texts) - 1)].format(value):
                    message = self._message(name, text, value, int(stamps_ns[row]))
                    events.append((row, message))
        return sorted(events, key=lambda event: event[0])

    def _message(self, name: str, text: str, value: int, stamp_ns: int) -> Any:
        types = standard_types().types
        status = types["diagnostic_msgs/msg/DiagnosticStatus"](
            level=_OK if value == 0 else _WARN,
            name=f"{self._labels.prefix.strip('/')}: {name}",
            message=text,
            hardware_id="",
            values=[types["diagnostic_msgs/msg/KeyValue"](key=name, value=str(value))],
        )
        return types[_DIAGNOSTIC_ARRAY](_header(stamp_ns, self._labels.frame), [status])


class _BagWriter:
    """Writes each row as one message on each topic, stamped with the row's time."""

    def __init__(self, labels: Labels) -> None:
        self._types, self._labels = standard_types(), labels
        self._topics: list[tuple[Any, OutTopic]] = []
        self._events = _Events(labels)
        self._diagnostics: Any = None

    def append(self, columns: Columns) -> None:
        """Write rows of checked columns, the same in every call; with `t_s`.

        Raises:
            LogError: there is no time stamp, or one that no message can carry.
        """
        stamps_ns = _stamps(columns, self._labels.start_ns)
        if not self._topics and self._diagnostics is None:
            self._topics = [
                (self._connect(topic.name, topic.kind), topic)
                for topic in bag_topics(columns, self._labels)
            ]
            if any(name in columns for name in self._labels.events):
                self._diagnostics = self._connect(DIAGNOSTICS, _DIAGNOSTIC_ARRAY)
        series = [
            (
                connection,
                topic.kind,
                topic.make,
                list(zip(*self._values(columns, topic), strict=True)),
            )
            for connection, topic in self._topics
        ]
        events = self._events.messages(columns, stamps_ns)[::-1]
        serialize = self._types.serialize_cdr
        for row, stamp_ns in enumerate(stamps_ns.tolist()):
            for connection, kind, make, rows in series:
                self._write(connection, stamp_ns, serialize(make(rows[row], stamp_ns), kind))
            while events and events[-1][0] == row:
                data = serialize(events.pop()[1], _DIAGNOSTIC_ARRAY)
                self._write(self._diagnostics, stamp_ns, data)

    def _values(self, columns: Columns, topic: OutTopic) -> list[Any]:
        arrays = (columns[name].astype(np.float64, order="C") for name in topic.columns)
        return [values.tolist() if values.ndim == 1 else values for values in arrays]

    def flush(self) -> None:
        """Nothing can be read before the end."""

    def _connect(self, name: str, kind: str) -> Any:
        raise NotImplementedError

    def _write(self, connection: Any, stamp_ns: int, data: Any) -> None:
        raise NotImplementedError


def _stamps(columns: Columns, start_ns: int) -> NDArray[np.int64]:
    t_s = columns.get(TIME)
    if t_s is None or t_s.ndim != 1:
        raise LogError(f"a bag needs time stamps: a column {TIME}; there is {list(columns)}")
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
            folder, version=_VERSION, storage_plugin=library.StoragePlugin.SQLITE3
        )
        self._bag.open()

    def _connect(self, name: str, kind: str) -> Any:
        return self._bag.add_connection(
            name, kind, typestore=self._types, offered_qos_profiles=[_quality_of_service()]
        )

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
        self._schemas: dict[str, int] = {}

    def _connect(self, name: str, kind: str) -> int:
        if kind not in self._schemas:
            text, _ = self._types.generate_msgdef(kind, ros_version=2)
            self._schemas[kind] = self._bag.register_schema(kind, "ros2msg", text.encode())
        metadata = optional_library("rosbags.rosbag2.metadata", "ROS 2 bags")
        quality = metadata.dump_qos_v8([_quality_of_service()])
        entries = {"offered_qos_profiles": quality}
        return self._bag.register_channel(name, CDR, self._schemas[kind], entries)

    def _write(self, connection: int, stamp_ns: int, data: Any) -> None:
        self._bag.add_message(connection, stamp_ns, data, stamp_ns)

    def finish(self) -> None:
        """Write the index."""
        self._bag.finish()


def _quality_of_service() -> Any:
    """What ROS offers by default: reliable, the last ten messages kept."""
    ros = optional_library("rosbags.interfaces", "ROS 2 bags")
    forever = ros.QosTime(*_FOREVER)
    return ros.Qos(
        history=ros.QosHistory.KEEP_LAST,
        depth=_DEPTH,
        reliability=ros.QosReliability.RELIABLE,
        durability=ros.QosDurability.VOLATILE,
        deadline=forever,
        lifespan=forever,
        liveliness=ros.QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=forever,
        avoid_ros_namespace_conventions=False,
    )
