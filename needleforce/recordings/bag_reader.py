"""ROS 2 bags as tables: topics are columns, the messages of one topic are the rows."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from needleforce.recordings.bag_storage import (
    NONE_YET,
    BagFiles,
    RawMessage,
    bag_files,
    bag_messages,
    growing_messages,
)
from needleforce.recordings.bag_topics import TopicInfo, TopicReader, TopicRows, interpolate
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

SETTLED_S = 1.0
"""When so much recording has brought no new topic, it is decided which topics are read."""

_SETTLED_NS = int(SETTLED_S * NS_PER_S)
_AS_MANY = 0.9
"""A topic with this fraction of another's messages counts as equally fast."""
_SHORTEST_LIMIT_S = 0.1
_PERIODS = 5.0
"""So many periods of a topic may lie between two of its messages and still be bridged."""
_LATE_NS = NS_PER_S
"""A topic whose messages come so much later than those of others loses nothing."""
_NEVER_NS = -(1 << 62)


@dataclass(frozen=True, slots=True, kw_only=True)
class BagInfo:
    """A bag and its topics by name; `warnings` report what was lost or is damaged."""

    path: Path
    files: BagFiles
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
    files = bag_files(path)
    topics: dict[str, TopicInfo] = {}
    faults: list[str] = []
    for message in bag_messages(files, faults, max_bytes):
        _topic(message, topics).learn(message)
    warnings = (*files.warnings, *_lost(files, topics, faults))
    if not topics:
        raise FormatError(
            f"{path} holds no messages{''.join(f' ({warning})' for warning in warnings)}"
        )
    return BagInfo(path=path, files=files, topics=topics, warnings=warnings)


def _topic(message: RawMessage, topics: dict[str, TopicInfo]) -> TopicInfo:
    name = message.topic.name
    if name not in topics:
        topics[name] = TopicInfo(topic=message.topic, first_ns=message.log_ns)
    return topics[name]


def _lost(files: BagFiles, topics: Mapping[str, TopicInfo], faults: list[str]) -> list[str]:
    """Say what was read and what is missing, if anything is."""
    count = sum(topic.count for topic in topics.values())
    is_short = files.expected is not None and count < files.expected
    if not (faults or is_short):
        return []
    span = ""
    if topics:
        first_ns = min(topic.first_ns for topic in topics.values())
        last_ns = max(topic.last_ns for topic in topics.values())
        span = f" from {first_ns / NS_PER_S:.3f} s to {last_ns / NS_PER_S:.3f} s"
        span += f" ({(last_ns - first_ns) / NS_PER_S:.3f} s)"
    missing = "what came after, if anything, is lost"
    if files.expected is not None:
        missing = f"{files.expected - count} of {files.expected} are lost"
    what = "; ".join(faults) or "the bag is not whole"
    return [f"{what}: {count} messages{span} could be read, {missing}"]


class BagPlan(NamedTuple):
    """What is read of a bag, and how its messages become rows."""

    columns: Mapping[str, frozenset[str]]  # by topic
    reference: str  # the topic whose messages are the rows
    joints: Mapping[str, tuple[str, ...]]  # in their order, by topic
    notes: tuple[str, ...]  # what was assumed


def plan_bag(info: BagInfo, request: ChannelRequest, needed: frozenset[str]) -> BagPlan:
    """Decide how the needed columns are read; `ColumnError` where the mapping does not fit."""
    topics = {
        name: frozenset(found.columns.keys() & needed)
        for name, found in info.topics.items()
        if found.columns.keys() & needed
    }
    reference = request.mapping.reference_topic
    if reference is None:
        # A few messages that were lost shall make no difference.
        most = max(info.topics[name].count for name in topics)
        reference = next(n for n in topics if info.topics[n].count >= _AS_MANY * most)
    elif reference not in info.topics or info.topics[reference].fault:
        raise ColumnError(
            f"reference_topic = {reference!r} is no topic that can be read; topics are: "
            f"{', '.join(info.topics)}"
        )
    topics.setdefault(reference, frozenset())
    joints, notes = {}, []
    for name in topics:
        joints[name], assumed = _joints(info.topics[name], request)
        notes += assumed
    rows, others = info.topics[reference], [name for name in topics if name != reference]
    # One message more or less is no other rate, only where the recording begins or ends.
    if any(abs(info.topics[name].count - rows.count) > 1 for name in others):
        rates = ", ".join(f"{name} ({info.topics[name].rate_hz:.4g} Hz)" for name in others)
        notes.append(
            f"rows are the messages of {reference} ({rows.rate_hz:.4g} Hz); "
            f"interpolated to their stamps: {rates}"
        )
    return BagPlan(columns=topics, reference=reference, joints=joints, notes=tuple(notes))


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


