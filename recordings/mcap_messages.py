"""The messages of an MCAP file."""

from collections.abc import Collection, Iterator
from struct import Struct
from typing import BinaryIO

from recordings.bag_message import BagTopic, RawMessage
from recordings.mcap_records import CHANNEL, SCHEMA, Record, mcap_records

_ID = Struct("<H")
_IDS = Struct("<HH")
_LENGTH = Struct("<I")
_MESSAGE = Struct("<HIQQ")
_IDL = ("ros2idl", "omgidl")


def mcap_messages(
    stream: BinaryIO, faults: list[str], topics: Collection[str] | None = None
) -> Iterator[RawMessage]:
    """Read messages in the order in which they stand in the file.

    Args:
        stream: an MCAP file, open at its start; need not seek.
        faults: what is wrong with the file is appended here, one phrase each.
        topics: names of those to read; all if None.

    Yields:
        The messages; of a damaged or cut file those that can be had.

    Raises:
        FormatError: it is not an MCAP file.
    """
    schemas: dict[int, BagTopic] = {}
    channels: dict[int, BagTopic | None] = {}
    strays = 0
    for record in mcap_records(stream, faults):
        if record.opcode == SCHEMA:
            (number,) = _ID.unpack_from(record.body)
            schemas[number] = _schema(record)
        elif record.opcode == CHANNEL:
            number, schema = _IDS.unpack_from(record.body)
            topic = _channel(record, schemas.get(schema))
            channels[number] = topic if topics is None or topic.name in topics else None
        else:
            number, _, log_ns, _ = _MESSAGE.unpack_from(record.body)
            topic = channels.get(number)
            if topic is not None:
                yield RawMessage(topic, log_ns, record.body[_MESSAGE.size :])
            elif number not in channels:
                strays += 1
    if strays:
        faults.append(f"has {strays} messages whose topic is not known")


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
