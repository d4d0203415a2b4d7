"""The messages of one topic as columns of numbers; `rosbags` decodes them."""

import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from functools import cache, lru_cache
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from needleforce.recordings.bag_storage import BagTopic, RawMessage
from needleforce.recordings.errors import FormatError, optional_library
from needleforce.recordings.table import NS_PER_S, FloatArray

STANDARD = "ROS2_HUMBLE"
"""Whose standard messages are meant where a bag holds no definitions."""
CDR = "cdr"
_NAMES = ("name", "names", "joint_names")
"""Fields that name the elements of the arrays beside them."""
_VECTORS = (("x", "y", "z", "w"), ("x", "y", "z"), ("x", "y"))
_STAMP = [("header", "stamp", "sec"), ("header", "stamp", "nanosec")]
_MOST_ELEMENTS = 64
"""Longer arrays are images and point clouds, not signals."""
_LONGEST_DEFINITION = 1 << 18  # characters
_MOST_UNROLLED = 2000
"""`rosbags` generates code for each element of an array of texts or messages."""
_TYPE_NAME = re.compile(r"[A-Za-z]\w*(/[A-Za-z]\w*)*", re.ASCII)
_FIELD_NAME = re.compile(r"[A-Za-z_]\w*", re.ASCII)
_BASE, _NAME, _ARRAY = 1, 2, 3

Path = tuple[str, ...]


@cache
def standard_types() -> Any:
    """Return the type store of ROS's own messages; `FileAccessError` without rosbags."""
    library = optional_library("rosbags.typesys", "ROS 2 bags")
    return library.get_typestore(getattr(library.Stores, STANDARD))


@lru_cache(maxsize=256)
def _types_of(kind: str, definition: str, is_idl: bool) -> Any:
    """Return a store with a type as the bag defines it, else as ROS does."""
    standard = standard_types()
    library = optional_library("rosbags.typesys", "ROS 2 bags")
    unknown = FormatError(f"holds messages of the type {kind}, without its definition")
    if definition and len(definition) <= _LONGEST_DEFINITION:
        try:
            if is_idl:
                # Several files may follow each other, each below a line with its name.
                found = {}
                for part in re.split(r"=+\nIDL: .*\n", definition):
                    found |= library.get_types_from_idl(part) if part.strip() else {}
            else:
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
        raise unknown
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


class TopicColumn(NamedTuple):
    """A column of a topic, called by the topic and the fields that lead to the numbers."""

    name: str
    get: Callable[[Any], Any]  # takes the numbers out of a message
    is_array: bool  # whose length only a message shows
    is_beside_names: bool  # beside the field that names elements


class Content(NamedTuple):
    """What a message holds."""

    stamp_ns: int | None  # of the source; 0 if never set, None if the type has none
    names: tuple[str, ...]  # of joints
    values: dict[str, Any]  # by column; none for arrays that are empty or long
    named: frozenset[str]  # columns with one number for each name


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
        self._types = _types_of(topic.kind, topic.definition, topic.is_idl)
        try:
            places = list(self._places((), topic.kind))
        except (KeyError, RecursionError) as error:
            raise FormatError(f"has the type {topic.kind}, whose definition is damaged") from error
        paths = [path for path, _ in places]
        self.has_stamp = all(path in paths for path in _STAMP)
        if self.has_stamp:
            places = [place for place in places if place[0] not in _STAMP]
        fields = [name for name, _ in self._types.get_msgdef(topic.kind).fields]
        self._names = next((name for name in _NAMES if name in fields), None)
        self.columns = list(self._columns(topic, places))

    def _places(self, path: Path, kind: str) -> Any:
        """Yield the paths to numbers in a type, with the base type, and whether it is an array."""
        for name, (node, rest) in self._types.get_msgdef(kind).fields:
            if node == _NAME:
                yield from self._places((*path, name), rest)
            elif node == _BASE and rest[0] != "string":
                yield (*path, name), (rest[0], False)
            elif node >= _ARRAY and rest[0][0] == _BASE and rest[0][1][0] != "string":
                yield (*path, name), (rest[0][1][0], True)

    def _columns(self, topic: BagTopic, places: list[tuple[Path, Any]]) -> Any:
        at = 0
        while at < len(places):
            path, (_, is_array) = places[at]
            width = next((len(v) for v in _VECTORS if _is_vector(places[at : at + len(v)], v)), 0)
            inside = [".".join(place) for place, _ in places[at : at + (width or 1)]]
            if width:
                components = "".join(place[-1] for place, _ in places[at : at + width])
                path = (*path[:-2], "_".join((*path[-2:-1], components)))
            if topic.kind.endswith("Stamped"):
                path = path[1:] or path
            name = topic.name if path == ("data",) else "/".join((topic.name, *path))
            is_beside = is_array and len(path) == 1
            yield TopicColumn(name, attrgetter(*inside), is_array, is_beside)
            at += width or 1

    def decode(self, data: bytes) -> Content:
        """Decode a message; `FormatError` if it does not fit its type."""
        try:
            message = self._types.deserialize_cdr(data, self._kind)
        except Exception as error:
            # Damaged bytes end in whatever the generated code runs into.
            raise FormatError(f"does not fit its type {self._kind}") from error
        names = self._names_in(message)
        values, named = {}, set()
        for column in self.columns:
            value = column.get(message)
            if column.is_array:
                if not 0 < len(value) <= _MOST_ELEMENTS:
                    continue
                if column.is_beside_names and len(value) == len(names):
                    named.add(column.name)
            values[column.name] = value
        stamp_ns = None
        if self.has_stamp:
            stamp = message.header.stamp
            stamp_ns = stamp.sec * NS_PER_S + stamp.nanosec
        return Content(stamp_ns, names, values, frozenset(named))

    def _names_in(self, message: Any) -> tuple[str, ...]:
        found = getattr(message, self._names) if self._names is not None else []
        names = tuple(found) if isinstance(found, list) else ()
        # Empty or repeated names identify no joint: their order then has to.
        return names if all(names) and len(set(names)) == len(names) else ()


