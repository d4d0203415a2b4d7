"""A bag that is written as a folder, whole or not at all."""

import os
import shutil
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from recordings.bag_writer import BagWriter
from recordings.errors import FileAccessError
from recordings.labels import Labels

FOLDER_SUFFIX = ".db3"


def is_folder_name(path: Path) -> bool:
    """Return whether a table of this name is written as a folder."""
    return path.name.lower().endswith(FOLDER_SUFFIX)


@contextmanager
def bag_folder(path: Path, labels: Callable[[], Labels]) -> Iterator[Callable[[], BagWriter]]:
    """Write a bag in an SQLite file, which ROS 2 wants in a folder with `metadata.yaml`.

    Args:
        path: the folder; what stands there is replaced at the end, if something was written.
        labels: gives those of the bag when it begins, see `BagWriter`.

    Yields:
        A function that begins the bag.

    Raises:
        FileAccessError: the bag cannot be written.
    """
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    bag = part / path.stem
    try:
        yield lambda: BagWriter(bag, "sqlite3", labels())
        if bag.exists():
            if path.exists():
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
