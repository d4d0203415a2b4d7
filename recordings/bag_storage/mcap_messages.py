"""The messages of an MCAP file."""

from collections.abc import Collection, Iterator
from struct import Struct
from struct import error as StructError
from typing import BinaryIO

from recordings.bag_storage.mcap_records import (
    CHANNEL,
    MESSAGE,
    PAUSE,
    SCHEMA,
    Record,
    mcap_records,
    summary_records,
)
from recordings.bag_storage.raw_message import NONE_YET, BagTopic, RawMessage
from recordings.sources.growing_file import GrowingFile

_ID = Struct("<H")
_IDS = Struct("<HH")
_LENGTH = Struct("<I")
_MESSAGE = Struct("<HIQQ")
_IDL = ("ros2idl", "omgidl")
_LATEST_NS = (1 << 63) - 1


def mcap_messages(
    stream: BinaryIO | GrowingFile, faults: list[str], topics: Collection[str] | None = None
) -> Iterator[RawMessage]:
    """Read messages in the order in which they stand in the file.

    Args:
        stream: an MCAP file, open at its start.
        faults: what is wrong with the file is appended here, one phrase each.
        topics: names of those to read; all if None.

    Yields:
        The messages; of a damaged or cut file those that can be had. `NONE_YET` in a file that
        grows.

    Raises:
        FormatError: it is not an MCAP file.
    """
    channels, damaged = _Channels(), 0
    for record in summary_records(stream):
        channels.learn(record)
    for record in mcap_records(stream, faults):
        if record is PAUSE:
            yield NONE_YET
            continue
        if record.opcode != MESSAGE:
            channels.learn(record)
            continue
        message = channels.message(record)
        if message is None:
            damaged += 1
        elif topics is None or message.topic.name in topics:
            yield message
    if damaged:
        faults.append(f"has {damaged} damaged messages, or messages whose topic is not known")


class _Channels:
    """The topics of a file by the numbers that its messages bear."""

    def __init__(self) -> None:
        self._schemas: dict[int, BagTopic] = {}
        self._channels: dict[int, BagTopic] = {}

    def learn(self, record: Record) -> None:
        """Take in a schema or a channel; one that is damaged is left out."""
        try:
            if record.opcode == SCHEMA:
                (number,) = _ID.unpack_from(record.body)
                self._schemas[number] = _schema(record)
            elif record.opcode == CHANNEL:
                number, schema = _IDS.unpack_from(record.body)
                self._channels[number] = _channel(record, self._schemas.get(schema))
        except StructError:
            return

    def message(self, record: Record) -> RawMessage | None:
        """Return a message, or None if it cannot be one."""
        if len(record.body) < _MESSAGE.size:
            return None
        number, _, log_ns, _ = _MESSAGE.unpack_from(record.body)
        topic = self._channels.get(number)
        if topic is None or log_ns > _LATEST_NS:
            return None
        return RawMessage(topic, log_ns, record.body[_MESSAGE.size :])


def _schema(record: Record) -> BagTopic:
    kind, at = _text(record.body, _ID.size)
    encoding, at = _text(record.body, at)
    definition, _ = _text(record.body, at)
    return BagTopic("", kind, "", definition, encoding in _IDL)


def _channel(record: Record, schema: BagTopic | None) -> BagTopic:
    name, at = _text(record.body, _IDS.size)
    encoding, _ = _text(record.body, at)
    return (schema or BagTopic("", "", ""))._replace(name=name, encoding=encoding)


def _text(body: bytes, at: int) -> tuple[str, int]:
    """Return a text with its length before it, and where the next field starts."""
    (length,) = _LENGTH.unpack_from(body, at)
    start = at + _LENGTH.size
    return body[start : start + length].decode(errors="replace"), start + length
