"""The messages of a bag, whatever its storage."""

import shutil
import tempfile
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path

from recordings.bag_storage.files import BagFiles
from recordings.bag_storage.mcap_compression import zstd_library
from recordings.bag_storage.mcap_messages import mcap_messages
from recordings.bag_storage.mcap_records import CUT_SHORT
from recordings.bag_storage.raw_message import RawMessage
from recordings.bag_storage.sqlite_messages import sqlite_messages
from recordings.errors import FileAccessError, FormatError
from recordings.sources.byte_source import Patience, byte_blocks
from recordings.sources.growing_file import GrowingFile

_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


def bag_messages(
    files: BagFiles, faults: list[str], topics: Collection[str] | None = None
) -> Iterator[RawMessage]:
    """Read messages in the order in which they were recorded.

    Args:
        files: the bag.
        faults: what is wrong with its files is appended here, one sentence each.
        topics: names of those to read; all if None.

    Yields:
        The messages; of a damaged or cut file those that can be had.

    Raises:
        FileAccessError: a file cannot be read, or a library is missing.
        FormatError: a file is not what its suffix says.
    """
    for path in files.paths:
        found: list[str] = []
        try:
            with _unpacked(path, found) as plain:
                yield from _of_file(plain, found, topics)
        except FormatError as error:
            raise FormatError(f"{path} {error}") from error
        except FileAccessError:
            raise
        except OSError as error:
            raise FileAccessError(f"cannot read {path}: {error.strerror or error}") from error
        finally:
            faults += [f"{path.name} {fault}" for fault in found]


def growing_messages(
    path: Path, patience: Patience, faults: list[str], topics: Collection[str] | None = None
) -> Iterator[RawMessage]:
    """Read the messages of an MCAP file as a recorder writes them, until it finishes the file.

    Args:
        path: the file.
        patience: how long more is waited for.
        faults: as for `bag_messages`; that the recorder was not done is none if the user stops.
        topics: names of those to read; all if None.

    Yields:
        The messages, and `NONE_YET` each time before more is waited for.

    Raises:
        FileAccessError: the file cannot be read, or a library is missing.
        FormatError: it is no MCAP file.
    """
    stream = GrowingFile(byte_blocks(path, patience, tell_pauses=True))
    found: list[str] = []
    try:
        yield from _with_data_unpacked(mcap_messages(stream, found, topics), found)
    except FormatError as error:
        raise FormatError(f"{path} {error}") from error
    if patience.should_stop() and CUT_SHORT in found:
        found.remove(CUT_SHORT)
    faults += [f"{path.name} {fault}" for fault in found]


def _of_file(path: Path, faults: list[str], topics: Collection[str] | None) -> Iterator[RawMessage]:
    if path.name.lower().endswith(".db3"):
        yield from _with_data_unpacked(sqlite_messages(path, faults, topics), faults)
        return
    with path.open("rb") as stream:
        yield from _with_data_unpacked(mcap_messages(stream, faults, topics), faults)


def _with_data_unpacked(messages: Iterator[RawMessage], faults: list[str]) -> Iterator[RawMessage]:
    """Unpack messages that are compressed one by one, which no serialised message looks like."""
    damaged = 0
    for message in messages:
        if not message.data.startswith(_ZSTD_MAGIC):
            yield message
            continue
        zstd = zstd_library()
        try:
            yield message._replace(data=zstd.decompress(message.data))
        except zstd.ZstdError:
            damaged += 1
    if damaged:
        faults.append(f"has {damaged} damaged messages")


@contextmanager
def _unpacked(path: Path, faults: list[str]) -> Iterator[Path]:
    """Give the file itself, or its content in a temporary file if it is compressed as a whole."""
    if not path.name.endswith(".zstd"):
        yield path
        return
    zstd = zstd_library()
    with tempfile.TemporaryDirectory() as folder:
        plain = Path(folder) / path.name.removesuffix(".zstd")
        with plain.open("wb") as target, zstd.open(path, "rb") as source:
            try:
                shutil.copyfileobj(source, target)
            except (EOFError, zstd.ZstdError):
                faults.append("is cut short or damaged")
        yield plain
