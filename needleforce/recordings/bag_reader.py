"""ROS 2 bags as tables: topics are columns, the messages of one topic are the rows."""

from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from needleforce.recordings.bag_messages import (
    NONE_YET,
    BagTopic,
    RawMessage,
    read_messages,
)
from needleforce.recordings.bag_types import Content, TopicDecoder, size_of
from needleforce.recordings.errors import MAX_BYTES, ColumnError, FormatError
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

MOST_ROWS = 2048  # of a table
_SETTLED_NS = (
    NS_PER_S  # So long without a new topic, and it is decided which topics are read
)
_AS_MANY = (
    0.9  # a topic with this fraction of another's messages counts as equally fast
)
_LEARNED = 20  # messages of a topic that are looked into
_SHORTEST_LIMIT_S = 0.1
_PERIODS = 5.0
"""So many periods of a topic may lie between two of its messages and still be
bridged."""
_LATE_NS = NS_PER_S  # a topic whose messages come so much later than those of others loses nothing


class Topic:
    """A topic of a bag: what its messages hold, and the rows that are collected of it.

    Joints are put where their names say; a joint that a message lacks is NaN. Messages
    that name joints, but none of those chosen, are left out. The time stamp is the
    header's; where there is none, or it was never set, the recorder's.
    """

    def __init__(self, topic: BagTopic, first_ns: int) -> None:
        self.topic = topic
        self.name = topic.name
        self.count = 0
        self.first_ns = self.last_ns = first_ns  # when messages were recorded
        self.columns: dict[str, int | None] = {}  # to width, None for one number
        self.joint_names: list[str] = []  # the elements of `named`
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

    @cached_property
    def _decoder(self) -> TopicDecoder:
        return TopicDecoder(self.topic)

    def learn(self, message: RawMessage) -> None:
        """Count a message, and look at what the first ones hold."""
        self.count += 1
        self.last_ns = max(self.last_ns, message.log_ns)
        if self.count > _LEARNED:
            return
        try:
            content = self._decoder.decode(message.data)
        except FormatError as error:
            # One damaged message, the first even, is no reason to lose the topic.
            self.fault = "" if self.columns else str(error)
            return
        self.fault = ""
        self.has_stamp = content.stamp_ns is not None
        if content.named:
            self.joint_names += [n for n in content.names if n not in self.joint_names]
        self.named |= content.named
        for name, value in content.values.items():
            self.columns.setdefault(name, size_of(value))

    def describe(self) -> str:
        """Return the topic in one line."""
        what = "source stamps" if self.has_stamp else "stamps of the recorder"
        what = self.fault or (what if self.columns else "no numbers")
        seen = f"{self.count} messages, {self.rate_hz:.4g} Hz"
        return f"{self.name}: {self.topic.kind}, {seen}, {what}"

    def choose(self, columns: Collection[str], joints: Collection[str]) -> None:
        """Begin to collect rows of some columns, with the joints in this order."""
        self.joints = tuple(joints)
        self.widths = {
            name: len(self.joints) if name in self.named else self.columns[name] or 1
            for name in columns
        }
        self._faults: Counter[str] = Counter()
        self.rows: list[
            tuple[Any, ...]
        ] = []  # stamp in ns, then the numbers of each column
        self.latest_ns = -(1 << 62)

    def add(self, message: RawMessage) -> None:
        """Take a message in."""
        try:
            content = self._decoder.decode(message.data)
        except FormatError:
            self._faults["messages that do not fit their type, left out"] += 1
            return
        names = content.names
        if names and names != self.joints:
            missing = set(self.joints) - set(names)
            if self.joints and len(missing) == len(self.joints):
                self._faults["messages without any of the joints, left out"] += 1
                return
            if missing:
                self._faults["messages that lack joints"] += 1
        if content.stamp_ns == 0 and message.log_ns:
            self._faults[
                "messages without a source time stamp; the recorder's was taken"
            ] += 1
        stamp_ns = content.stamp_ns or message.log_ns
        self.rows.append(
            (stamp_ns, *(self._numbers(name, content) for name in self.widths))
        )
        self.latest_ns = max(self.latest_ns, stamp_ns)

    def _numbers(self, name: str, content: Content) -> Any:
        """Return the numbers of one column of a message; what does not fit is NaN."""
        width = self.widths[name]
        value = content.values.get(name)
        if value is None or (name in self.named) != (name in content.named):
            self._faults[
                f"messages without values of {name}, or not one for each joint"
            ] += 1
        elif name in self.named:
            if self.joints == content.names:
                return value
            given = dict(zip(content.names, value, strict=True))
            return [given.get(joint, np.nan) for joint in self.joints]
        elif (size_of(value) or 1) == width:
            return value if isinstance(value, tuple | np.ndarray) else (value,)
        else:
            self._faults[f"messages with another number of values of {name}"] += 1
        return np.full(width, np.nan)

    def stamps_ns(self) -> NDArray[np.int64]:
        """Return the time stamps of the rows, shape (n,)."""
        return np.array([row[0] for row in self.rows], dtype=np.int64)

    def values(self) -> dict[str, FloatArray]:
        """Return the numbers of the rows by column, shape (n, k)."""
        return {
            name: np.array([row[i] for row in self.rows], dtype=np.float64).reshape(
                -1, width
            )
            for i, (name, width) in enumerate(self.widths.items(), 1)
        }

    def notes(self) -> list[str]:
        """Return what was left out or guessed so far, one sentence each."""
        return [f"{self.name}: {what}: {count}" for what, count in self._faults.items()]


