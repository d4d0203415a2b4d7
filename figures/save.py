"""Charts as files."""

import re
from io import BytesIO
from pathlib import Path
from typing import Any

from figures.chart import Chart
from figures.draw import SETTINGS, draw
from figures.errors import MissingExtraError, WriteError

MOST_SVG_BYTES = 1_000_000
"""A larger drawing is quicker to show as dots."""
DPI = 160
_COORDINATE = re.compile(r"(-?\d+\.\d)\d+")
_SPACE = re.compile(r"\s*\n|(?<=[A-Za-z]) ")
_PATH = re.compile(r' d="([^"]*)"')


def require_matplotlib(what: str) -> None:
    """Find out before the work what could not be drawn after it.

    Args:
        what: Who needs it, for the message, such as ``--png``.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    try:
        import matplotlib.figure  # noqa: F401
    except ImportError as error:
        raise MissingExtraError(
            f"{what} needs matplotlib, which is not installed; "
            "install it with: pip install 'needleforce[plots]'"
        ) from error


def save_png(chart: Chart, path: str | Path) -> Path:
    """Draw a chart and write it as PNG.

    Raises:
        MissingExtraError: matplotlib is not installed.
        WriteError: The file cannot be written.
    """
    return _write(Path(path), _rendered(chart, "png"))


def save_svg(chart: Chart, path: str | Path) -> Path:
    """Draw a chart and write it as SVG, or as PNG if the SVG would be very large.

    Args:
        chart: What to draw.
        path: Without its ending, which is added.

    Returns:
        The file.

    Raises:
        MissingExtraError: matplotlib is not installed.
        WriteError: The file cannot be written.
    """
    stem = Path(path)
    drawing = _rounded(_rendered(chart, "svg"))
    if len(drawing) > MOST_SVG_BYTES:
        return save_png(chart, stem.with_name(f"{stem.name}.png"))
    return _write(stem.with_name(f"{stem.name}.svg"), drawing)


def _rendered(chart: Chart, kind: str) -> bytes:
    require_matplotlib("a figure")
    from matplotlib import rc_context

    more: dict[str, Any] = {"metadata": {"Date": None}} if kind == "svg" else {"dpi": DPI}
    file = BytesIO()
    with rc_context(SETTINGS):
        draw(chart).savefig(file, format=kind, **more)
    return file.getvalue()


def _rounded(drawing: bytes) -> bytes:
    """A tenth of a point is finer than any line; the other digits are half of the file."""

    def round_path(match: re.Match[str]) -> str:
        shorter = _SPACE.sub("", _COORDINATE.sub(r"\1", match.group(1)))
        return f' d="{shorter}"'

    return _PATH.sub(round_path, drawing.decode()).encode()


def _write(path: Path, content: bytes) -> Path:
    try:
        path.write_bytes(content)
    except OSError as error:
        raise WriteError(f"cannot write {path}: {error.strerror or error}") from error
    return path
