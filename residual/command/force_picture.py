"""The chart as a picture."""

from pathlib import Path

from figures import require_matplotlib, save_png
from residual.command.errors import CommandError
from residual.command.force_chart import force_chart
from residual.command.force_result import ForceResult

_WIDTH_IN = 9.0


def check_picture(path: str | Path) -> None:
    """Find out before the work what `save_picture` would refuse after it.

    Args:
        path: PNG file to write.

    Raises:
        CommandError: There is no such folder.
        figures.FiguresError: matplotlib is not installed.
    """
    folder = Path(path).parent
    if not folder.is_dir():
        raise CommandError(f"cannot write {path}: there is no folder {folder}")
    require_matplotlib("--png")


def save_picture(path: str | Path, result: ForceResult) -> None:
    """Draw the estimates.

    Args:
        path: PNG file to write.
        result: The estimates.

    Raises:
        figures.FiguresError: The file cannot be written.
    """
    save_png(force_chart(result, _WIDTH_IN), path)
