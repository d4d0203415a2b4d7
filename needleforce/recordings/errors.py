"""The errors of this package, and the words of their advice."""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from types import ModuleType

from foundation.errors import NeedleforceError

KNOWN_SUFFIX = (
    "Write it as .csv, .npz, .parquet or .mcap: save a sheet as CSV (in Excel: CSV "
    "UTF-8), unpack what is packed (zstd -d); what is read may have other suffixes, or "
    "be a folder."
)


class RecordingError(NeedleforceError):
    """Base of all errors raised by `needleforce.recordings`."""

    usual_advice = (
        "Give a header with the names of the columns and rows of numbers; a "
        "damaged file has to be written anew."
    )


class FileAccessError(RecordingError, OSError):
    """A file cannot be opened, or its suffix names no known format."""

    usual_advice = "Check the name, the permissions and the space that is left."


class FormatError(RecordingError, ValueError):
    """A file could be opened, but nothing usable could be read from it."""


class ColumnError(RecordingError, LookupError):
    """A column was not found, or more than one would fit."""

    usual_advice = (
        "Name the columns of the channel, on the command line or in the `mapping`: "
        "names that the message lists, or a pattern such as q_*."
    )


class UnitError(RecordingError, ValueError):
    """The unit of a column is not known, or contradicted by names, rows or values."""

    usual_advice = (
        "Give the unit behind the names, as `NAMES:UNIT`, or as `unit` in the "
        "`mapping`; a `scale` may stand for a unit that is not known."
    )


class MappingError(RecordingError, ValueError):
    """A column mapping contradicts itself or uses unknown channels, keys or units."""

    usual_advice = (
        "Correct the `ColumnMapping`: a channel has `columns`, `unit` and `scale`."
    )


class LogError(RecordingError, ValueError):
    """Data do not form a log: lengths differ, no usable time, no finite value."""

    usual_advice = (
        "Give columns of numbers with names of their own and one value, or one row, "
        "for each time stamp; a bag needs `t_s`."
    )


MAX_BYTES = 2 << 30
"""Most memory that packed files may take: a bomb takes all there is."""


class UnpackedSize:
    """How many bytes the files of one recording take unpacked, at most `MAX_BYTES`."""

    def __init__(self) -> None:
        self._bytes = 0

    def add(self, size: int, path: str | Path) -> None:
        """Count what was in a file; `FormatError` if the recording is too large."""
        self._bytes += size
        if self._bytes > MAX_BYTES:
            raise FormatError(
                f"{path}: the recording takes {self._bytes / 1e6:.3g} MB or more "
                f"unpacked, more than the limit of {MAX_BYTES / 1e6:.3g} MB",
                "Unpack it, and read the part that is needed.",
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
            f"{user} need {library}, which is not installed",
            "Install them: pip install 'needleforce[recordings]'.",
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


@contextmanager
def damage_errors(path: str | Path, kind: str) -> Iterator[None]:
    """Turn whatever damaged bytes make a library run into to a `FormatError`."""
    try:
        yield
    except Exception as error:
        is_of_system = isinstance(error, OSError) and error.errno is not None
        if is_of_system or isinstance(error, RecordingError):
            raise
        raise FormatError(
            f"{path} is no {kind} that can be read, or damaged ({error})",
            "Copy it again; messages of an SQLite bag may be recovered with: sqlite3 "
            "FILE .recover.",
        ) from error


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
