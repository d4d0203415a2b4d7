"""A folder whose files appear when all are written, and that spoils nothing else."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import mkdtemp

from needleforce.plots.drawing import require_matplotlib
from needleforce.plots.errors import write_errors
from needleforce.plots.page import PAGE


@contextmanager
def whole_folder(path: str | Path | None) -> Iterator[Path | None]:
    """Yield a hidden folder; at the end of the block its files appear under the path.

    After an error or an interrupt in the block nothing has appeared, and an older
    report is as it was. Other files in an existing folder stay.

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
    is_new = not folder.exists()
    with write_errors(f"cannot write to {folder}"):
        folder.mkdir(parents=True, exist_ok=True)
        draft = Path(mkdtemp(prefix=".report.", dir=folder))
    try:
        yield draft
        with write_errors(f"cannot write to {folder}"):
            # The page last: who reloads it finds its files.
            for item in sorted(draft.iterdir(), key=lambda item: item.name == PAGE):
                item.replace(folder / item.name)
    finally:
        shutil.rmtree(draft, ignore_errors=True)
        if is_new:
            with suppress(OSError):  # it holds a report
                folder.rmdir()
