"""ROS 2 bags as tables: topics are columns, the messages of one topic are the rows."""

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from needleforce.recordings.bag_messages import NONE_YET, BagTopic, RawMessage, read_messages
from needleforce.recordings.bag_types import Content, TopicDecoder, width_of
from needleforce.recordings.errors import MAX_BYTES, ColumnError, FormatError, require_size
from needleforce.recordings.follow import FollowOptions
from needleforce.recordings.mapping import ChannelRequest
from needleforce.recordings.table import (
    HEAD_ROWS,
    NS_PER_S,
    FloatArray,
    Table,
    interpolate,
    start_of_clock,
    to_seconds,
)

_SETTLED_NS = NS_PER_S
"""When so much recording has brought no new topic, it is decided which topics are read."""
_AS_MANY = 0.9
"""A topic with this fraction of another's messages counts as equally fast."""
_LEARNED = 20
"""Messages of a topic that are looked into."""
_SHORTEST_LIMIT_S = 0.1
_PERIODS = 5.0
"""So many periods of a topic may lie between two of its messages and still be bridged."""
_LATE_NS = NS_PER_S
"""A topic whose messages come so much later than those of others loses nothing."""


class Topic:
    """A topic of a bag: what its messages hold, and the rows that are collected of it.

    Joints are put where their names say; a joint that a message lacks is NaN. Messages that name
    joints, but none of those chosen, are left out. The time stamp is the header's; where there is
    none, or it was never set, the recorder's.
    """

    def __init__(self, topic: BagTopic, first_ns: int) -> None:
        self.topic, self.count = topic, 0
        self.first_ns = self.last_ns = first_ns  # when messages were recorded
        self.columns: dict[str, int | None] = {}  # to width, None for one number
        self.names: list[str] = []  # of joints, the elements of `named`
        self.named: set[str] = set()  # columns whose elements have names
        self.has_stamp = False  # of the source
        self.fault = ""  # why its messages cannot be read
        self.choose((), ())

    @property
    def rate_hz(self) -> float:
        """Messages per second, 0 for fewer than two."""
        span_s = (self.last_ns - self.first_ns) / NS_PER_S
        return (self.count - 1) / span_s if span_s > 0.0 else 0.0

    @property
    def limit_ns(self) -> float:
        """How far apart messages may be for interpolation between them."""
        return NS_PER_S * max(_SHORTEST_LIMIT_S, _PERIODS / max(self.rate_hz, 1e-9))

    def learn(self, message: RawMessage) -> None:
        """Count a message, and look at what the first ones hold."""
        self.count += 1
        self.last_ns = max(self.last_ns, message.log_ns)
        if self.count > _LEARNED:
            return
        try:
            self._decoder = self._decoder or TopicDecoder(self.topic)
            content = self._decoder.decode(message.data)
        except FormatError as error:
            # One damaged message, the first even, is no reason to lose the topic.
            self.fault = "" if self.columns else str(error)
            return
        self.fault, self.has_stamp = "", self._decoder.has_stamp
        if content.named:
            self.names += [name for name in content.names if name not in self.names]
        self.named |= content.named
        for name, value in content.values.items():
            self.columns.setdefault(name, width_of(value))

    def describe(self) -> str:
        """Return the topic in one line."""
        what = "source stamps" if self.has_stamp else "stamps of the recorder"
        what = self.fault or (what if self.columns else "no numbers")
        topic = f"{self.topic.name}: {self.topic.kind}"
        return f"{topic}, {self.count} messages, {self.rate_hz:.4g} Hz, {what}"

    def choose(self, columns: Collection[str], joints: Collection[str]) -> None:
        """Begin to collect rows of some columns, with the joints in this order."""
        self._decoder: TopicDecoder | None = None
        self.joints = {joint: place for place, joint in enumerate(joints)}
        self._widths = {
            name: len(self.joints) if name in self.named else self.columns[name] or 1
            for name in columns
        }
        self._faults: dict[str, int] = {}
        self.new_ns: list[int] = []
        self._new: dict[str, list[Any]] = {name: [] for name in columns}
        self.stamps_ns: NDArray[np.int64] = np.empty(0, dtype=np.int64)
        self.values = {name: np.empty((0, width)) for name, width in self._widths.items()}
        self.latest_ns = -(1 << 62)

    def add(self, message: RawMessage) -> None:
        """Take a message in."""
        try:
            self._decoder = self._decoder or TopicDecoder(self.topic)
            content = self._decoder.decode(message.data)
        except FormatError:
            self._note("messages that do not fit their type, left out")
            return
        names = content.names
        if self.joints and names and self.joints.keys().isdisjoint(names):
            self._note("messages without any of the joints, left out")
            return
        if names and not self.joints.keys() <= set(names):
            self._note("messages that lack joints")
        if content.stamp_ns == 0 and message.log_ns:
            self._note("messages without a source time stamp; the recorder's was taken")
        self.new_ns.append(content.stamp_ns or message.log_ns)
        for name, rows in self._new.items():
            rows.append(self._row(name, content))

    def _row(self, name: str, content: Content) -> Any:
        """Return the numbers of one column of a message; what does not fit is NaN."""
        width, value = self._widths[name], content.values.get(name)
        row = np.full(width, np.nan)
        if value is None or (name in self.named) != (name in content.named):
            self._note(f"messages without values of {name}, or not one for each joint")
        elif name in self.named:
            if tuple(self.joints) == content.names:
                return value
            for joint, number in zip(content.names, value, strict=True):
                if joint in self.joints:
                    row[self.joints[joint]] = number
        elif (width_of(value) or 1) == width:
            return value if isinstance(value, tuple | np.ndarray) else (value,)
        else:
            self._note(f"messages with another number of values of {name}")
        return row

    def collect(self) -> None:
        """Append what was taken in to the rows."""
        if not self.new_ns:
            return
        self.stamps_ns = np.append(self.stamps_ns, np.array(self.new_ns, dtype=np.int64))
        for name, rows in self._new.items():
            new = np.array(rows, dtype=np.float64).reshape(len(rows), self._widths[name])
            self.values[name] = np.concatenate([self.values[name], new])
            rows.clear()
        self.new_ns.clear()
        self.latest_ns = int(self.stamps_ns.max(initial=self.latest_ns))

    def keep(self, rows: Any) -> None:
        """Forget all other rows."""
        self.stamps_ns = self.stamps_ns[rows]
        self.values = {name: values[rows] for name, values in self.values.items()}

    def notes(self) -> list[str]:
        """Return what was left out or guessed so far, one sentence each."""
        return [f"{self.topic.name}: {what}: {count}" for what, count in self._faults.items()]

    def _note(self, what: str) -> None:
        self._faults[what] = self._faults.get(what, 0) + 1


