"""What a bag holds, found by going through it once."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from recordings.bag_storage.files import BagFiles, bag_files
from recordings.bag_storage.messages import bag_messages
from recordings.bag_storage.raw_message import BagTopic, RawMessage
from recordings.bags.cdr_layout import CdrLayout, learn_layout
from recordings.bags.message_columns import message_columns
from recordings.bags.message_types import MessageTypes
from recordings.clock.nanoseconds import NS_PER_S
from recordings.errors import FormatError

_LEARNED = 20
"""Messages of a topic that are looked into."""
CDR = "cdr"


@dataclass(slots=True, kw_only=True)
class SurveyedTopic:
    """A topic of a bag.

    Attributes:
        topic: its name and type.
        count: how many messages it has.
        first_ns: when the first was recorded.
        last_ns: when the last was recorded.
        columns: column name to width, None for one number a message; of the first messages.
        joints: names of the elements of `named`, in the order in which they were met.
        named: columns whose elements have names.
        has_stamp: whether messages carry a source time stamp.
        fault: why its messages cannot be read, empty if they can.
    """

    topic: BagTopic
    count: int = 0
    first_ns: int = 0
    last_ns: int = 0
    columns: dict[str, int | None] = field(default_factory=dict)
    joints: list[str] = field(default_factory=list)
    named: set[str] = field(default_factory=set)
    has_stamp: bool = False
    fault: str = ""

    @property
    def rate_hz(self) -> float:
        """Messages per second, 0 for fewer than two."""
        span_s = (self.last_ns - self.first_ns) / NS_PER_S
        return (self.count - 1) / span_s if span_s > 0.0 else 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class BagSurvey:
    """A bag and its topics.

    Attributes:
        path: as given.
        files: where its messages stand.
        topics: by name.
        types: types of its messages.
        warnings: what was lost or is damaged.
    """

    path: Path
    files: BagFiles
    topics: Mapping[str, SurveyedTopic]
    types: MessageTypes
    warnings: tuple[str, ...]


def survey_bag(path: Path) -> BagSurvey:
    """Go through a bag.

    Args:
        path: see `bag_files`.

    Raises:
        FileAccessError: it cannot be read, or rosbags is not installed.
        FormatError: it is not a bag, or holds no messages.
    """
    files, types = bag_files(path), MessageTypes()
    topics: dict[str, SurveyedTopic] = {}
    faults: list[str] = []
    for message in bag_messages(files, faults):
        survey_message(message, topics, types)
    warnings = (*files.warnings, *_lost(files, topics, faults))
    if not topics:
        told = "".join(f" ({warning})" for warning in warnings)
        raise FormatError(f"{path} holds no messages{told}")
    return BagSurvey(path=path, files=files, topics=topics, types=types, warnings=warnings)


def survey_message(
    message: RawMessage, topics: dict[str, SurveyedTopic], types: MessageTypes
) -> None:
    """Count a message, and learn what its topic holds.

    Args:
        message: the message.
        topics: those met so far, by name.
        types: types of the bag.
    """
    name = message.topic.name
    if name not in topics:
        topics[name] = SurveyedTopic(topic=message.topic, first_ns=message.log_ns)
    found = topics[name]
    found.count += 1
    found.last_ns = max(found.last_ns, message.log_ns)
    if found.count <= _LEARNED and not found.fault:
        _learn(found, message, types)


def layout_of(message: RawMessage, types: MessageTypes) -> CdrLayout:
    """Learn the layout of a message.

    Args:
        message: the message.
        types: types of its bag.

    Raises:
        FormatError: it cannot be read.
    """
    if message.topic.encoding != CDR:
        raise FormatError(f"is encoded as {message.topic.encoding!r}; ROS 2 has {CDR!r}")
    types.register(message.topic)
    return learn_layout(message.data, message.topic.kind, types.fields)


def _learn(found: SurveyedTopic, message: RawMessage, types: MessageTypes) -> None:
    try:
        columns = message_columns(found.topic, layout_of(message, types))
    except FormatError as error:
        found.fault = str(error) if not found.columns else ""
        return
    found.has_stamp = columns.stamp is not None
    found.joints += [name for name in columns.names if name not in found.joints]
    found.named |= columns.named
    for name, place in columns.places.items():
        found.columns.setdefault(name, place.length)


def _lost(files: BagFiles, topics: Mapping[str, SurveyedTopic], faults: list[str]) -> list[str]:
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
    told = "; ".join(faults) or "the bag is not whole"
    return [f"{told}: {count} messages{span} could be read, {missing}"]
