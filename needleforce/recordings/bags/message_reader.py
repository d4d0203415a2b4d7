"""The messages of a bag of one file or several, in the order of recording.

The library `rosbags` reads those in an SQLite file.
"""

import heapq
from collections.abc import Iterator
from itertools import chain
from operator import attrgetter
from pathlib import Path
from typing import Any

from needleforce.recordings.bags.mcap_file import McapReader
from needleforce.recordings.bags.messages import (
    ROS1_SUFFIXES,
    BagTopic,
    RawMessage,
    bag_files,
    require_magic,
)
from needleforce.recordings.bags.ros1_file import Ros1Reader
from needleforce.recordings.errors import (
    KNOWN_SUFFIX,
    RECOVER,
    UNPACK,
    FileAccessError,
    FormatError,
    file_errors,
    optional_library,
    readable_path,
)
from needleforce.recordings.follow import FollowOptions


def read_messages(
    path: Path, faults: list[str], max_bytes: int, options: FollowOptions | None = None
) -> Iterator[RawMessage]:
    """Read messages as they were recorded.

    A damaged or cut MCAP file gives those that can be had.

    Args:
        path: A file, or a folder of files.
        faults: Gets what is wrong with the files, one sentence each.
        max_bytes: A chunk or message may take an eighth of it when unpacked.
        options: A growing MCAP file is followed until its recorder finishes it, and
            `NONE_YET` comes each time before more is waited for. None: it is read to
            its end.

    Raises:
        FormatError: There are no messages, or a file is no bag.
    """
    optional_library("rosbags.typesys", "ROS 2 bags")
    files = bag_files(path) if path.is_dir() else [path]
    if not files:
        raise FormatError(
            f"{path} is a folder without .mcap, .db3 or .bag files",
            UNPACK,
        )

    limit = max_bytes // 8  # for one chunk or message
    streams = [_messages_of_file(file, faults, limit, options) for file in files]
    # Files may have been recorded side by side.
    max_open_files = 64
    if len(files) > max_open_files:
        return chain.from_iterable(streams)

    return heapq.merge(*streams, key=attrgetter("log_ns"))


def _messages_of_file(
    file: Path, faults: list[str], limit: int, options: FollowOptions | None
) -> Iterator[RawMessage]:
    """Yield the messages of one file; faults and errors get its name."""
    file_faults: list[str] = []
    try:
        with file_errors(file):
            if file.name.lower().endswith(".db3"):
                yield from _sqlite_messages(readable_path(file), file_faults)
            elif file.name.lower().endswith(ROS1_SUFFIXES):
                yield from Ros1Reader(
                    readable_path(file), file_faults, limit
                ).messages()
            else:
                reader = McapReader(file, file_faults, limit)
                yield from reader.messages(options)
    except FormatError as error:
        raise error.reworded(f"{file} {error}") from error
    finally:
        faults.extend(f"{file.name} {fault}" for fault in file_faults)


def _sqlite_messages(path: Path, faults: list[str]) -> Iterator[RawMessage]:
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

    journal = Path(f"{path}-wal")  # what a killed recorder has left beside the file
    if journal.exists() and journal.stat().st_size:
        faults.append(
            f"has messages in {journal.name} that are not read; add them with: "
            f"sqlite3 {path.name} 'PRAGMA wal_checkpoint'"
        )

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
