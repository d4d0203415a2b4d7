"""The messages of a bag of one file or several, in the order of recording."""

import heapq
from collections.abc import Iterator
from itertools import chain
from operator import attrgetter
from pathlib import Path

from needleforce.recordings.bags.mcap_file import McapReader
from needleforce.recordings.bags.messages import (
    ROS1_SUFFIXES,
    RawMessage,
    bag_files,
)
from needleforce.recordings.bags.ros1_file import Ros1Reader
from needleforce.recordings.bags.sqlite_file import sqlite_messages
from needleforce.recordings.errors import (
    UNPACK,
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
                yield from sqlite_messages(readable_path(file), file_faults)
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
