"""ROS messages as columns of numbers, and rows as messages; `rosbags` has their
types.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import cache, lru_cache
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np

from needleforce.recordings.bag_messages import BagTopic
from needleforce.recordings.errors import FormatError, optional_library
from needleforce.recordings.table import NS_PER_S, Columns, Labels, flat_columns

STANDARD = (
    "ROS2_HUMBLE"  # whose standard messages are meant where a bag holds no definitions
)
CDR = "cdr"
_NAMES = (
    "name",
    "names",
    "joint_names",
)  # fields that name the elements of the arrays beside them
_VECTORS = (tuple("xyzw"), tuple("xyz"), tuple("xy"))
_STAMP = {("header", "stamp", "sec"), ("header", "stamp", "nanosec")}
_MOST_ELEMENTS = 64  # longer arrays are images and point clouds, not signals
_SIGNALS = (
    "q_rad",
    "dq_rad_s",
    "tau_Nm",
)  # Position, velocity and effort of a `JointState`
_SENSOR = ("ft_force_N", "ft_torque_Nm")
_LONGEST_DEFINITION = 1 << 18  # characters
_MOST_UNROLLED = (
    2000  # `rosbags` generates code for each element of an array of texts or messages
)
_TYPE_NAME = re.compile(r"[A-Za-z]\w*(/[A-Za-z]\w*)*", re.ASCII)
_FIELD_NAME = re.compile(r"[A-Za-z_]\w*", re.ASCII)
# kinds of fields, as rosbags numbers them
_BASE = 1
_NAME = 2
_ARRAY = 3
_FLOATS = {(_BASE, ("float32", 0)), (_BASE, ("float64", 0))}
_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


@cache
def standard_types() -> Any:
    """Return the type store of ROS's own messages; `FileAccessError` without
    rosbags.
    """
    library = optional_library("rosbags.typesys", "ROS 2 bags")
    return library.get_typestore(getattr(library.Stores, STANDARD))


@lru_cache(maxsize=256)
def _types_of(kind: str, definition: str) -> Any:
    """Return a store with a type as the bag defines it, else as ROS does."""
    standard = standard_types()
    library = optional_library("rosbags.typesys", "ROS 2 bags")
    if definition and len(definition) <= _LONGEST_DEFINITION:
        # The parser raises whatever a damaged definition makes it run into; some types
        # of a bag are of no interest.
        with suppress(Exception):
            found = dict(library.get_types_from_msg(definition, kind))
            _require_plain(found)
            store = library.get_typestore(library.Stores.EMPTY)
            store.register(found)
            store.get_msgdef(kind)
            return store
    if kind not in standard.fielddefs:
        raise FormatError(f"holds messages of the type {kind}, without its definition")
    return standard


def _require_plain(types: Mapping[str, Any]) -> None:
    """Refuse definitions whose names would not stay names in the code that `rosbags`
    generates.
    """
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
    """What a message holds.

    Attributes:
        stamp_ns: Of the source; 0 if never set, None if the type has none.
        names: Of joints.
        values: By column; none for arrays that are empty or long.
        named: Columns with one number for each name.
    """

    stamp_ns: int | None
    names: tuple[str, ...]
    values: dict[str, Any]
    named: frozenset[str]


def size_of(value: Any) -> int | None:
    """Return how many numbers a value of `Content` holds; None for a single number."""
    return len(value) if isinstance(value, tuple | np.ndarray) else None


_Column = tuple[tuple[str, ...], Callable[[Any], Any], bool]
"""Where the numbers of a column stand in a message, what gets them, and whether it
is an array."""


class TopicDecoder:
    """Decodes the messages of one topic; `FormatError` if its type is not known.

    A column is called by its topic and the fields that lead to it:
    `/joint_states/position`. Vectors are one column of several numbers:
    `/ft/wrench/force_xyz`. In a `...Stamped` message the one field beside the header
    goes unnamed, and so does `data`: `/depth_mm`.
    """

    def __init__(self, topic: BagTopic) -> None:
        if topic.encoding != CDR:
            raise FormatError(f"is encoded as {topic.encoding!r}; ROS 2 has {CDR!r}")
        self._kind = topic.kind
        self._types = _types_of(topic.kind, topic.definition)
        try:
            fields = {name for name, _ in self._types.get_msgdef(topic.kind).fields}
            columns = list(self._columns((), topic.kind))
        except (KeyError, RecursionError) as error:
            raise FormatError(
                f"has the type {topic.kind}, whose definition is damaged"
            ) from error
        self._has_stamp = {path for path, *_ in columns} >= _STAMP
        self._names = next((name for name in _NAMES if name in fields), None)
        self._getters = [
            (_column_name(topic, path), get, is_array, len(path) == 1)
            for path, get, is_array in columns
            if not (self._has_stamp and path in _STAMP)
        ]

    def _columns(self, path: tuple[str, ...], kind: str) -> Iterator[_Column]:
        """Yield where there are numbers in a type: single ones, vectors and arrays."""
        fields = self._types.get_msgdef(kind).fields
        names = tuple(name for name, _ in fields)
        if names in _VECTORS and {kind for _, kind in fields} <= _FLOATS:
            last = "_".join((*path[-1:], "".join(names)))
            yield (
                (*path[:-1], last),
                attrgetter(*(".".join((*path, x)) for x in names)),
                False,
            )
            return
        for name, (node, rest) in fields:
            place = (*path, name)
            if node == _NAME:
                yield from self._columns(place, rest)
            elif node == _BASE and rest[0] != "string":
                yield place, attrgetter(".".join(place)), False
            elif node >= _ARRAY and rest[0][0] == _BASE and rest[0][1][0] != "string":
                yield place, attrgetter(".".join(place)), True

    def decode(self, data: bytes) -> Content:
        """Decode a message; `FormatError` if it does not fit its type."""
        if data.startswith(_ZSTD_MAGIC):
            raise FormatError(
                "is compressed message by message; unpack it with: ros2 bag convert"
            )
        try:
            message = self._types.deserialize_cdr(data, self._kind)
        except Exception as error:
            # Damaged bytes end in whatever the generated code runs into.
            raise FormatError(f"does not fit its type {self._kind}") from error
        given = getattr(message, self._names) if self._names is not None else []
        names = tuple(given) if isinstance(given, list) else ()
        # Empty or repeated names identify no joint: their order then has to.
        names = names if all(names) and len(set(names)) == len(names) else ()
        values = {}
        named = set()
        for column, get, is_array, is_beside_names in self._getters:
            value = get(message)
            if is_array:
                if not 0 < len(value) <= _MOST_ELEMENTS:
                    continue
                if is_beside_names and len(value) == len(names):
                    named.add(column)
            values[column] = value
        stamp_ns = None
        if self._has_stamp:
            stamp_ns = (
                message.header.stamp.sec * NS_PER_S + message.header.stamp.nanosec
            )
        return Content(stamp_ns, names, values, frozenset(named))


def _column_name(topic: BagTopic, path: tuple[str, ...]) -> str:
    if topic.kind.endswith("Stamped"):
        path = path[1:] or path
    return topic.name if path == ("data",) else "/".join((topic.name, *path))


OutTopic = tuple[str, str, Iterable[Any]]  # name, type and messages, one for each row


def bag_topics(
    columns: Columns, labels: Labels, stamps_ns: Sequence[int]
) -> Iterator[OutTopic]:
    """Yield the topics of some rows, of these time stamps.

    `q_rad`, `dq_rad_s` and `tau_Nm` become a `JointState`; `ft_force_N` with
    `ft_torque_Nm`, and `force_x_in_...`, `torque_x_in_...` and so on, become a
    `WrenchStamped`; every other column but `t_s` becomes a `Float64` of its own.
    """
    types = standard_types().types
    left = {
        name: np.array(v, dtype=np.float64, order="C") for name, v in columns.items()
    }
    left.pop("t_s", None)
    signals = {
        name: left[name] for name in _SIGNALS if name in left and left[name].ndim == 2
    }
    width = next(iter(signals.values())).shape[1] if signals else 0
    signals = {
        name: left.pop(name) for name, v in signals.items() if v.shape[1] == width
    }
    if signals:
        joints = list(labels.joint_names)
        joint_state = "sensor_msgs/msg/JointState"
        if len(joints) != width:
            joints = [f"joint_{i + 1}" for i in range(width)]
        numbers = (
            signals.get(name, np.empty((len(stamps_ns), 0))) for name in _SIGNALS
        )
        rows = zip(_headers(stamps_ns, ""), *numbers, strict=True)
        make = types[joint_state]
        yield (
            "/joint_states",
            joint_state,
            (make(header, joints, *row) for header, *row in rows),
        )
    if all(name in left and left[name].shape[1:] == (3,) for name in _SENSOR):
        vectors = [left.pop(name) for name in _SENSOR]
        yield _wrenches("/ft_sensor/wrench", vectors, _headers(stamps_ns, "ft_sensor"))
    force, torque = (_pop_vector(left, part) for part in ("force", "torque"))
    if force is not None:
        # A force at the tip has no torque.
        vectors = [force, np.zeros_like(force) if torque is None else torque]
        yield _wrenches(
            f"{labels.prefix}/wrench", vectors, _headers(stamps_ns, labels.frame)
        )
    for name, values in flat_columns(left).items():
        topic = f"{labels.prefix}/{re.sub(r'[^A-Za-z0-9_]', '_', name)}"
        # Without a header: its time stamp is the one of the record.
        kind = "std_msgs/msg/Float64"
        yield topic, kind, map(types[kind], values.tolist())


def _headers(stamps_ns: Sequence[int], frame: str) -> Iterator[Any]:
    types = standard_types().types
    time = types["builtin_interfaces/msg/Time"]
    header = types["std_msgs/msg/Header"]
    return (header(time(*divmod(stamp_ns, NS_PER_S)), frame) for stamp_ns in stamps_ns)


def _pop_vector(columns: dict[str, np.ndarray], part: str) -> np.ndarray | None:
    """Take `force_x_in_...` and so on from the columns, shape (n, 3); None if one is
    missing.
    """
    found: dict[str, str] = {}
    for name, values in columns.items():
        if values.ndim == 1 and (
            match := re.fullmatch(rf"{part}_([xyz])_in_\w+", name)
        ):
            found.setdefault(match[1], name)
    if len(found) < len("xyz"):
        return None
    return np.column_stack([columns.pop(found[xyz]) for xyz in "xyz"])


def _wrenches(name: str, vectors: list[np.ndarray], headers: Iterable[Any]) -> OutTopic:
    kind = "geometry_msgs/msg/WrenchStamped"
    types = standard_types().types
    vector = types["geometry_msgs/msg/Vector3"]
    wrench = types["geometry_msgs/msg/Wrench"]
    force, torque = ([vector(*row) for row in values.tolist()] for values in vectors)
    rows = zip(headers, map(wrench, force, torque), strict=True)
    return name, kind, (types[kind](header, content) for header, content in rows)
