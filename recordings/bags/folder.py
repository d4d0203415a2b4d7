"""A bag that is written as a folder, whole or not at all."""

import os
import shutil
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from recordings.bag_storage.files import METADATA
from recordings.bags.writer import BagWriter
from recordings.errors import FileAccessError
from recordings.tables.labels import Labels

FOLDER_SUFFIX = ".db3"


def is_folder_name(path: Path) -> bool:
    """Return whether a table of this name is written as a folder."""
    return path.name.lower().endswith(FOLDER_SUFFIX)


def require_replaceable(path: Path) -> None:
    """Check that what stands where a bag is to be written is nothing, or a bag like it.

    Args:
        path: of the folder to be written.

    Raises:
        FileAccessError: it is a file, or a folder that is no bag or holds anything else.
    """
    if not os.path.lexists(path):
        return
    if not path.is_dir():
        raise FileAccessError(
            f"cannot write {path}: a bag is written as a folder, and a file of this name is there"
        )
    try:
        others = [entry.name for entry in sorted(path.iterdir()) if not _is_of_bag(entry)]
    except OSError as error:
        raise FileAccessError(f"cannot read {path}: {error.strerror or error}") from error
    if others or not (path / METADATA).exists():
        what = f"it holds {others[0]!r}, which is no part of a bag" if others else "it is no bag"
        raise FileAccessError(f"will not replace the folder {path}: {what}; give another name")


def _is_of_bag(entry: Path) -> bool:
    return entry.is_file() and (entry.name == METADATA or is_folder_name(entry))


@contextmanager
def bag_folder(path: Path, labels: Callable[[], Labels]) -> Iterator[Callable[[], BagWriter]]:
    """Write a bag in an SQLite file, which ROS 2 wants in a folder with `metadata.yaml`.

    Args:
        path: the folder; a bag that stands there is replaced at the end, if something was written.
        labels: gives those of the bag when it begins, see `BagWriter`.

    Yields:
        A function that begins the bag.

    Raises:
        FileAccessError: the bag cannot be written, or something else stands there.
    """
    require_replaceable(path)
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    bag = part / path.stem
    try:
        yield lambda: BagWriter(bag, "sqlite3", labels())
        if bag.exists():
            if path.exists():
                # Minutes may have passed since it was looked at.
                require_replaceable(path)
                path.rename(part / "old")
            bag.rename(path)
    except sqlite3.Error as error:
        raise FileAccessError(f"cannot write {path}: {error}") from error
    except OSError as error:
        if isinstance(error, FileAccessError):
            raise
        raise FileAccessError(f"cannot write {path}: {error.strerror or error}") from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
