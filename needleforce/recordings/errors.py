"""The errors of this package, counts of faults, and the limits of every format."""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

from foundation.extras import install_command

MAX_BYTES = 2 << 30
"""Memory that a recording may take by default; a small damaged file can ask for any."""


class RecordingError(Exception):
    """Base of all errors raised by `needleforce.recordings`."""


class FileAccessError(RecordingError, OSError):
    """A file cannot be opened, or its suffix names no known format."""


class FormatError(RecordingError, ValueError):
    """A file could be opened, but nothing usable could be read from it."""


class ColumnError(RecordingError, LookupError):
    """A column was not found, or more than one would fit."""


class MappingError(RecordingError, ValueError):
    """A column mapping contradicts itself or uses unknown channels, keys or units."""


class LogError(RecordingError, ValueError):
    """Data do not form a log: lengths differ, no usable time, no finite value."""


class FaultCount(NamedTuple):
    """How often one kind of fault occurred.

    Attributes:
        occurrences: How often it occurred.
        first: Where it occurred first, in words; empty where that says nothing.
    """

    occurrences: int
    first: str


class FaultCounts(dict[str, FaultCount]):
    """What is wrong with a recording: kinds of faults in words, and how often each."""

    def note(self, fault: str, where: str, count: int = 1) -> None:
        """Count a fault.

        Args:
            fault: Its kind, in words.
            where: Its place in the file; the first place of each kind is reported.
            count: How often it occurred.
        """
        known = self.get(fault, FaultCount(0, ""))
        self[fault] = FaultCount(known.occurrences + count, known.first or where)

    def lines(self) -> tuple[str, ...]:
        """Return one line for each kind of fault that occurred."""
        return tuple(
            f"{fault}: {count} (first: {first})" if first else fault
            for fault, (count, first) in self.items()
            if count
        )


def require_size(size: int, limit: int, subject: str) -> None:
    """Raise `FormatError` if something takes more bytes than `max_bytes` allows.

    Args:
        size: Bytes that it takes.
        limit: Bytes that are allowed.
        subject: What takes them; the message begins with it.
    """
    if size > limit:
        raise FormatError(
            f"{subject} takes {size / 1e6:.3g} MB unpacked, more than the limit of "
            f"{limit / 1e6:.3g} MB; if the file is trusted, raise max_bytes"
        )


def optional_library(module: str, user: str) -> ModuleType:
    """Import a library that may not be installed.

    Args:
        module: Its dotted name.
        user: What needs it, in the plural, for the message.

    Raises:
        FileAccessError: It is not installed.
    """
    try:
        return import_module(module)
    except ImportError as error:
        library = module.partition(".")[0]
        raise FileAccessError(
            f"{user} need {library}, which is not installed; "
            f"{install_command('recordings')}"
        ) from error


@contextmanager
def file_errors(name: str | Path, verb: str = "read") -> Iterator[None]:
    """Turn what the operating system reports about a file into a `FileAccessError`."""
    try:
        yield
    except (RecordingError, BrokenPipeError):
        raise
    except OSError as error:
        raise FileAccessError(
            f"cannot {verb} {name}: {error.strerror or error}"
        ) from error
    except ValueError as error:
        if "null" not in str(error):
            raise

        # The name has a NUL in it, which no file can have.
        raise FileAccessError(f"cannot {verb} {str(name)!r}: {error}") from error


def readable_path(path: str | Path) -> Path:
    """Return the path of a file, a folder or a pipe that is to be read.

    Raises:
        FileAccessError: It is a device, which never ends, or no file can have its name.
    """
    path = Path(path)
    with file_errors(path):
        if path.exists() and not (path.is_file() or path.is_dir() or path.is_fifo()):
            raise FileAccessError(
                f"cannot read {path}: it is neither a file, a folder nor a pipe"
            )

    return path