@dataclass(slots=True)
class _Signal:
    """What is known of a topic and still needed."""

    rows: TopicRows
    limit_ns: float
    latest_ns: int = _NEVER_NS


class _Joiner:
    """Collects messages of the planned topics and gives out rows."""

    def __init__(self, info: BagInfo, plan: BagPlan) -> None:
        self._plan = plan
        self._warnings = [*info.warnings, *plan.notes]
        self.readers: dict[str, TopicReader] = {}
        self._signals: dict[str, _Signal] = {}
        self._joints: dict[str, tuple[str, ...]] = {}
        self._singles: set[str] = set()
        for name, columns in plan.columns.items():
            found = info.topics[name]
            widths = {column: k for column, k in found.columns.items() if column in columns}
            reader = TopicReader(found.topic, widths, found.named, plan.joints[name])
            limit_s = max(_SHORTEST_LIMIT_S, _PERIODS / max(found.rate_hz, 1e-9))
            self.readers[name] = reader
            self._signals[name] = _Signal(reader.take(), NS_PER_S * limit_s)
            self._joints |= dict.fromkeys(columns & found.named, plan.joints[name])
            self._singles |= {column for column, width in widths.items() if width is None}
        self._start_ns: int | None = None
        self._is_new = True

    @property
    def pending(self) -> int:
        """How many messages of the reference topic have not been taken from its reader."""
        return len(self.readers[self._plan.reference])

    @property
    def waiting(self) -> int:
        """How many rows could be given out."""
        return self._signals[self._plan.reference].rows.stamps_ns.size

    @property
    def ready(self) -> int:
        """How many of them nothing that may still come can change."""
        if not self.waiting:
            return 0
        last_ns = np.maximum.accumulate(self._signals[self._plan.reference].rows.stamps_ns)
        until_ns = min(
            max(signal.latest_ns, int(last_ns[-1]) - max(int(signal.limit_ns), _LATE_NS) - 1)
            for signal in self._signals.values()
        )
        return int(np.searchsorted(last_ns, until_ns, side="right"))

    @property
    def has_news(self) -> bool:
        """Whether something is to be reported: that there are columns, or a warning."""
        return self._is_new or bool(self._warnings)

    def take(self) -> None:
        """Take what the readers hold."""
        for name, reader in self.readers.items():
            signal, new = self._signals[name], reader.take()
            signal.latest_ns = int(new.stamps_ns.max(initial=signal.latest_ns))
            signal.rows = TopicRows(
                np.concatenate([signal.rows.stamps_ns, new.stamps_ns]),
                {n: np.concatenate([v, new.columns[n]]) for n, v in signal.rows.columns.items()},
            )

    def end(self) -> None:
        """Take all that is left, and what the readers had to leave out."""
        self.take()
        self._warnings += [note for reader in self.readers.values() for note in reader.notes()]

    def table(self, rows: int) -> Table:
        """Give out rows."""
        at_ns = self._signals[self._plan.reference].rows.stamps_ns[:rows]
        if self._start_ns is None:
            self._start_ns = start_of_clock(int(at_ns[0])) if at_ns.size else 0
        columns: dict[str, FloatArray] = {"t_s": to_seconds(at_ns, self._start_ns)}
        for name, signal in self._signals.items():
            for column, values in signal.rows.columns.items():
                if name == self._plan.reference:
                    found = values[:rows]
                else:
                    found = interpolate(at_ns, signal.rows.stamps_ns, values, signal.limit_ns)
                columns[column] = found[:, 0] if column in self._singles else found
        self._drop(rows, int(at_ns.max()) if at_ns.size else 0)
        warnings, self._warnings, self._is_new = tuple(self._warnings), [], False
        return Table(
            columns=columns,
            warnings=warnings,
            joint_names=self._joints,
            start_ns=self._start_ns,
        )

    def forget(self) -> None:
        """Forget what no row needs that may still come late, while none waits."""
        if not self.waiting:
            newest_ns = max(signal.latest_ns for signal in self._signals.values())
            self._drop(0, newest_ns - _LATE_NS)

    def _drop(self, rows: int, latest_ns: int) -> None:
        """Forget rows, and what no later one needs if the latest was at this instant."""
        for name, signal in self._signals.items():
            stamps_ns = signal.rows.stamps_ns
            if name == self._plan.reference:
                kept = slice(rows, None)
            else:
                # Rows may run backward a little: as much as is bridged is kept.
                kept = stamps_ns >= latest_ns - 2 * signal.limit_ns
            columns = {column: v[kept] for column, v in signal.rows.columns.items()}
            signal.rows = TopicRows(stamps_ns[kept], columns)