class Bag:
    """A bag and its topics by name, as far as it was gone through, see
    `learn_topics`.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.topics: dict[str, Topic] = {}
        self.faults: list[str] = []

    def learn(self, message: RawMessage) -> bool:
        """Take a message; return whether its topic is a new one."""
        is_new = message.topic.name not in self.topics
        if is_new:
            self.topics[message.topic.name] = Topic(message.topic, message.log_ns)
        self.topics[message.topic.name].learn(message)
        return is_new

    @property
    def warnings(self) -> list[str]:
        """What was lost or is damaged, and how much there is."""
        if not self.faults:
            return []
        topics = self.topics.values()
        ends = [
            ns / NS_PER_S for topic in topics for ns in (topic.first_ns, topic.last_ns)
        ]
        return [
            f"{'; '.join(self.faults)}: {sum(topic.count for topic in topics)} messages from "
            f"{min(ends):.3f} s to {max(ends):.3f} s could be read, what came after, if anything, "
            "is lost"
        ]

    def table(self) -> Table:
        """Return all columns without rows, to look columns up by name."""
        topics = self.topics.values()
        if not topics:
            faults = "".join(f" ({fault})" for fault in self.faults)
            raise FormatError(f"{self.path} holds no messages{faults}")
        widths = {
            name: width for topic in topics for name, width in topic.columns.items()
        }
        if not widths:
            reasons = (
                f"{topic.name} ({topic.topic.kind}) {topic.fault or 'holds no numbers'}"
                for topic in topics
            )
            raise FormatError(
                f"{self.path} holds no topic with numbers: {'; '.join(reasons)}"
            )
        faults = (f"{t.name!r}: {t.topic.kind} {t.fault}" for t in topics if t.fault)
        return Table(
            columns={
                n: np.empty((0,) if k is None else (0, k)) for n, k in widths.items()
            },
            joint_names={
                n: tuple(topic.joint_names) for topic in topics for n in topic.named
            },
            warnings=tuple(faults),
        )


class JoinedRows:
    """Rows at the stamps of one topic, the reference; other topics are interpolated to
    them.

    Only the needed columns are read; `ColumnError` if the mapping does not fit the bag.
    """

    def __init__(
        self, bag: Bag, request: ChannelRequest, needed: frozenset[str]
    ) -> None:
        columns = {
            name: [column for column in topic.columns if column in needed]
            for name, topic in bag.topics.items()
            if topic.columns.keys() & needed
        }
        chosen = request.mapping.reference_topic
        if chosen is None:
            # A few messages that were lost shall make no difference.
            most = max(bag.topics[name].count for name in columns)
            chosen = next(
                name for name in columns if bag.topics[name].count >= _AS_MANY * most
            )
        elif chosen not in bag.topics or bag.topics[chosen].fault:
            raise ColumnError(
                f"reference_topic = {chosen!r} is no topic that can be read; topics are: "
                f"{', '.join(bag.topics)}"
            )
        self.topics = {name: bag.topics[name] for name in {**columns, chosen: ()}}
        self.reference = rows = self.topics[chosen]
        self._others = [topic for topic in self.topics.values() if topic is not rows]
        self._warnings = bag.warnings
        for name, topic in self.topics.items():
            joints, notes = _joints(topic, request)
            self._warnings += notes
            topic.choose(columns.get(name, ()), joints)
        # One message more or less is no other rate, only where the recording begins or
        # ends.
        if any(abs(topic.count - rows.count) > 1 for topic in self._others):
            rates = ", ".join(
                f"{topic.name} ({topic.rate_hz:.4g} Hz)" for topic in self._others
            )
            self._warnings.append(
                f"rows are the messages of {chosen} ({rows.rate_hz:.4g} Hz); "
                f"interpolated to their stamps: {rates}"
            )
        # before the first table
        self._start_ns = 0
        self._is_new = True

    def tables(self, messages: Iterable[RawMessage]) -> Iterator[Table]:
        """Turn messages into tables of up to `MOST_ROWS`, with `t_s`; none waits at
        `NONE_YET`.
        """
        reference = self.reference
        for count, message in enumerate(messages, 1):
            if message.topic.name in self.topics:
                self.topics[message.topic.name].add(message)
            waits = message is NONE_YET
            if waits or count % MOST_ROWS == 0:
                # Which columns are which channels is decided from the first table.
                while (ready := self._ready()) >= (
                    1 if waits and not self._is_new else HEAD_ROWS
                ):
                    yield self._table(min(ready, MOST_ROWS))
                # What no row needs that waits or may still come, be it a little late,
                # is forgotten.
                newest_ns = max(topic.latest_ns for topic in self.topics.values())
                oldest_ns = min(
                    (row[0] for row in reference.rows), default=newest_ns - _LATE_NS
                )
                for topic in self._others:
                    kept_ns = oldest_ns - 2 * topic.limit_ns
                    topic.rows = [row for row in topic.rows if row[0] >= kept_ns]
        self._warnings += [
            note for topic in self.topics.values() for note in topic.notes()
        ]
        while reference.rows or self._is_new or self._warnings:
            yield self._table(MOST_ROWS)

    def _ready(self) -> int:
        """Return how many rows nothing that may still come can change."""
        if not self.reference.rows:
            return 0
        last_ns = np.maximum.accumulate(self.reference.stamps_ns())
        until_ns = min(
            max(
                topic.latest_ns,
                int(last_ns[-1]) - max(int(topic.limit_ns), _LATE_NS) - 1,
            )
            for topic in self.topics.values()
        )
        return int(np.searchsorted(last_ns, until_ns, side="right"))

    def _table(self, rows: int) -> Table:
        reference = self.reference
        at_ns = reference.stamps_ns()[:rows]
        if self._is_new and at_ns.size:
            self._start_ns = start_of_clock(int(at_ns[0]))
        columns: dict[str, FloatArray] = {"t_s": to_seconds(at_ns, self._start_ns)}
        joints: dict[str, tuple[str, ...]] = {}
        for topic in self.topics.values():
            joints |= dict.fromkeys(topic.named & topic.widths.keys(), topic.joints)
            for column, values in topic.values().items():
                found = values[:rows]
                if topic is not reference:
                    found = interpolate(
                        at_ns, topic.stamps_ns(), values, topic.limit_ns
                    )
                columns[column] = (
                    found[:, 0] if topic.columns[column] is None else found
                )
        del reference.rows[:rows]
        notes = tuple(self._warnings)
        self._warnings = []
        self._is_new = False
        return Table(
            columns=columns, warnings=notes, joint_names=joints, start_ns=self._start_ns
        )


def _joints(topic: Topic, request: ChannelRequest) -> tuple[tuple[str, ...], list[str]]:
    """Return the order of a topic's joints, and what was assumed."""
    here = tuple(topic.joint_names)
    if not here:
        return (), []
    if missing := [joint for joint in request.mapping.joints if joint not in here]:
        raise ColumnError(
            f"joints of the mapping that {topic.name} does not have: {', '.join(missing)}; "
            f"it has: {', '.join(here)}"
        )
    order = request.mapping.joints or request.joints
    if not order or set(order) <= set(here):
        return order or here, []
    return here, [
        f"{topic.name} has the joints {', '.join(here)}, the robot {', '.join(order)}; the order "
        "of the bag was kept, name another one with joints in the mapping"
    ]