@dataclass(frozen=True, slots=True, kw_only=True)
class BagInfo:
    """A bag and its topics by name; `warnings` report what was lost or is damaged."""

    path: Path
    topics: Mapping[str, Topic]
    warnings: tuple[str, ...]

    def table(self) -> Table:
        """Return all columns of the bag without rows, to look columns up by name."""
        topics = self.topics.values()
        widths = {name: width for found in topics for name, width in found.columns.items()}
        if not widths:
            reasons = (
                f"{found.topic.name} ({found.topic.kind}) {found.fault or 'holds no numbers'}"
                for found in topics
            )
            raise FormatError(f"{self.path} holds no topic with numbers: {'; '.join(reasons)}")
        faults = (f"{t.topic.name!r}: {t.topic.kind} {t.fault}" for t in topics if t.fault)
        return Table(
            columns={n: np.empty((0,) if k is None else (0, k)) for n, k in widths.items()},
            joint_names={name: tuple(found.names) for found in topics for name in found.named},
            warnings=tuple(faults),
        )


def bag_info(path: Path, max_bytes: int = MAX_BYTES) -> BagInfo:
    """Go through a bag; errors are those of `bag_tables`."""
    topics: dict[str, Topic] = {}
    faults: list[str] = []
    for message in read_messages(path, faults, max_bytes):
        _learn(message, topics)
    if not topics:
        raise FormatError(f"{path} holds no messages{''.join(f' ({fault})' for fault in faults)}")
    if faults:
        count = sum(topic.count for topic in topics.values())
        ends = [ns / NS_PER_S for t in topics.values() for ns in (t.first_ns, t.last_ns)]
        faults = [
            f"{'; '.join(faults)}: {count} messages from {min(ends):.3f} s to {max(ends):.3f} s "
            "could be read, what came after, if anything, is lost"
        ]
    return BagInfo(path=path, topics=topics, warnings=tuple(faults))


def _learn(message: RawMessage, topics: dict[str, Topic]) -> None:
    if message.topic.name not in topics:
        topics[message.topic.name] = Topic(message.topic, message.log_ns)
    topics[message.topic.name].learn(message)