def joined_messages(
    messages: Iterable[RawMessage], info: BagInfo, plan: BagPlan, rows: int | None
) -> Iterator[Table]:
    """Turn the messages of the planned topics into tables of at most so many rows, with `t_s`.

    Rows do not wait for what comes after `NONE_YET`.
    """
    joiner = _Joiner(info, plan)
    for message in messages:
        if message is not NONE_YET:
            joiner.readers[message.topic.name].add(message)
        if rows is not None and (message is NONE_YET or joiner.pending >= rows):
            joiner.take()
            least = 1 if message is NONE_YET else rows
            while (ready := joiner.ready) >= least:
                yield joiner.table(min(ready, rows))
            joiner.forget()
    joiner.end()
    while joiner.waiting or joiner.has_news:
        yield joiner.table(rows or joiner.waiting)


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
    plan = plan_bag(info, request or ChannelRequest(), needed)
    if rows is None:
        widths = {n: k or 1 for t in info.topics.values() for n, k in t.columns.items()}
        count = info.topics[plan.reference].count
        size = 8 * count * sum(widths[n] for names in plan.columns.values() for n in names)
        require_size(size, max_bytes, f"{path}: what is read of it")
    messages = bag_messages(info.files, [], max_bytes, plan.columns)
    yield from joined_messages(messages, info, plan, rows)


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
    begun = _settled_plan(path, request, silent, max_bytes)
    if begun is None:
        yield from bag_tables(path, rows, request, max_bytes)
        return
    info, plan = begun
    faults: list[str] = []
    messages = growing_messages(path, options, faults, max_bytes, plan.columns)
    table = None
    for table in joined_messages(messages, info, plan, rows):
        yield table
    if faults and table is not None:
        yield Table(
            columns={name: values[:0] for name, values in table.columns.items()},
            warnings=("; ".join(faults),),
            joint_names=table.joint_names,
            start_ns=table.start_ns,
        )


def _settled_plan(
    path: Path, request: ChannelRequest, options: FollowOptions, max_bytes: int
) -> tuple[BagInfo, BagPlan] | None:
    """Go through a bag until it is clear what is read; None if it ends before."""
    topics: dict[str, TopicInfo] = {}
    reported, settled_ns = "", 0
    for message in growing_messages(path, options, [], max_bytes):
        if message is NONE_YET:
            continue
        if message.topic.name not in topics:
            # Counted anew from here, so that rates are those of the same time.
            for found in topics.values():
                found.count, found.first_ns = 0, message.log_ns
            settled_ns = message.log_ns + _SETTLED_NS
        _topic(message, topics).learn(message)
        if message.log_ns < settled_ns:
            continue
        settled_ns = message.log_ns + _SETTLED_NS
        info = BagInfo(path=path, files=BagFiles(paths=(path,)), topics=topics, warnings=())
        plan, missing = _plan(info, request)
        if plan is not None:
            return info, plan
        if missing not in ("", reported):
            reported = missing
            options.warn(f"{path.name}: waiting for more topics; {missing}")
    return None


def _plan(info: BagInfo, request: ChannelRequest) -> tuple[BagPlan | None, str]:
    """Return what is read, if that is clear; else what is missing, if something is."""
    try:
        needed = request.columns(info.table())
        if not needed:
            here = ", ".join(info.topics)
            return None, f"needed are {', '.join(request.required)}, and until now there are {here}"
        plan = plan_bag(info, request, needed)
    except (ColumnError, FormatError) as error:
        return None, str(error)
    has_rates = all(info.topics[name].rate_hz > 0.0 for name in plan.columns)
    return (plan, "") if has_rates else (None, "")
