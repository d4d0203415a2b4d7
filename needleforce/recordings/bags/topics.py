"""A bag and its topics: what their messages hold, and the rows collected of them."""

from collections.abc import Collection
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foundation.arrays import Array
from needleforce.recordings.bags.message_types import (
    MessageContent,
    TopicDecoder,
    size_of,
)
from needleforce.recordings.bags.messages import BagTopic, RawMessage
from needleforce.recordings.errors import UNPACK, FaultCounts, FormatError
from needleforce.recordings.table import Table, ToolMass, choose_tool_mass
from needleforce.recordings.time_stamps import NS_PER_S


class Topic:
    """A topic of a bag: what its messages hold, and the rows collected of it.

    Joints are put where their names say; a joint that a message lacks is NaN. Messages
    that name joints, but none of those chosen, are left out. The time stamp is the
    header's; where there is none, or it was never set, the recorder's.

    Attributes:
        topic: Its name and type.
        name: Its name.
        count: Messages so far.
        first_ns: When the first of them was recorded.
        latest_log_ns: When the latest of them was recorded.
        columns: Widths of its columns by name, None for one number a message.
        joint_names: The elements of the columns `named`.
        named: Columns whose elements have names.
        has_stamp: Whether messages have a time stamp of the source.
        fault: Why its messages cannot be read; empty if they can.
        known: Columns that are channels by the type of the messages, by channel.
        tool_mass: What its first message says hangs on the flange; None if nothing.
        source: Topic on whose clock messages without a stamp are put; None for that of
            the recorder.
        offset_ns: Of the source's clock from the recorder's, at the latest message.
        joints: Order of the joints in rows.
        widths: Of the columns in rows.
        rows: What was collected: time stamps, and the numbers of the chosen columns.
        latest_ns: The latest stamp of a row.
    """

    def __init__(self, topic: BagTopic, first_ns: int) -> None:
        self.topic = topic
        self.name = topic.name
        self.count = 0
        self.first_ns = first_ns
        self.latest_log_ns = first_ns
        self.columns: dict[str, int | None] = {}
        self.joint_names: list[str] = []
        self.named: set[str] = set()
        self.has_stamp = False
        self.fault = ""
        self.source: Topic | None = None
        # When messages were made and recorded, each on its own clock.
        self._learned_ns: list[tuple[int, int]] = []
        self.known: dict[str, str] = {}
        self.tool_mass: ToolMass | None = None
        self.choose((), ())

    @property
    def rate_hz(self) -> float:
        """Messages per second, 0 for fewer than two."""
        span_s = (self.latest_log_ns - self.first_ns) / NS_PER_S
        return (self.count - 1) / span_s if span_s > 0.0 else 0.0

    @property
    def limit_ns(self) -> float:
        """How far apart messages may be for interpolation between them."""
        # Five periods, and always 0.1 s; a topic of one message has no rate.
        periods_s = 5.0 / max(self.rate_hz, 1e-9)
        return NS_PER_S * max(0.1, periods_s)

    @cached_property
    def _decoder(self) -> TopicDecoder:
        return TopicDecoder(self.topic)

    def learn(self, message: RawMessage) -> None:
        """Count a message, and look at what the first ones hold."""
        self.count += 1
        self.latest_log_ns = max(self.latest_log_ns, message.log_ns)
        learned_count = 20  # messages of a topic are looked into
        if self.count > learned_count:
            return

        try:
            content = self._decoder.decode(message.data)
        except FormatError as error:
            # One damaged message, the first even, is no reason to lose the topic.
            self.fault = "" if self.columns else str(error)
            return

        self.fault = ""
        self.has_stamp = content.stamp_ns is not None
        if content.stamp_ns is not None:
            self._learned_ns.append((content.stamp_ns, message.log_ns))
            self.offset_ns = self._usual_offset_ns()

        if content.named:
            known = self.joint_names
            self.joint_names += [name for name in content.names if name not in known]

        self.named |= content.named
        for name, value in content.values.items():
            self.columns.setdefault(name, size_of(value))

        known = self._decoder.known
        self.known = {
            channel: name for channel, name in known.items() if name in self.columns
        }
        self.tool_mass = self.tool_mass or self._tool_mass_in(content)

    def _usual_offset_ns(self) -> int:
        """Return how far the source's clock is ahead of the recorder's, in most."""
        offsets_ns = sorted(
            stamp_ns - log_ns for stamp_ns, log_ns in self._learned_ns if stamp_ns
        )
        return offsets_ns[len(offsets_ns) // 2] if offsets_ns else 0

    @property
    def _begins_at_zero(self) -> bool:
        """Whether a stamp of zero is one of a simulated clock, not one never set."""
        stamps_ns = (stamp_ns for stamp_ns, _ in self._learned_ns)
        max_run_ns = 86_400 * NS_PER_S  # no simulation runs for longer
        return 0 < min(filter(None, stamps_ns), default=0) < max_run_ns

    def _tool_mass_in(self, content: MessageContent) -> ToolMass | None:
        """Return the mass on the flange that a message states; None if it does not."""
        masses = {
            name: ToolMass(float(content.values[name]), name)
            for name in self._decoder.masses
            if name in content.values
        }
        found = [masses.get(name) for name in self._decoder.masses]
        parts = [mass for mass in found[1:] if mass is not None]
        return choose_tool_mass(next(iter(found), None), parts)

    def describe(self) -> str:
        """Return the topic in one line."""
        stamps = "source stamps" if self.has_stamp else "stamps of the recorder"
        state = self.fault or (stamps if self.columns else "no numbers")
        messages = f"{self.count} messages, {self.rate_hz:.4g} Hz"
        return f"{self.name}: {self.topic.kind}, {messages}, {state}"

    def choose(self, columns: Collection[str], joints: Collection[str]) -> None:
        """Begin to collect rows of some columns, with the joints in this order."""
        self.joints = tuple(joints)
        self.widths = {
            name: len(self.joints) if name in self.named else self.columns[name] or 1
            for name in columns
        }
        self._faults = FaultCounts()
        self._bad_in_row = 0
        self.offset_ns = self._usual_offset_ns()
        self.rows: list[tuple[int, tuple[Any, ...]]] = []
        self.latest_ns = -(1 << 62)  # earlier than any stamp

    def add(self, message: RawMessage) -> None:
        """Collect the row of a message, unless nothing in it can be used."""
        try:
            content = self._decoder.decode(message.data)
        except FormatError:
            fault = "messages that do not fit their type, left out"
            self._faults.note(fault)
            return

        if content.names and content.names != self.joints:
            missing = set(self.joints) - set(content.names)
            if self.joints and len(missing) == len(self.joints):
                fault = "messages without any of the joints, left out"
                self._faults.note(fault)
                return
            if missing:
                self._faults.note("messages that lack joints")

        stamp_ns = self._stamp_ns(content.stamp_ns, message.log_ns)
        if stamp_ns is None:
            return

        values = (self._numbers(name, content) for name in self.widths)
        self.rows.append((stamp_ns, tuple(values)))
        self.latest_ns = max(self.latest_ns, stamp_ns)

    def _stamp_ns(self, stamp_ns: int | None, log_ns: int) -> int | None:
        """Return the time stamp of a message; None if it is bad.

        Args:
            stamp_ns: That of the source, as `MessageContent` has it.
            log_ns: When the message was recorded.
        """
        if stamp_ns is None:
            offset_ns = 0 if self.source is None else self.source.offset_ns
            return log_ns + offset_ns

        if not (stamp_ns or self._begins_at_zero) and log_ns:
            fault = "messages without a source time stamp; the recorder's was taken"
            self._faults.note(fault)
            return log_ns + self.offset_ns

        offset_ns = stamp_ns - log_ns
        # Source and recorder agree to a second from message to message, if neither was
        # set; after so many that do not, the source was.
        max_bad_stamps = 8
        fits = abs(offset_ns - self.offset_ns) <= NS_PER_S
        follows = abs(stamp_ns - self.latest_ns) <= NS_PER_S
        self._bad_in_row = 0 if fits or follows else self._bad_in_row + 1
        if 0 < self._bad_in_row <= max_bad_stamps:
            fault = "messages with a bad time stamp, left out"
            self._faults.note(
                fault,
                f"{stamp_ns / NS_PER_S:.13g} s, recorded at {log_ns / NS_PER_S:.13g} s",
            )
            return None

        self._bad_in_row = 0
        self.offset_ns = offset_ns
        return stamp_ns

    def _numbers(self, name: str, content: MessageContent) -> Any:
        """Return the numbers of one column of a message; what does not fit is NaN."""
        width = self.widths[name]
        value = content.values.get(name)
        if value is None or (name in self.named) != (name in content.named):
            fault = f"messages without values of {name}, or not one for each joint"
            self._faults.note(fault)
        elif name in self.named:
            if self.joints == content.names:
                return value

            by_joint = dict(zip(content.names, value, strict=True))
            return [by_joint.get(joint, np.nan) for joint in self.joints]
        elif (size_of(value) or 1) == width:
            return value if isinstance(value, tuple | np.ndarray) else (value,)
        else:
            fault = f"messages with another number of values of {name}"
            self._faults.note(fault)

        return np.full(width, np.nan)

    def stamps_ns(self) -> NDArray[np.int64]:
        """Return the time stamps of the rows, shape (n,)."""
        return np.array([stamp_ns for stamp_ns, _ in self.rows], dtype=np.int64)

    def values(self) -> dict[str, Array]:
        """Return the numbers of the rows by column, shape (n, k)."""
        arrays: dict[str, Array] = {}
        for i, (name, width) in enumerate(self.widths.items()):
            numbers = [values[i] for _, values in self.rows]
            arrays[name] = np.array(numbers, dtype=np.float64).reshape(-1, width)

        return arrays

    def notes(self) -> list[str]:
        """Return what was left out or guessed so far, one sentence each."""
        return [
            f"{self.name}: {fault}: {count}{f' (first: {first})' if first else ''}"
            for fault, (count, first) in self._faults.items()
        ]


class Bag:
    """A bag and its topics, as far as it was gone through, see `learn_topics`.

    Attributes:
        path: Of the bag.
        topics: By name.
        faults: What is wrong with its files.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.topics: dict[str, Topic] = {}
        self.faults: list[str] = []

    def learn(self, message: RawMessage) -> bool:
        """Learn from a message; return whether its topic is a new one."""
        name = message.topic.name
        is_new = name not in self.topics
        if is_new:
            self.topics[name] = Topic(message.topic, message.log_ns)

        self.topics[name].learn(message)
        return is_new

    @property
    def warnings(self) -> list[str]:
        """What was lost or is damaged, and how much there is."""
        if not self.faults:
            return []

        topics = self.topics.values()
        count = sum(topic.count for topic in topics)
        start_ns = min(topic.first_ns for topic in topics)
        end_ns = max(topic.latest_log_ns for topic in topics)
        return [
            f"{'; '.join(self.faults)}: {count} messages from "
            f"{start_ns / NS_PER_S:.3f} s to {end_ns / NS_PER_S:.3f} s could be read, "
            "what came after, if anything, is lost"
        ]

    @property
    def tool_mass(self) -> ToolMass | None:
        """What the messages of a topic say hangs on the flange; None if none does."""
        masses = (topic.tool_mass for topic in self.topics.values())
        return next((mass for mass in masses if mass is not None), None)

    @property
    def known(self) -> dict[str, tuple[str, ...]]:
        """Columns that are channels by the type of their messages, by channel."""
        known: dict[str, tuple[str, ...]] = {}
        for topic in self.topics.values():
            for channel, name in topic.known.items():
                known[channel] = (*known.get(channel, ()), name)

        return known

    def table(self) -> Table:
        """Return all columns without rows, to look columns up by name.

        Raises:
            FormatError: There are no messages, or none with numbers.
        """
        topics = self.topics.values()
        if not topics:
            faults = "".join(f" ({fault})" for fault in self.faults)
            raise FormatError(f"{self.path} holds no messages{faults}", UNPACK)

        widths = {
            name: width for topic in topics for name, width in topic.columns.items()
        }
        if not widths:
            reasons = (
                f"{topic.name} ({topic.topic.kind}) {topic.fault or 'holds no numbers'}"
                for topic in topics
            )
            raise FormatError(
                f"{self.path} holds no topic with numbers: {'; '.join(reasons)}",
                UNPACK,
            )

        return Table(
            columns={
                name: np.empty((0,) if width is None else (0, width))
                for name, width in widths.items()
            },
            joint_names={
                name: tuple(topic.joint_names)
                for topic in topics
                for name in topic.named
            },
            known=self.known,
            tool_mass=self.tool_mass,
            warnings=tuple(
                f"{topic.name!r}: {topic.topic.kind} {topic.fault}"
                for topic in topics
                if topic.fault
            ),
        )
