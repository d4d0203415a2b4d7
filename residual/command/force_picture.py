"""The chart as a picture."""

from pathlib import Path

from figures import save_png
from residual.command.force_chart import force_chart
from residual.command.force_result import ForceResult

_WIDTH_IN = 9.0


def save_picture(path: str | Path, result: ForceResult) -> None:
    """Draw the estimates.

    Args:
        path: PNG file to write.
        result: The estimates.

    Raises:
        figures.FiguresError: The file cannot be written.
    """
    save_png(force_chart(result, _WIDTH_IN), path)