def _is_vector(places: list[tuple[Path, Any]], components: tuple[str, ...]) -> bool:
    return (
        tuple(path[-1] for path, _ in places) == components
        and len({(path[:-1], kind) for path, kind in places}) == 1
        and not places[0][1][1]
    )


_LEARNED = 20
"""Messages of a topic that are looked into."""


@dataclass(slots=True, kw_only=True)
class TopicInfo:
    """What is known of a topic from going through its messages."""

    topic: BagTopic
    count: int = 0
    first_ns: int = 0  # when the first was recorded
    last_ns: int = 0
    columns: dict[str, int | None] = field(default_factory=dict)  # to width, None for one number
    joints: list[str] = field(default_factory=list)  # names of the elements of `named`
    named: set[str] = field(default_factory=set)  # columns whose elements have names
    has_stamp: bool = False  # of the source
    fault: str = ""  # why its messages cannot be read

    @property
    def rate_hz(self) -> float:
        """Messages per second, 0 for fewer than two."""
        span_s = (self.last_ns - self.first_ns) / NS_PER_S
        return (self.count - 1) / span_s if span_s > 0.0 else 0.0

    def learn(self, message: RawMessage) -> None:
        """Count a message, and look at what the first ones hold."""
        self.count += 1
        self.last_ns = max(self.last_ns, message.log_ns)
        if self.count > _LEARNED:
            return
        try:
            decoder = TopicDecoder(self.topic)
            content = decoder.decode(message.data)
        except FormatError as error:
            # One damaged message, the first even, is no reason to lose the topic.
            self.fault = "" if self.columns else str(error)
            return
        self.fault, self.has_stamp = "", decoder.has_stamp
        if content.named:
            self.joints += [name for name in content.names if name not in self.joints]
        self.named |= content.named
        for name, value in content.values.items():
            self.columns.setdefault(name, width_of(value))

    def describe(self) -> str:
        """Return the topic in one line."""
        what = "source stamps" if self.has_stamp else "stamps of the recorder"
        what = self.fault or (what if self.columns else "no numbers")
        return (
            f"{self.topic.name}: {self.topic.kind}, {self.count} messages, {self.rate_hz:.4g} Hz, "
            f"{what}"
        )


def width_of(value: Any) -> int | None:
    """Return how many numbers a value of `Content` holds; None for a single number."""
    return len(value) if isinstance(value, tuple | np.ndarray) else None


class TopicRows(NamedTuple):
    """Messages of one topic: source time stamps, shape (m,), and columns, shape (m, k)."""

    stamps_ns: NDArray[np.int64]
    columns: dict[str, FloatArray]


