"""The folder of a report, made before the work that fills it."""

from pathlib import Path

from figures.errors import WriteError
from figures.save import require_matplotlib

PAGE = "index.html"
"""Name of the page in it."""


def report_folder(path: str | Path) -> Path:
    """Make sure that a report can be written before minutes of work, not after.

    Args:
        path: Of the folder; it is made if there is none.

    Returns:
        The folder.

    Raises:
        MissingExtraError: matplotlib is not installed.
        WriteError: The folder cannot be made.
    """
    require_matplotlib("--report")
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise WriteError(f"cannot write to {folder}: {error.strerror or error}") from error
    return folder
