"""The messages of a bag in an SQLite file."""

import sqlite3
from collections.abc import Collection, Iterator, Mapping
from contextlib import closing
from pathlib import Path

from recordings.bag_storage.raw_message import BagTopic, RawMessage
from recordings.bag_storage.sqlite_salvage import MAGIC, is_cut, salvage_rows
from recordings.errors import FormatError

_IDL = "ros2idl"
_DAMAGE = (sqlite3.DatabaseError, UnicodeDecodeError, MemoryError, OverflowError)
"""What reading a damaged file ends in: a length in it may ask for any memory."""
_ENCODINGS = ("ros2msg", _IDL)


def sqlite_messages(
    path: Path, faults: list[str], topics: Collection[str] | None = None
) -> Iterator[RawMessage]:
    """Read messages in the order in which they were recorded.

    Args:
        path: the file.
        faults: what is wrong with the file is appended here, one phrase each.
        topics: names of those to read; all if None.

    Yields:
        The messages; of a damaged or cut file those that can be had.

    Raises:
        FormatError: it is not a bag in an SQLite file.
    """
    with path.open("rb") as stream:
        if (head := stream.read(len(MAGIC))) != MAGIC:
            what = "is not an SQLite file: it does not begin as one" if head else "is empty"
            raise FormatError(what)
    if is_cut(path):
        faults.append("is cut short")
        yield from _salvaged(path, 0, topics)
        return
    last = unfit = 0
    try:
        with closing(_connect(path)) as connection:
            known = _wanted(_topics(connection, faults), topics)
            query = (
                "SELECT id, topic_id, timestamp, data FROM messages "
                f"WHERE topic_id IN ({','.join(map(str, known))}) ORDER BY id"
            )
            for number, topic, log_ns, data in connection.execute(query):
                last = number
                if isinstance(log_ns, int) and isinstance(data, bytes):
                    yield RawMessage(known[topic], log_ns, data)
                else:
                    unfit += 1
        if unfit:
            faults.append(f"has {unfit} messages whose time stamp or data are of another type")
    except _DAMAGE as error:
        if "unable to open" in str(error):
            raise FormatError(f"cannot be read: {error}") from error
        faults.append(f"is damaged ({error})")
        yield from _salvaged(path, last, topics)


def _wanted(
    known: Mapping[int, BagTopic], topics: Collection[str] | None
) -> Mapping[int, BagTopic]:
    if topics is None:
        return known
    return {number: topic for number, topic in known.items() if topic.name in topics}


def _connect(path: Path) -> sqlite3.Connection:
    # A recorder that was killed leaves its last messages in a file beside, which only the first
    # way reads; the second can also read in folders where nothing may be written.
    way = "mode=ro" if Path(f"{path}-wal").exists() else "immutable=1"
    return sqlite3.connect(f"{path.absolute().as_uri()}?{way}", uri=True)


def _topics(connection: sqlite3.Connection, faults: list[str]) -> Mapping[int, BagTopic]:
    definitions: dict[str, tuple[str, bool]] = {}
    tables = {name for (name,) in connection.execute("SELECT name FROM sqlite_master")}
    if missing := {"topics", "messages"} - tables:
        raise FormatError(f"is not a bag: it has no table {' and no '.join(sorted(missing))}")
    if "message_definitions" in tables:
        query = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
        for kind, encoding, text in connection.execute(query):
            definitions[kind] = (text, encoding == _IDL)
    query = "SELECT id, name, type, serialization_format FROM topics"
    known: dict[int, BagTopic] = {}
    for number, name, kind, encoding in connection.execute(query):
        if all(isinstance(text, str) for text in (name, kind, encoding)):
            known[number] = BagTopic(name, kind, encoding, *definitions.get(kind, ("", False)))
        else:
            faults.append(f"has a topic, number {number}, whose name or type is no text")
    return known


def _salvaged(path: Path, last: int, topics: Collection[str] | None) -> Iterator[RawMessage]:
    """Yield the messages after number `last` from the pages that are left."""
    known = _wanted(_salvaged_topics(path), topics)
    for number, values in salvage_rows(path):
        if number <= last or len(values) != 4:
            continue
        _, topic_id, log_ns, data = values
        topic = known.get(topic_id) if isinstance(topic_id, int) else None
        if topic is not None and isinstance(log_ns, int) and isinstance(data, bytes):
            yield RawMessage(topic, log_ns, data)


def _salvaged_topics(path: Path) -> Mapping[int, BagTopic]:
    topics: dict[int, BagTopic] = {}
    definitions: dict[str, tuple[str, bool]] = {}
    for number, values in salvage_rows(path):
        texts = [value for value in values[1:] if isinstance(value, str)]
        if len(texts) < 3 or len(texts) != len(values) - 1:
            continue
        if texts[1] in _ENCODINGS:
            definitions[texts[0]] = (texts[2], texts[1] == _IDL)
        elif "/" in texts[1]:
            topics[number] = BagTopic(texts[0], texts[1], texts[2])
    return {
        number: BagTopic(*topic[:3], *definitions.get(topic.kind, ("", False)))
        for number, topic in topics.items()
    }
