"""ROS bags as tables: topics are columns, the messages of one topic are the rows.

Those of the others are interpolated to them.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from foundation.arrays import Array
from needleforce.recordings.bags.message_reader import read_messages
from needleforce.recordings.bags.messages import NONE_YET, RawMessage
from needleforce.recordings.bags.topics import Bag, Topic
from needleforce.recordings.channel_request import ChannelRequest
from needleforce.recordings.errors import MAX_BYTES, ColumnError, FormatError
from needleforce.recordings.follow import FollowOptions
from needleforce.recordings.joint_names import order_joints
from needleforce.recordings.table import HEAD_ROWS, Table
from needleforce.recordings.time_stamps import (
    NS_PER_S,
    first_valid_stamp,
    interpolate,
    start_of_clock,
    to_seconds,
)

MAX_TABLE_ROWS = 2048
"""Of one table."""

LATE_NS = NS_PER_S
"""A topic whose messages come so much later than those of others loses nothing."""


class JoinedRows:
    """Rows at the stamps of one topic, the reference; others are interpolated to them.

    Args:
        bag: The bag, whose topics are known.
        request: Which topic is the reference, and in which order joints are.
        needed: Names of the columns that are read.

    Attributes:
        topics: That are read, by name.
        reference: The topic whose messages are the rows.

    Raises:
        ColumnError: The mapping does not fit the bag.
    """

    def __init__(
        self, bag: Bag, request: ChannelRequest, needed: frozenset[str]
    ) -> None:
        columns = {
            name: [column for column in topic.columns if column in needed]
            for name, topic in bag.topics.items()
            if topic.columns.keys() & needed
        }
        reference_name = _choose_reference(bag, request, columns)
        self.topics = {
            name: bag.topics[name] for name in {**columns, reference_name: ()}
        }
        self.reference = self.topics[reference_name]
        self._others = [
            topic for topic in self.topics.values() if topic is not self.reference
        ]
        self._warnings = bag.warnings
        for name, topic in self.topics.items():
            order, notes = order_joints(
                name, topic.joint_names, request.mapping, request.joints
            )
            self._warnings += notes
            topic.choose(columns.get(name, ()), order)

        self._warnings += self._rate_warnings()
        self._warnings += _current_warnings(self.topics.values(), request)
        self._warnings += self._put_on_one_clock()
        self._tool_mass = bag.tool_mass
        self._known = {
            channel: chosen
            for channel, names in bag.known.items()
            if (chosen := tuple(name for name in names if name in needed))
        }
        self._start_ns = 0
        self._is_new = True  # before the first table

    def _put_on_one_clock(self) -> list[str]:
        """Put messages without a stamp on the clock of those that have one.

        Returns:
            A note if that is another clock than the recorder's, as in simulation.
        """
        topics = (self.reference, *self._others)
        source = next((topic for topic in topics if topic.has_stamp), None)
        if source is None or abs(source.offset_ns) <= LATE_NS:
            return []

        unstamped = [topic for topic in topics if not topic.has_stamp]
        for topic in unstamped:
            topic.source = source

        names = ", ".join(topic.name for topic in unstamped)
        if not unstamped:
            return []

        return [
            f"{names} has no source time stamps and was put on the clock of "
            f"{source.name}, {source.offset_ns / NS_PER_S:.6g} s from the recorder's"
        ]

    def _rate_warnings(self) -> list[str]:
        """Return a note if topics differ in rate, and are interpolated therefore.

        One message more or less is no other rate, only where the recording begins or
        ends.
        """
        rows = self.reference
        if all(abs(topic.count - rows.count) <= 1 for topic in self._others):
            return []

        rates = ", ".join(
            f"{topic.name} ({topic.rate_hz:.4g} Hz)" for topic in self._others
        )
        return [
            f"rows are the messages of {rows.name} ({rows.rate_hz:.4g} Hz); "
            f"interpolated to their stamps: {rates}"
        ]

    def tables(self, messages: Iterable[RawMessage]) -> Iterator[Table]:
        """Turn messages into tables of up to `MAX_TABLE_ROWS`, with a column `t_s`.

        At `NONE_YET` no row that is complete waits.
        """
        for count, message in enumerate(messages, 1):
            topic = self.topics.get(message.topic.name)
            if topic is not None:
                topic.add(message)

            is_waiting = message is NONE_YET
            if is_waiting or count % MAX_TABLE_ROWS == 0:
                yield from self._ready_tables(is_waiting=is_waiting)
                self._forget_old_rows()

        for topic in self.topics.values():
            self._warnings += topic.notes()

        while self.reference.rows or self._is_new or self._warnings:
            yield self._take_table(MAX_TABLE_ROWS)

    def _ready_tables(self, *, is_waiting: bool) -> Iterator[Table]:
        """Yield rows that are complete, once there are enough of them.

        Which columns are which channels is decided from the first table, so that one is
        not short.
        """
        min_rows = 1 if is_waiting and not self._is_new else HEAD_ROWS
        ready_rows = self._count_ready()
        while ready_rows >= min_rows:
            yield self._take_table(min(ready_rows, MAX_TABLE_ROWS))
            min_rows = 1 if is_waiting else HEAD_ROWS
            ready_rows = self._count_ready()

    def _forget_old_rows(self) -> None:
        """Drop rows that no row needs that waits, or may still come a little late."""
        newest_ns = max(topic.latest_ns for topic in self.topics.values())
        waiting_ns = (stamp_ns for stamp_ns, _ in self.reference.rows)
        oldest_ns = min(waiting_ns, default=newest_ns - LATE_NS)
        for topic in self._others:
            kept_from_ns = oldest_ns - 2 * topic.limit_ns
            topic.rows = [row for row in topic.rows if row[0] >= kept_from_ns]

    def _count_ready(self) -> int:
        """Return how many rows nothing that may still come can change."""
        if not self.reference.rows:
            return 0

        latest_ns = np.maximum.accumulate(self.reference.stamps_ns())
        complete_ns = min(
            max(
                topic.latest_ns,
                int(latest_ns[-1]) - max(int(topic.limit_ns), LATE_NS) - 1,
            )
            for topic in self.topics.values()
        )
        return int(np.searchsorted(latest_ns, complete_ns, side="right"))

    def _take_table(self, row_count: int) -> Table:
        """Return the first rows as a table, and drop them."""
        reference = self.reference
        at_ns = reference.stamps_ns()[:row_count]
        if self._is_new and at_ns.size:
            self._start_ns = start_of_clock(first_valid_stamp(at_ns))

        columns: dict[str, Array] = {"t_s": to_seconds(at_ns, self._start_ns)}
        joint_names: dict[str, tuple[str, ...]] = {}
        for topic in self.topics.values():
            named = topic.named & topic.widths.keys()
            joint_names |= dict.fromkeys(named, topic.joints)
            for name, values in topic.values().items():
                if topic is reference:
                    numbers = values[:row_count]
                else:
                    numbers = interpolate(
                        at_ns, topic.stamps_ns(), values, topic.limit_ns
                    )

                is_single = topic.columns[name] is None
                columns[name] = numbers[:, 0] if is_single else numbers

        del reference.rows[:row_count]
        warnings = tuple(self._warnings)
        self._warnings = []
        self._is_new = False
        return Table(
            columns=columns,
            warnings=warnings,
            joint_names=joint_names,
            start_ns=self._start_ns,
            known=self._known,
            tool_mass=self._tool_mass,
        )


def bag_tables(
    path: Path, request: ChannelRequest | None, options: FollowOptions, max_bytes: int
) -> Iterator[Table]:
    """Read a ROS bag in tables of at most `MAX_TABLE_ROWS`.

    A file is read from its start twice: until it is clear which topics are read, and
    for their rows. An MCAP file that is followed is read on as a recorder writes it,
    until it is finished.

    Args:
        path: Of the bag, a file or a folder.
        request: Which channels are read; None for all columns.
        options: Whether more is waited for.
        max_bytes: See `stream_tables`.

    Yields:
        Tables of consecutive rows; if a required channel is missing, one with all
        columns and no rows.

    Raises:
        RecordingError: As `stream_tables` does.
    """
    if options.follow:
        bag = Bag(path)
        joined = learn_topics(bag, request, options, max_bytes)
        if joined is not None:
            yield from _growing_tables(bag, joined, options, max_bytes)
            return

    # It is whole, or has ended: all of it can be counted.
    bag = Bag(path)
    learn_topics(bag, max_bytes=max_bytes)
    table = bag.table()
    needed = frozenset(table.columns) if request is None else request.columns(table)
    if not needed:
        yield table
        return

    joined = JoinedRows(bag, request or ChannelRequest(), needed)
    row_count = 0
    for table in joined.tables(read_messages(path, [], max_bytes)):
        yield table
        row_count += len(table)
        options.progress(row_count / joined.reference.count)


def _growing_tables(
    bag: Bag, joined: JoinedRows, options: FollowOptions, max_bytes: int
) -> Iterator[Table]:
    """Yield rows as they are recorded, then what is wrong with the file."""
    faults: list[str] = []
    table = None
    messages = read_messages(bag.path, faults, max_bytes, options)
    for table in joined.tables(messages):
        yield table

    if faults and table is not None:
        columns = {name: values[:0] for name, values in table.columns.items()}
        yield replace(table, columns=columns, warnings=("; ".join(faults),))


def learn_topics(
    bag: Bag,
    request: ChannelRequest | None = None,
    growing: FollowOptions | None = None,
    max_bytes: int = MAX_BYTES,
) -> JoinedRows | None:
    """Learn a bag's topics: to its end, or of a growing one until its rows are clear.

    Args:
        bag: Gets the topics.
        request: What is read of a growing bag.
        growing: How long more is waited for; None for a bag that does not grow.
        max_bytes: See `read_messages`.

    Returns:
        The rows of a growing bag; None where the end came first.
    """
    reported = ""
    settled_ns = 0
    for message in read_messages(bag.path, bag.faults, max_bytes, growing):
        if message is NONE_YET:
            continue

        is_new = bag.learn(message)
        if growing is None or not (is_new or message.log_ns >= settled_ns):
            continue

        # A second without a new topic, and it is decided which topics are read.
        settled_ns = message.log_ns + NS_PER_S
        if is_new:
            # Counted anew, so that rates are those of the same time.
            for topic in bag.topics.values():
                topic.count = int(topic.first_ns == message.log_ns)
                topic.first_ns = message.log_ns

            continue

        joined, missing = _join_if_clear(bag, request or ChannelRequest())
        if joined is not None:
            return joined
        if missing not in ("", reported):
            reported = missing
            growing.warn(f"{bag.path.name}: waiting for more topics; {missing}")

    return None


def _join_if_clear(bag: Bag, request: ChannelRequest) -> tuple[JoinedRows | None, str]:
    """Return the rows that are read, if that is clear by now.

    Returns:
        The rows or None, and what is missing, if something is.
    """
    try:
        needed = request.columns(bag.table())
        if not needed:
            return None, (
                f"needed are {', '.join(request.required)}, and until now there are "
                f"{', '.join(bag.topics)}"
            )

        joined = JoinedRows(bag, request, needed)
    except (ColumnError, FormatError) as error:
        return None, str(error)

    has_rates = all(topic.rate_hz > 0.0 for topic in joined.topics.values())
    return (joined if has_rates else None), ""


def _current_warnings(topics: Iterable[Topic], request: ChannelRequest) -> list[str]:
    """Return a note where efforts are those of a driver that sends motor currents."""
    spec = request.mapping.channels.get("tau")
    if spec is not None and spec.scale != 1.0:
        return []

    # The joints of all their arms, after a prefix.
    joints = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint")
    joints += ("wrist_1_joint", "wrist_2_joint", "wrist_3_joint")
    return [
        f"{topic.name}: the driver of Universal Robots sends motor currents in A as "
        "effort, unless it was set to send torques; give the torque constants of the "
        "joints in Nm/A as scale = [...] under [tau] in a mapping (--print-config "
        "prints one)"
        for topic in topics
        if any(name.endswith("/effort") for name in topic.widths)
        and all(any(joint.endswith(name) for joint in topic.joints) for name in joints)
    ]


def _choose_reference(
    bag: Bag, request: ChannelRequest, columns: Mapping[str, list[str]]
) -> str:
    """Return the name of the topic whose messages are the rows.

    It is the one of the mapping, else the first of the fastest.

    Args:
        bag: The bag.
        request: Its mapping may choose the topic.
        columns: That are read, by topic.

    Raises:
        ColumnError: The topic of the mapping is not there, or cannot be read.
    """
    chosen = request.mapping.reference_topic
    if chosen is None:
        max_count = max(bag.topics[name].count for name in columns)
        # A few messages that were lost shall make no difference.
        min_count = 0.9 * max_count
        return next(name for name in columns if bag.topics[name].count >= min_count)

    if chosen not in bag.topics or bag.topics[chosen].fault:
        raise ColumnError(
            f"reference_topic = {chosen!r} is no topic that can be read; topics are: "
            f"{', '.join(bag.topics)}"
        )

    return chosen
