"""ROS messages as columns of numbers; the library `rosbags` has their types."""

import re
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import suppress
from functools import cache, lru_cache
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np

from needleforce.recordings.bags.messages import CDR, ROS1, BagTopic
from needleforce.recordings.channels import KNOWLEDGE, MessageLayout
from needleforce.recordings.errors import (
    UNPACK,
    FormatError,
    optional_library,
)
from needleforce.recordings.table import MAX_LIST_NUMBERS
from needleforce.recordings.time_stamps import NS_PER_S

_NAME_FIELDS = ("name", "names", "joint_names")
"""Fields that name the elements of the arrays beside them."""

_VECTOR_FIELDS = (tuple("xyzw"), tuple("xyz"), tuple("xy"))
"""Fields of messages that are one vector."""

_STAMP_FIELDS = {("header", "stamp", "sec"), ("header", "stamp", "nanosec")}

_TIME_TYPES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")

# Kinds of fields, as rosbags numbers them.
_BASE = 1
_NAME = 2
_ARRAY = 3

_FLOATS = {(_BASE, ("float32", 0)), (_BASE, ("float64", 0))}


@cache
def standard_types() -> Any:
    """Return the type store of ROS's own messages, meant where a bag defines none.

    Raises:
        FileAccessError: rosbags is not installed.
    """
    library = optional_library("rosbags.typesys", "ROS 2 bags")
    return library.get_typestore(library.Stores.ROS2_HUMBLE)


@cache
def _ros1_types() -> Any:
    """Return the type store of ROS 1's own messages."""
    library = optional_library("rosbags.typesys", "ROS 1 bags")
    return library.get_typestore(library.Stores.ROS1_NOETIC)


@lru_cache(maxsize=256)
def _types_of(kind: str, definition: str, encoding: str) -> Any:
    """Return a store with a type as the bag defines it, else as ROS does."""
    standard = _ros1_types() if encoding == ROS1 else standard_types()
    library = optional_library("rosbags.typesys", "ROS 2 bags")
    max_characters = 1 << 18  # longer definitions are not parsed
    if definition and len(definition) <= max_characters:
        # The parser raises whatever a damaged definition makes it run into; some types
        # of a bag are of no interest.
        with suppress(Exception):
            types = dict(library.get_types_from_msg(definition, kind))
            _require_plain(types)
            store = library.get_typestore(library.Stores.EMPTY)
            if encoding == ROS1:
                # Times are part of ROS 1's language, so that bags do not define them.
                defined = standard.fielddefs.items()
                types |= {name: type_ for name, type_ in defined if name in _TIME_TYPES}

            store.register(types)
            store.get_msgdef(kind)
            return store

    if kind not in standard.fielddefs:
        raise FormatError(
            f"holds messages of the type {kind}, without its definition",
            UNPACK,
        )

    return standard


def _require_plain(types: Mapping[str, Any]) -> None:
    """Refuse definitions that would harm the code that `rosbags` generates of them.

    Raises:
        ValueError: A name would not stay a name, or arrays make too much code.
    """
    # `rosbags` generates code for each element of an array of texts or messages.
    unrolled_count = 0
    max_unrolled_count = 2000
    for kind, (constants, fields) in types.items():
        names = [entry[0] for entry in (*constants, *fields)]
        is_type = re.fullmatch(r"[A-Za-z]\w*(/[A-Za-z]\w*)*", kind, re.ASCII)
        are_fields = (re.fullmatch(r"[A-Za-z_]\w*", name, re.ASCII) for name in names)
        if not (is_type and all(are_fields)):
            raise ValueError(f"{kind!r} has names that ROS does not allow")

        for _, (node, details) in fields:
            if node != _ARRAY:
                continue

            (element_node, element_details), length = details
            if element_node == _NAME or element_details[0] == "string":
                unrolled_count += length

    if unrolled_count > max_unrolled_count:
        raise ValueError(f"arrays of {unrolled_count} texts or messages")


class MessageContent(NamedTuple):
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
    """Return how many numbers a value of a message has; None for a single number."""
    return len(value) if isinstance(value, tuple | np.ndarray) else None


_FieldColumn = tuple[tuple[str, ...], Callable[[Any], Any], bool]
"""The fields that lead to a column, what gets its numbers from a message, and whether
these may be any number."""