class TopicReader:
    """Collects the messages of a topic.

    Joints are put where their names say; a joint that a message lacks is NaN. Messages that name
    joints, but none of these, are left out. The time stamp is the header's; where there is none,
    or it was never set, the recorder's.

    Args:
        topic: the topic.
        widths: the columns to read, with how many numbers they have; None for one.
        named: those of them whose elements have names.
        joints: the order of joints in these.
    """

    def __init__(
        self,
        topic: BagTopic,
        widths: Mapping[str, int | None],
        named: Collection[str] = (),
        joints: Collection[str] = (),
    ) -> None:
        self._topic, self._decoder = topic, None
        self._named = frozenset(named)
        self._joints = {joint: place for place, joint in enumerate(joints)}
        self._widths = {
            name: len(self._joints) if name in self._named else width or 1
            for name, width in widths.items()
        }
        self._faults: dict[str, int] = {}
        self._stamps_ns: list[int] = []
        self._values: dict[str, list[Any]] = {name: [] for name in widths}

    def __len__(self) -> int:
        """Return how many messages wait to be taken."""
        return len(self._stamps_ns)

    def add(self, message: RawMessage) -> None:
        """Take a message in."""
        try:
            self._decoder = self._decoder or TopicDecoder(self._topic)
            content = self._decoder.decode(message.data)
        except FormatError:
            self._note("messages that do not fit their type, left out")
            return
        names = content.names
        if self._joints and names and self._joints.keys().isdisjoint(names):
            self._note("messages without any of the joints, left out")
            return
        if names and not self._joints.keys() <= set(names):
            self._note("messages that lack joints")
        stamp_ns = content.stamp_ns
        if stamp_ns == 0 and message.log_ns:
            self._note("messages without a source time stamp; the recorder's was taken")
        self._stamps_ns.append(stamp_ns or message.log_ns)
        for name, rows in self._values.items():
            rows.append(self._row(name, content))

    def _row(self, name: str, content: Content) -> Any:
        """Return the numbers of one column of a message; what does not fit is NaN."""
        width = self._widths[name]
        value = content.values.get(name)
        is_named = name in self._named
        if value is None or is_named != (name in content.named):
            self._note(f"messages without values of {name}, or not one for each joint")
        elif is_named:
            if tuple(self._joints) == content.names:
                return value
            row = np.full(width, np.nan)
            for joint, number in zip(content.names, value, strict=True):
                if joint in self._joints:
                    row[self._joints[joint]] = number
            return row
        elif (width_of(value) or 1) == width:
            return value if isinstance(value, tuple | np.ndarray) else (value,)
        else:
            self._note(f"messages with another number of values of {name}")
        return np.full(width, np.nan)

    def take(self) -> TopicRows:
        """Return what has been added since the last call."""
        stamps_ns = np.array(self._stamps_ns, dtype=np.int64)
        columns = {
            name: np.array(rows, dtype=np.float64).reshape(len(rows), self._widths[name])
            for name, rows in self._values.items()
        }
        self._stamps_ns, self._values = [], {name: [] for name in self._values}
        return TopicRows(stamps_ns, columns)

    def notes(self) -> list[str]:
        """Return what was left out or guessed so far, one sentence each."""
        return [f"{self._topic.name}: {what}: {count}" for what, count in self._faults.items()]

    def _note(self, what: str) -> None:
        self._faults[what] = self._faults.get(what, 0) + 1


def interpolate(
    at_ns: NDArray[np.int64], stamps_ns: NDArray[np.int64], values: FloatArray, limit_ns: float
) -> FloatArray:
    """Interpolate linearly; where stamps agree, the values are taken as they are.

    Args:
        at_ns: where values are wanted, shape (n,).
        stamps_ns: where they are known, shape (m,), in any order.
        values: shape (m, k).
        limit_ns: between stamps further apart than this the result is NaN, as outside them.
    """
    if not stamps_ns.size:
        return np.full((at_ns.size, values.shape[1]), np.nan)
    order = np.argsort(stamps_ns, kind="stable")
    stamps_ns, values = stamps_ns[order], values[order]
    before = np.searchsorted(stamps_ns, at_ns, side="right") - 1
    low = np.clip(before, 0, stamps_ns.size - 1)
    high = np.clip(before + 1, 0, stamps_ns.size - 1)
    span = (stamps_ns[high] - stamps_ns[low]).astype(np.float64)
    inside = (before >= 0) & (span > 0.0) & (span <= limit_ns)
    fraction = np.divide(at_ns - stamps_ns[low], span, out=np.zeros(at_ns.size), where=inside)
    with np.errstate(invalid="ignore"):
        result = values[low] + fraction[:, None] * (values[high] - values[low])
    result[~inside] = np.nan
    exact = (before >= 0) & (stamps_ns[low] == at_ns)
    result[exact] = values[low[exact]]
    return result