class JoinedRows:
    """Rows at the stamps of one topic, the reference; other topics are interpolated to them.

    Only the needed columns are read; `ColumnError` if the mapping does not fit the bag.
    """

    def __init__(self, info: BagInfo, request: ChannelRequest, needed: frozenset[str]) -> None:
        columns = {
            name: [column for column in found.columns if column in needed]
            for name, found in info.topics.items()
            if found.columns.keys() & needed
        }
        self.reference = _reference_topic(info, request.mapping.reference_topic, list(columns))
        columns.setdefault(self.reference, [])
        self._warnings = list(info.warnings)
        self.topics = {name: info.topics[name] for name in columns}
        for name, found in self.topics.items():
            joints, notes = _joints(found, request)
            self._warnings += notes
            found.choose(columns[name], joints)
        rows, others = info.topics[self.reference], [n for n in columns if n != self.reference]
        # One message more or less is no other rate, only where the recording begins or ends.
        if any(abs(info.topics[name].count - rows.count) > 1 for name in others):
            rates = ", ".join(f"{name} ({info.topics[name].rate_hz:.4g} Hz)" for name in others)
            self._warnings.append(
                f"rows are the messages of {self.reference} ({rows.rate_hz:.4g} Hz); "
                f"interpolated to their stamps: {rates}"
            )
        self._start_ns: int | None = None
        self._is_new = True

    def tables(self, messages: Iterable[RawMessage], rows: int | None) -> Iterator[Table]:
        """Turn the messages of the topics into tables of at most so many rows, with `t_s`.

        Rows do not wait for what comes after `NONE_YET`; with no limit all come at once.
        """
        reference = self.topics[self.reference]
        for message in messages:
            if message.topic.name in self.topics:
                self.topics[message.topic.name].add(message)
            is_pause = message is NONE_YET
            if rows is not None and (is_pause or len(reference.new_ns) >= rows):
                # Which columns are which channels is decided from the first table.
                while (ready := self._ready()) >= (
                    1 if is_pause and not self._is_new else min(rows, HEAD_ROWS)
                ):
                    yield self._table(min(ready, rows))
                self._forget()
        self._ready()
        self._warnings += [note for topic in self.topics.values() for note in topic.notes()]
        while reference.stamps_ns.size or self._is_new or self._warnings:
            yield self._table(rows or reference.stamps_ns.size)

    def _ready(self) -> int:
        """Collect what has come; return how many rows nothing that may still come can change."""
        for topic in self.topics.values():
            topic.collect()
        stamps_ns = self.topics[self.reference].stamps_ns
        if not stamps_ns.size:
            return 0
        last_ns = np.maximum.accumulate(stamps_ns)
        until_ns = min(
            max(topic.latest_ns, int(last_ns[-1]) - max(int(topic.limit_ns), _LATE_NS) - 1)
            for topic in self.topics.values()
        )
        return int(np.searchsorted(last_ns, until_ns, side="right"))

    def _forget(self) -> None:
        """Forget what no row needs that waits or may still come, be it a little late."""
        waiting_ns = self.topics[self.reference].stamps_ns
        newest_ns = max(topic.latest_ns for topic in self.topics.values())
        oldest_ns = int(waiting_ns.min(initial=newest_ns - _LATE_NS))
        for topic in self.topics.values():
            if topic is not self.topics[self.reference]:
                topic.keep(topic.stamps_ns >= oldest_ns - 2 * topic.limit_ns)

    def _table(self, rows: int) -> Table:
        reference = self.topics[self.reference]
        at_ns = reference.stamps_ns[:rows]
        if self._start_ns is None:
            self._start_ns = start_of_clock(int(at_ns[0])) if at_ns.size else 0
        columns: dict[str, FloatArray] = {"t_s": to_seconds(at_ns, self._start_ns)}
        for topic in self.topics.values():
            for column, values in topic.values.items():
                found = values[:rows]
                if topic is not reference:
                    found = interpolate(at_ns, topic.stamps_ns, values, topic.limit_ns)
                columns[column] = found[:, 0] if topic.columns[column] is None else found
        reference.keep(slice(rows, None))
        warnings, self._warnings, self._is_new = tuple(self._warnings), [], False
        named = ((t, column) for t in self.topics.values() for column in t.named & t.values.keys())
        joints = {column: tuple(topic.joints) for topic, column in named}
        return Table(
            columns=columns, warnings=warnings, joint_names=joints, start_ns=self._start_ns
        )


def _reference_topic(info: BagInfo, name: str | None, needed: list[str]) -> str:
    if name is None:
        # A few messages that were lost shall make no difference.
        most = max(info.topics[topic].count for topic in needed)
        return next(topic for topic in needed if info.topics[topic].count >= _AS_MANY * most)
    if name not in info.topics or info.topics[name].fault:
        raise ColumnError(
            f"reference_topic = {name!r} is no topic that can be read; topics are: "
            f"{', '.join(info.topics)}"
        )
    return name


