"""Libraries that only some formats need, imported when such a file is met."""

from importlib import import_module
from types import ModuleType

from recordings.errors import FileAccessError


def optional_library(module: str, what: str) -> ModuleType:
    """Import a library that may not be installed.

    Args:
        module: its name, such as `pyarrow.parquet`.
        what: what needs it, for the error, such as `Parquet files`.

    Returns:
        The module.

    Raises:
        FileAccessError: it is not installed; the message says what to install.
    """
    try:
        return import_module(module)
    except ImportError as error:
        library = module.partition(".")[0]
        raise FileAccessError(
            f"{what} need the library {library}: pip install 'needleforce[recordings]'"
        ) from error
