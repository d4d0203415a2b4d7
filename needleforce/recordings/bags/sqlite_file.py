"""The messages of a bag in an SQLite file, which the library `rosbags` reads."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from needleforce.recordings.bags.messages import BagTopic, RawMessage, require_magic
from needleforce.recordings.errors import (
    KNOWN_SUFFIX,
    RECOVER,
    FileAccessError,
    FormatError,
    optional_library,
)


def sqlite_messages(path: Path, faults: list[str]) -> Iterator[RawMessage]:
    """Yield the messages in order of recording.

    Args:
        path: Of the file.
        faults: Gets what is wrong with it, without a subject.

    Raises:
        FileAccessError: The path cannot be given to the library.
        FormatError: The file is no bag, or damaged.
    """
    path = path.resolve()
    # `rosbags` makes a URI of the path, without quoting these.
    if {*"?#%"} & {*str(path)} or not path.suffix.islower():
        raise FileAccessError(
            f"cannot read {path}: a bag in an SQLite file needs a path without ?, # "
            "and %, and the suffix .db3 in small letters",
            KNOWN_SUFFIX,
        )

    with path.open("rb") as stream:
        magic = b"SQLite format 3\x00"
        require_magic(stream.read(len(magic)), magic, "SQLite")

    faults += _journal_faults(path)
    # What reading damaged content may end in, beside the errors of the libraries.
    damage_errors = (ValueError, TypeError, KeyError, AttributeError, MemoryError)
    rosbag2 = optional_library("rosbags.rosbag2", "ROS 2 bags")
    apsw = optional_library("apsw", "ROS 2 bags")
    try:
        with rosbag2.Reader(path) as reader:
            topics = {
                connection.id: _topic_of(connection)
                for connection in reader.connections
            }
            for connection, log_ns, data in reader.messages():
                # In SQLite any value may stand in any column.
                if type(log_ns) is not int or type(data) is not bytes:
                    raise TypeError(
                        f"{log_ns!r:.40} and {type(data)} for a time stamp and bytes"
                    )

                yield RawMessage(topics[connection.id], log_ns, data)
    except (rosbag2.ReaderError, apsw.Error, *damage_errors) as error:
        if "missing tables" in str(error):
            raise FormatError(
                "is not a bag: it has no tables messages and topics"
            ) from error

        raise FormatError(f"is cut short or damaged ({error})", RECOVER) from error


def _journal_faults(path: Path) -> list[str]:
    """Return a note on messages that a killed recorder has left beside the file."""
    journal = Path(f"{path}-wal")
    if not (journal.exists() and journal.stat().st_size):
        return []

    return [
        f"has messages in {journal.name} that are not read; add them with: "
        f"sqlite3 {path.name} 'PRAGMA wal_checkpoint'"
    ]


def _topic_of(connection: Any) -> BagTopic:
    """Return the topic of a connection of `rosbags`.

    Raises:
        TypeError: Its name or type is no text.
    """
    if not (isinstance(connection.topic, str) and isinstance(connection.msgtype, str)):
        raise TypeError(f"{connection.topic!r:.40} is no name of a topic")

    is_message = connection.msgdef.format.name == "MSG"
    return BagTopic(
        name=connection.topic,
        kind=connection.msgtype,
        encoding=str(connection.ext.serialization_format),
        definition=connection.msgdef.data if is_message else "",
    )