class TopicDecoder:
    """Decodes the messages of one topic.

    Attributes:
        known: Columns that are channels by the type of the messages, by channel.
        masses: Columns of the mass on the flange: of all, then of its parts.

    A column is called by its topic and the fields that lead to it:
    `/joint_states/position`. Vectors are one column of several numbers:
    `/ft/wrench/force_xyz`. In a `...Stamped` message the one field beside the header
    goes unnamed, and so does `data`: `/depth_mm`.

    Raises:
        FormatError: The topic's type is not known, or it is encoded otherwise.
    """

    def __init__(self, topic: BagTopic) -> None:
        if topic.encoding not in (CDR, ROS1):
            raise FormatError(
                f"is encoded as {topic.encoding!r}; ROS 2 has {CDR!r}",
                UNPACK,
            )

        self._kind = topic.kind
        self._layout = KNOWLEDGE.messages.get(topic.kind, MessageLayout())
        self._types = _types_of(topic.kind, topic.definition, topic.encoding)
        self._deserialize = (
            self._types.deserialize_ros1
            if topic.encoding == ROS1
            else self._types.deserialize_cdr
        )
        try:
            fields = {name for name, _ in self._types.get_msgdef(topic.kind).fields}
            columns = list(self._find_columns((), topic.kind))
        except (KeyError, RecursionError) as error:
            raise FormatError(
                f"has the type {topic.kind}, whose definition is damaged"
            ) from error

        self._has_stamp = {path for path, _, _ in columns} >= _STAMP_FIELDS
        self._name_field = self._find_name_field(fields)
        layout = self._layout
        self.known = {
            channel: _column_name(topic, tuple(field.split("/")))
            for channel, field in layout.channels.items()
        }
        self.masses = tuple(
            _column_name(topic, tuple(field.split("/"))) for field in layout.masses
        )
        left_out = {("header", "seq")}  # what ROS 1 counts in headers is no signal
        left_out |= _STAMP_FIELDS if self._has_stamp else set()
        self._columns = [
            (_column_name(topic, path), get, is_array, path[:-1] in self._named_parts)
            for path, get, is_array in columns
            if path not in left_out
        ]

    def _find_name_field(self, fields: Collection[str]) -> Callable[[Any], Any] | None:
        """Return what gets the joints' names of a message; None if none names joints.

        A message whose joints are named in parts has them in the part that is measured.
        """
        part, slash, _ = self._layout.channels.get("q", "").rpartition("/")
        if slash:
            fields_of_joints = self._layout.channels.values()
            self._named_parts: set[tuple[str, ...]] = {
                tuple(field.split("/"))[:-1] for field in fields_of_joints
            }
            return attrgetter(f"{part}.{_NAME_FIELDS[0]}".replace("/", "."))

        self._named_parts = {()}
        name = next((name for name in _NAME_FIELDS if name in fields), None)
        return None if name is None else attrgetter(name)

    def _find_columns(self, path: tuple[str, ...], kind: str) -> Iterator[_FieldColumn]:
        """Yield where there are numbers in a type: single ones, vectors and arrays."""
        fields = self._types.get_msgdef(kind).fields
        names = tuple(name for name, _ in fields)
        if names in _VECTOR_FIELDS and {field for _, field in fields} <= _FLOATS:
            # Named as in force_xyz.
            vector = "_".join((*path[-1:], "".join(names)))
            get = attrgetter(*(".".join((*path, axis)) for axis in names))
            yield (*path[:-1], vector), get, False
            return

        for name, (node, details) in fields:
            field_path = (*path, name)
            if node == _NAME:
                yield from self._find_columns(field_path, details)
                continue

            is_array = node >= _ARRAY
            element = details[0] if is_array else (node, details)
            if element[0] == _BASE and element[1][0] != "string":
                get = attrgetter(".".join(field_path))
                yield field_path, get, is_array

    def decode(self, data: bytes) -> MessageContent:
        """Decode a message; `FormatError` if it does not fit its type."""
        if data.startswith(b"\x28\xb5\x2f\xfd"):  # of zstd
            raise FormatError("is compressed message by message", UNPACK)

        try:
            message = self._deserialize(data, self._kind)
        except Exception as error:
            # Damaged bytes end in whatever the generated code runs into.
            raise FormatError(f"does not fit its type {self._kind}") from error

        names = self._joint_names(message)
        values = {}
        named = set()
        for column, get, is_array, is_beside_names in self._columns:
            value = get(message)
            if is_array:
                if not 0 < len(value) <= MAX_LIST_NUMBERS:
                    continue
                if is_beside_names and len(value) == len(names):
                    named.add(column)

            values[column] = value

        stamp_ns = None
        if self._has_stamp:
            stamp = message.header.stamp
            stamp_ns = stamp.sec * NS_PER_S + stamp.nanosec

        return MessageContent(stamp_ns, names, values, frozenset(named))

    def _joint_names(self, message: Any) -> tuple[str, ...]:
        """Return the names in a message; none if they identify no joint.

        Empty or repeated names do not: the order of the joints then has to.
        """
        if self._name_field is None:
            return ()

        field = self._name_field(message)
        names = tuple(field) if isinstance(field, list) else ()
        is_unique = all(names) and len(set(names)) == len(names)
        return names if is_unique else ()


def _column_name(topic: BagTopic, path: tuple[str, ...]) -> str:
    """Return the name of a column by its topic and the fields that lead to it."""
    if topic.kind.endswith("Stamped"):
        path = path[1:] or path

    return topic.name if path == ("data",) else "/".join((topic.name, *path))