def _joints(found: Topic, request: ChannelRequest) -> tuple[tuple[str, ...], list[str]]:
    """Return the order of a topic's joints, and what was assumed."""
    here, name = tuple(found.names), found.topic.name
    if not here:
        return (), []
    if missing := [joint for joint in request.mapping.joints if joint not in here]:
        raise ColumnError(
            f"joints of the mapping that {name} does not have: {', '.join(missing)}; "
            f"it has: {', '.join(here)}"
        )
    order = request.mapping.joints or request.joints
    if not order or set(order) <= set(here):
        return order or here, []
    return here, [
        f"{name} has the joints {', '.join(here)}, the robot {', '.join(order)}; the order of the "
        "bag was kept, name another one with joints in the mapping"
    ]


def bag_tables(
    path: Path,
    rows: int | None = None,
    request: ChannelRequest | None = None,
    max_bytes: int = MAX_BYTES,
) -> Iterator[Table]:
    """Read a ROS 2 bag in tables of at most so many rows, all at once if None.

    The messages of one topic are the rows, those of others are interpolated to its time stamps.
    A cut or damaged MCAP file yields what can be read of it, and the warnings say what was lost.
    If a required channel is missing, one table has all columns, without rows.

    Raises:
        FileAccessError: the bag cannot be read, or rosbags is not installed.
        FormatError: it is not a bag, or holds no messages or no numbers, or too much.
        ColumnError: a mapped channel was not found, or is ambiguous.
    """
    info = bag_info(path, max_bytes)
    whole = info.table()
    needed = frozenset(whole.columns) if request is None else request.columns(whole)
    if not needed:
        yield whole
        return
    joined = JoinedRows(info, request or ChannelRequest(), needed)
    if rows is None:
        widths = {n: k or 1 for found in info.topics.values() for n, k in found.columns.items()}
        size = 8 * info.topics[joined.reference].count * sum(widths[name] for name in needed)
        require_size(size, max_bytes, f"{path}: what is read of it")
    yield from joined.tables(read_messages(path, [], max_bytes), rows)


def growing_bag_tables(
    path: Path,
    rows: int,
    request: ChannelRequest,
    options: FollowOptions,
    max_bytes: int = MAX_BYTES,
) -> Iterator[Table]:
    """Read an MCAP file as a recorder writes it, until it finishes the file, see `bag_tables`.

    The file is read from its start twice: until it is clear which topics are read, and then on as
    it grows. Rows come as soon as nothing that may still come can change them.
    """
    joined = _settled_rows(path, request, replace(options, advance=lambda more: None), max_bytes)
    if joined is None:
        yield from bag_tables(path, rows, request, max_bytes)
        return
    faults: list[str] = []
    table = None
    for table in joined.tables(read_messages(path, faults, max_bytes, options), rows):
        yield table
    if faults and table is not None:
        columns = {name: values[:0] for name, values in table.columns.items()}
        yield replace(table, columns=columns, warnings=("; ".join(faults),))


def _settled_rows(
    path: Path, request: ChannelRequest, options: FollowOptions, max_bytes: int
) -> JoinedRows | None:
    """Go through a bag until it is clear what is read; None if it ends before."""
    topics: dict[str, Topic] = {}
    reported, settled_ns = "", 0
    for message in read_messages(path, [], max_bytes, options):
        if message is NONE_YET:
            continue
        if message.topic.name not in topics:
            # Counted anew from here, so that rates are those of the same time.
            for found in topics.values():
                found.count, found.first_ns = 0, message.log_ns
            settled_ns = message.log_ns + _SETTLED_NS
        _learn(message, topics)
        if message.log_ns < settled_ns:
            continue
        settled_ns = message.log_ns + _SETTLED_NS
        joined, missing = _join(BagInfo(path=path, topics=topics, warnings=()), request)
        if joined is not None:
            return joined
        if missing not in ("", reported):
            reported = missing
            options.warn(f"{path.name}: waiting for more topics; {missing}")
    return None


def _join(info: BagInfo, request: ChannelRequest) -> tuple[JoinedRows | None, str]:
    """Return what is read, if that is clear; else what is missing, if something is."""
    try:
        needed = request.columns(info.table())
        if not needed:
            here = ", ".join(info.topics)
            return None, f"needed are {', '.join(request.required)}, and until now there are {here}"
        joined = JoinedRows(info, request, needed)
    except (ColumnError, FormatError) as error:
        return None, str(error)
    has_rates = all(info.topics[name].rate_hz > 0.0 for name in joined.topics)
    return (joined if has_rates else None), ""
