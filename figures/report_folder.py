"""The folder of a report, made before the work that fills it."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
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


@contextmanager
def folder_if_filled(path: str | Path | None) -> Iterator[Path | None]:
    """`report_folder` for as long as the work takes; an empty one that it made is removed again.

    So an interrupt, or a mistake that ends the work at once, leaves nothing behind.

    Args:
        path: Of the folder; None where no report is wanted.

    Yields:
        The folder, if any.

    Raises:
        MissingExtraError: matplotlib is not installed.
        WriteError: The folder cannot be made.
    """
    if path is None:
        yield None
        return
    folder = Path(path)
    made = [each for each in (folder, *folder.parents) if not each.exists()]
    report_folder(folder)
    try:
        yield folder
    finally:
        with suppress(OSError):  # one that holds something is not removed, nor those it lies in
            for each in made:
                each.rmdir()
