"""The messages of a ROS bag as bytes, the files and the chunks that hold them."""

import bz2
import io
import re
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from needleforce.recordings.errors import (
    UNPACK,
    FormatError,
    file_errors,
    optional_library,
)

ROS1_SUFFIXES = (".bag", ".bag.active")
"""Of ROS 1; the second is one whose recorder was killed."""

BAG_SUFFIXES = (".mcap", ".db3", *ROS1_SUFFIXES)

CDR = "cdr"
"""How ROS 2 serialises messages."""

ROS1 = "ros1"
"""How ROS 1 does."""

METADATA = "metadata.yaml"
"""The file beside the files of a bag that is a folder."""


class BagTopic(NamedTuple):
    """A topic of a bag.

    Attributes:
        name: Such as /joint_states.
        kind: The type of its messages, such as sensor_msgs/msg/JointState.
        encoding: Of the messages, `CDR` or `ROS1`.
        definition: Of the type, as the bag holds it; empty if it holds none.
    """

    name: str
    kind: str
    encoding: str
    definition: str = ""


class RawMessage(NamedTuple):
    """A serialised message.

    Attributes:
        topic: That it was recorded on.
        log_ns: When it was recorded, on the recorder's clock, in ns.
        data: Its bytes.
    """

    topic: BagTopic
    log_ns: int
    data: bytes


NONE_YET = RawMessage(BagTopic("", "", ""), 0, b"")
"""Stands in place of a message wherever more of a growing bag may have to be waited
for."""


def is_bag(path: Path) -> bool:
    """Return whether a path names a ROS bag: by its suffix, or as a folder of one."""
    has_suffix = path.name.lower().endswith(BAG_SUFFIXES)
    return has_suffix or (path.is_dir() and bool(bag_files(path)))


def bag_files(folder: Path) -> list[Path]:
    """Return the files of messages in a folder; those of a split bag are numbered."""
    with file_errors(folder):
        files = [
            path
            for path in folder.iterdir()
            if path.is_file() and path.name.endswith(BAG_SUFFIXES)
        ]

    return sorted(files, key=_numbers_in_name)


def _numbers_in_name(path: Path) -> list[int]:
    """Return the numbers in a file's name, in order; 0 if there is none."""
    return [int(digits) for digits in re.findall(r"\d{1,99}", path.name)] or [0]


def require_magic(head: bytes, magic: bytes, kind: str) -> None:
    """Raise `FormatError` if a file does not begin as files of its kind do."""
    if not head:
        raise FormatError("is empty")
    if not head.startswith(magic[: len(head)]):
        raise FormatError(f"is not an {kind} file: it does not begin as one")


def unpack_chunk(
    packed: bytes, compression: str, size: int, compressions: Sequence[str]
) -> bytes:
    """Return what records that were compressed together hold, as far as it can be had.

    The libraries unpack a chunk at once, however large it becomes, and lose all of one
    that is damaged. Here it is unpacked in blocks.

    Args:
        packed: Its bytes.
        compression: Name of its compression.
        size: No more bytes are returned.
        compressions: Those that the format of the bag has.

    Raises:
        FormatError: Its compression is none of them.
    """
    if compression not in compressions:
        raise FormatError(
            f"has chunks compressed with {compression!r}; "
            f"{' and '.join(compressions)} can be read",
            UNPACK,
        )

    stream: Any
    if compression == "bz2":
        stream = bz2.BZ2File(io.BytesIO(packed))
    elif compression == "lz4":
        library = optional_library("lz4.frame", "bags with lz4 chunks")
        stream = library.open(io.BytesIO(packed))
    else:
        library = optional_library("zstandard", "bags compressed with zstd")
        stream = library.ZstdDecompressor().stream_reader(packed)

    unpacked = bytearray()
    block_bytes = 1 << 16  # what precedes a damaged place is kept
    # Each library has an error of its own for damaged bytes.
    with suppress(Exception):
        while len(unpacked) < size and (block := stream.read(block_bytes)):
            unpacked += block

    return bytes(unpacked[:size])
