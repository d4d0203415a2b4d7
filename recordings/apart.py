"""Files that a command writes must not meet its log, nor each other."""

from pathlib import Path

from recordings.bag_storage.files import METADATA, is_bag
from recordings.errors import FileAccessError


def require_apart_from_log(path: Path, source: Path) -> None:
    """Check that writing a file or folder cannot harm the recording that is being read.

    Args:
        path: what is to be written.
        source: the recording, a file or a folder; it need not exist.

    Raises:
        FileAccessError: it is the recording, or one lies inside the other, or both are files of
            one bag.
    """
    if not source.exists():
        return
    if _is_same(path, source):
        raise FileAccessError(f"cannot write {path}: it is the log itself; give another name")
    if _is_bag_file(source):
        source = source.resolve().parent
    if _meet(path, source):
        raise FileAccessError(
            f"cannot write {path}: it and the log {source} lie one inside the other; "
            "give a place outside"
        )


def require_apart(outputs: dict[str, Path]) -> None:
    """Check that no output would replace another.

    Args:
        outputs: option to the file or folder that it names.

    Raises:
        FileAccessError: two are the same, or one lies inside the other.
    """
    known: dict[str, Path] = {}
    for option, path in outputs.items():
        for other, place in known.items():
            if _is_same(path, place) or _meet(path, place):
                raise FileAccessError(
                    f"{other} and {option} both write to {place}; give each a place of its own"
                )
        known[option] = path


def _is_bag_file(path: Path) -> bool:
    """Return whether a file is one of several of a bag in a folder."""
    return path.is_file() and is_bag(path) and (path.resolve().parent / METADATA).exists()


def _is_same(path: Path, other: Path) -> bool:
    if path.exists() and other.exists():
        return path.samefile(other)
    return path.resolve() == other.resolve()


def _meet(path: Path, other: Path) -> bool:
    path, other = path.resolve(), other.resolve()
    return path == other or path in other.parents or other in path.parents
