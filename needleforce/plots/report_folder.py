"""A folder that appears whole or not at all, and spoils nothing that was there."""

import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from needleforce.plots.drawing import require_matplotlib
from needleforce.plots.errors import WriteError
from needleforce.plots.page import PAGE

_BEFORE = ".before"
"""Where the files that a new report replaces lie until it stands."""


@contextmanager
def whole_folder(path: str | Path | None) -> Iterator[Path | None]:
    """Yield a hidden folder; at the end of the block its files appear under the path.

    After an error or an interrupt in the block nothing has appeared, an older report
    is as it was, and folders that were made for it are gone. Other files in an
    existing folder stay.

    Args:
        path: The folder; None for no report, then None is yielded.

    Raises:
        WriteError: The folder cannot be made or written to; this is found out before
            the block where it can be.
    """
    if path is None:
        yield None
        return
    require_matplotlib("--report")
    folder = Path(path)
    made = [place for place in folder.parents if not _exists(place)]
    try:
        with _write_errors(folder):
            draft = _make_draft(folder)
        try:
            yield draft
            with _write_errors(folder):
                _publish(draft, folder)
        finally:
            shutil.rmtree(draft, ignore_errors=True)
    finally:
        # One that holds something is not removed, nor those it lies in.
        with suppress(OSError):
            for place in made:
                place.rmdir()


def _exists(place: Path) -> bool:
    with suppress(OSError):
        return place.exists()
    return False


@contextmanager
def _write_errors(folder: Path) -> Iterator[None]:
    """Turn what the operating system reports into a `WriteError`."""
    try:
        yield
    except WriteError:
        raise
    except OSError as error:
        raise WriteError(
            f"cannot write to {folder}: {error.strerror or error}"
        ) from error


def _make_draft(folder: Path) -> Path:
    """Make a hidden folder from which a rename reaches the folder of the report."""
    if folder.is_dir():
        if (folder / PAGE).is_dir():
            raise WriteError(f"cannot write {folder / PAGE}: it is a folder")
        home = folder
    else:
        home = folder.parent
        if folder.exists():
            raise WriteError(f"cannot write to {folder}: it is a file")
        home.mkdir(parents=True, exist_ok=True)
    draft = home / f".report.{secrets.token_hex(4)}.part"
    draft.mkdir()
    return draft


def _publish(draft: Path, folder: Path) -> None:
    """Give the files of a draft their place."""
    if not any(draft.iterdir()):
        return
    if not folder.is_dir():
        draft.rename(folder)
        return
    names = [item.name for item in draft.iterdir()]
    before = draft / _BEFORE
    before.mkdir()
    try:
        for name in sorted(names, key=lambda name: name == PAGE):  # the page last
            if (folder / name).exists():
                (folder / name).rename(before / name)
            (draft / name).rename(folder / name)
    except BaseException:
        _restore(names, draft, folder)
        raise


def _restore(names: list[str], draft: Path, folder: Path) -> None:
    """Take a half published draft back, and put replaced files in their place."""
    for name in names:
        if not (draft / name).exists():
            (folder / name).rename(draft / name)
        if (draft / _BEFORE / name).exists():
            (draft / _BEFORE / name).rename(folder / name)