def bag_tables(
    path: Path, request: ChannelRequest | None, options: FollowOptions, max_bytes: int
) -> Iterator[Table]:
    """Read a ROS 2 bag in tables of at most `MOST_ROWS`; all its columns without a
    request.

    If a required channel is missing, one table has all columns, without rows. A file is
    read from its start twice: until it is clear which topics are read, and for their
    rows. An MCAP file that is followed is read on as a recorder writes it, until it is
    finished. Raises as `stream_tables`.
    """
    bag = Bag(path)
    growing = options if options.follow else None
    joined = learn_topics(bag, request, growing, max_bytes)
    is_whole = joined is None
    if joined is None:
        if growing is not None:
            # It has ended: now all of it can be counted.
            bag = Bag(path)
            growing = None
            learn_topics(bag, max_bytes=max_bytes)
        whole = bag.table()
        needed = frozenset(whole.columns) if request is None else request.columns(whole)
        if not needed:
            yield whole
            return
        joined = JoinedRows(bag, request or ChannelRequest(), needed)
    faults: list[str] = []
    table = None
    done = 0
    count = joined.reference.count
    for table in joined.tables(read_messages(path, faults, max_bytes, growing)):
        yield table
        done += len(table)
        if is_whole:
            options.progress(done / count)
    if faults and not is_whole and table is not None:
        columns = {name: values[:0] for name, values in table.columns.items()}
        yield replace(table, columns=columns, warnings=("; ".join(faults),))


