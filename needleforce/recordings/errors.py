"""What this package raises, and the limits that every format shares."""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from types import ModuleType


class RecordingError(Exception):
    """Base of all errors raised by `needleforce.recordings`."""


class FileAccessError(RecordingError, OSError):
    """A file cannot be opened for reading or writing, or its suffix names no known
    format.
    """


class FormatError(RecordingError, ValueError):
    """A file could be opened, but nothing usable could be read from it."""


class ColumnError(RecordingError, LookupError):
    """A column was not found, or more than one would fit."""


class MappingError(RecordingError, ValueError):
    """A column mapping contradicts itself or uses unknown channels, keys or units."""


class LogError(RecordingError, ValueError):
    """Data do not form a log: lengths differ, no usable time, no finite value."""


MAX_BYTES = (
    2 << 30
)  # The most memory a recording may ask for; a small damaged file can ask for any


def require_size(size: int, limit: int, what: str) -> None:
    """Refuse what would take more bytes than `max_bytes` allows; `what` begins the
    message.
    """
    if size > limit:
        raise FormatError(
            f"{what} takes {size / 1e6:.3g} MB unpacked, more than the limit of "
            f"{limit / 1e6:.3g} MB; if the file is trusted, raise max_bytes"
        )


def optional_library(module: str, what: str) -> ModuleType:
    """Import a library that may not be installed; the error says what needs it."""
    try:
        return import_module(module)
    except ImportError as error:
        library = module.partition(".")[0]
        needed = f"{library}: pip install {'pyarrow' if library == 'pyarrow' else 'rosbags mcap'}"
        raise FileAccessError(f"{what} need the library {needed}") from error


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
        # A name with a NUL in it, which no file can have.
        raise FileAccessError(f"cannot {verb} {str(name)!r}: {error}") from error


def readable_path(path: str | Path) -> Path:
    """Return a path to be opened; refuse devices, which never end, and names no file
    can have.
    """
    path = Path(path)
    with file_errors(path):
        if path.exists() and not (path.is_file() or path.is_dir() or path.is_fifo()):
            raise FileAccessError(
                f"cannot read {path}: it is neither a file, a folder nor a pipe"
            )
    return path
