"""ROS 2 bags as tables: topics are columns, the messages of one topic are the rows."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from needleforce.recordings.bag_messages import NONE_YET, RawMessage, bag_messages
from needleforce.recordings.bag_topics import TopicInfo, TopicRows, interpolate
from needleforce.recordings.errors import (
    MAX_BYTES,
    ColumnError,
    FormatError,
    optional_library,
    require_size,
)
from needleforce.recordings.follow import FollowOptions
from needleforce.recordings.mapping import ChannelRequest
from needleforce.recordings.table import NS_PER_S, FloatArray, Table, start_of_clock, to_seconds

_SETTLED_NS = NS_PER_S
"""When so much recording has brought no new topic, it is decided which topics are read."""
_AS_MANY = 0.9
"""A topic with this fraction of another's messages counts as equally fast."""
_SHORTEST_LIMIT_S = 0.1
_PERIODS = 5.0
"""So many periods of a topic may lie between two of its messages and still be bridged."""
_LATE_NS = NS_PER_S
"""A topic whose messages come so much later than those of others loses nothing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BagInfo:
    """A bag and its topics by name; `warnings` report what was lost or is damaged."""

    path: Path
    topics: Mapping[str, TopicInfo]
    warnings: tuple[str, ...]

    def table(self) -> Table:
        """Return all columns of the bag without rows, to look columns up by name."""
        topics = self.topics.values()
        widths = {name: width for found in topics for name, width in found.columns.items()}
        if not widths:
            reasons = "; ".join(
                f"{found.topic.name} ({found.topic.kind}) {found.fault or 'holds no numbers'}"
                for found in topics
            )
            raise FormatError(f"{self.path} holds no topic with numbers: {reasons}")
        return Table(
            columns={n: np.empty((0,) if k is None else (0, k)) for n, k in widths.items()},
            joint_names={name: tuple(found.joints) for found in topics for name in found.named},
            warnings=tuple(
                f"{found.topic.name!r}: {found.topic.kind} {found.fault}"
                for found in topics
                if found.fault
            ),
        )


def bag_info(path: Path, max_bytes: int = MAX_BYTES) -> BagInfo:
    """Go through a bag; errors are those of `bag_tables`."""
    optional_library("rosbags.typesys", "ROS 2 bags")
    topics: dict[str, TopicInfo] = {}
    faults: list[str] = []
    for message in bag_messages(path, faults, max_bytes):
        _learn(message, topics)
    if not topics:
        raise FormatError(f"{path} holds no messages{''.join(f' ({fault})' for fault in faults)}")
    if faults:
        count = sum(topic.count for topic in topics.values())
        first_ns = min(topic.first_ns for topic in topics.values())
        last_ns = max(topic.last_ns for topic in topics.values())
        faults = [
            f"{'; '.join(faults)}: {count} messages from {first_ns / NS_PER_S:.3f} s to "
            f"{last_ns / NS_PER_S:.3f} s could be read, what came after, if anything, is lost"
        ]
    return BagInfo(path=path, topics=topics, warnings=tuple(faults))


def _learn(message: RawMessage, topics: dict[str, TopicInfo]) -> None:
    name = message.topic.name
    if name not in topics:
        topics[name] = TopicInfo(topic=message.topic, first_ns=message.log_ns)
    topics[name].learn(message)


class JoinedRows:
    """Rows at the stamps of one topic, the reference; other topics are interpolated to them.

    Args:
        info: what is known of the bag.
        request: which columns the channels are, the reference topic, and the order of joints.
        needed: the columns that are read.

    Raises:
        ColumnError: the mapping does not fit the bag.
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
        self.topics: dict[str, TopicRows] = {}
        self._limits_ns: dict[str, float] = {}
        for name, chosen in columns.items():
            found = info.topics[name]
            joints, notes = _joints(found, request)
            self._warnings += notes
            self.topics[name] = TopicRows(found, chosen, joints)
            limit_s = max(_SHORTEST_LIMIT_S, _PERIODS / max(found.rate_hz, 1e-9))
            self._limits_ns[name] = NS_PER_S * limit_s
        rows, others = info.topics[self.reference], [n for n in columns if n != self.reference]
        # One message more or less is no other rate, only where the recording begins or ends.
        if any(abs(info.topics[name].count - rows.count) > 1 for name in others):
            rates = ", ".join(f"{name} ({info.topics[name].rate_hz:.4g} Hz)" for name in others)
            self._warnings.append(
                f"rows are the messages of {self.reference} ({rows.rate_hz:.4g} Hz); "
                f"interpolated to their stamps: {rates}"
            )
        self._latest_ns = dict.fromkeys(columns, -(1 << 62))
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
            if rows is not None and (message is NONE_YET or reference.pending >= rows):
                self._collect()
                least = 1 if message is NONE_YET else rows
                while (ready := self._ready()) >= least:
                    yield self._table(min(ready, rows))
                self._forget()
        self._collect()
        self._warnings += [note for topic in self.topics.values() for note in topic.notes()]
        while reference.stamps_ns.size or self._is_new or self._warnings:
            yield self._table(rows or reference.stamps_ns.size)

    def _collect(self) -> None:
        for name, topic in self.topics.items():
            topic.collect()
            self._latest_ns[name] = int(topic.stamps_ns.max(initial=self._latest_ns[name]))

    def _ready(self) -> int:
        """Return how many rows nothing that may still come can change."""
        stamps_ns = self.topics[self.reference].stamps_ns
        if not stamps_ns.size:
            return 0
        last_ns = np.maximum.accumulate(stamps_ns)
        until_ns = min(
            max(latest_ns, int(last_ns[-1]) - max(int(self._limits_ns[name]), _LATE_NS) - 1)
            for name, latest_ns in self._latest_ns.items()
        )
        return int(np.searchsorted(last_ns, until_ns, side="right"))

    def _forget(self) -> None:
        """Forget what no row needs that waits or may still come, be it a little late."""
        waiting_ns = self.topics[self.reference].stamps_ns
        oldest_ns = int(waiting_ns.min(initial=max(self._latest_ns.values()) - _LATE_NS))
        for name, topic in self.topics.items():
            if name != self.reference:
                topic.keep(topic.stamps_ns >= oldest_ns - 2 * self._limits_ns[name])

    def _table(self, rows: int) -> Table:
        reference = self.topics[self.reference]
        at_ns = reference.stamps_ns[:rows]
        if self._start_ns is None:
            self._start_ns = start_of_clock(int(at_ns[0])) if at_ns.size else 0
        columns: dict[str, FloatArray] = {"t_s": to_seconds(at_ns, self._start_ns)}
        joints: dict[str, tuple[str, ...]] = {}
        for name, topic in self.topics.items():
            for column, values in topic.values.items():
                found = values[:rows]
                if topic is not reference:
                    found = interpolate(at_ns, topic.stamps_ns, values, self._limits_ns[name])
                columns[column] = found[:, 0] if column in topic.singles else found
            joints |= dict.fromkeys(topic.named, tuple(topic.joints))
        reference.keep(slice(rows, None))
        warnings, self._warnings, self._is_new = tuple(self._warnings), [], False
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


def _joints(found: TopicInfo, request: ChannelRequest) -> tuple[tuple[str, ...], list[str]]:
    """Return the order of a topic's joints, and what was assumed."""
    here, name = tuple(found.joints), found.topic.name
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
    yield from joined.tables(bag_messages(path, [], max_bytes), rows)


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
    silent = replace(options, advance=lambda more: None)
    joined = _settled_rows(path, request, silent, max_bytes)
    if joined is None:
        yield from bag_tables(path, rows, request, max_bytes)
        return
    faults: list[str] = []
    table = None
    for table in joined.tables(bag_messages(path, faults, max_bytes, options), rows):
        yield table
    if faults and table is not None:
        columns = {name: values[:0] for name, values in table.columns.items()}
        yield replace(table, columns=columns, warnings=("; ".join(faults),))


def _settled_rows(
    path: Path, request: ChannelRequest, options: FollowOptions, max_bytes: int
) -> JoinedRows | None:
    """Go through a bag until it is clear what is read; None if it ends before."""
    topics: dict[str, TopicInfo] = {}
    reported, settled_ns = "", 0
    for message in bag_messages(path, [], max_bytes, options):
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