def learn_topics(
    bag: Bag,
    request: ChannelRequest | None = None,
    growing: FollowOptions | None = None,
    max_bytes: int = MAX_BYTES,
) -> JoinedRows | None:
    """Learn a bag's topics to its end; of a growing one until its rows are clear:
    return these.
    """
    reported = ""
    settled_ns = 0
    for message in read_messages(bag.path, bag.faults, max_bytes, growing):
        if message is NONE_YET:
            continue
        is_new = bag.learn(message)
        if growing is None or not (is_new or message.log_ns >= settled_ns):
            continue
        settled_ns = message.log_ns + _SETTLED_NS
        if is_new:
            # Counted anew from this message on, so that rates are those of the same
            # time.
            for topic in bag.topics.values():
                topic.count = int(topic.first_ns == message.log_ns)
                topic.first_ns = message.log_ns
            continue
        joined, missing = _join(bag, request or ChannelRequest())
        if joined is not None:
            return joined
        if missing not in ("", reported):
            reported = missing
            growing.warn(f"{bag.path.name}: waiting for more topics; {missing}")
    return None


def _join(bag: Bag, request: ChannelRequest) -> tuple[JoinedRows | None, str]:
    """Return what is read, if that is clear; else what is missing, if something is."""
    try:
        needed = request.columns(bag.table())
        if not needed:
            here = ", ".join(bag.topics)
            return (
                None,
                f"needed are {', '.join(request.required)}, and until now there are {here}",
            )
        joined = JoinedRows(bag, request, needed)
    except (ColumnError, FormatError) as error:
        return None, str(error)
    has_rates = all(topic.rate_hz > 0.0 for topic in joined.topics.values())
    return (joined if has_rates else None), ""
