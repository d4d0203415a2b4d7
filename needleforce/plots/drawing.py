"""Figures of matplotlib as files: one style, equal figures give equal bytes."""

import re
import warnings
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from foundation.arrays import Array
from needleforce.files import whole_file
from needleforce.plots.errors import (
    ChartError,
    MissingExtraError,
    write_errors,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STYLE = Path(__file__).with_name("chart.mplstyle")
"""Must hold while a figure is drawn and while it is saved."""

FORMATS: dict[str, dict[str, Any]] = {
    ".png": {"dpi": 160},
    ".svg": {"metadata": {"Date": None}},
    ".pdf": {"metadata": {"CreationDate": None}},
}
"""Suffix and what matplotlib needs to know; a date would make equal figures differ."""

WIDTH_IN = 4.4
"""Width of a figure beside another; its letters can be read at the width of a phone."""

WIDE_IN = 8.4
"""Width of a figure alone on a page."""

_NOT_TEXT = re.compile("[\x00-\x09\x0b-\x1f\x7f-\x9f\ud800-\udfff\ufffe\uffff]")
"""What XML or UTF-8 cannot hold."""


def printable(text: str) -> str:
    r"""Return text that XML and UTF-8 can hold.

    Bytes of a file name that cannot be text become ``\udcff``.
    """
    return _NOT_TEXT.sub(
        lambda match: match.group().encode("unicode_escape").decode(), text
    )


def draw_line(
    axes: "Axes", x: Array, y: Array, std: Array | None = None, **style: Any
) -> None:
    """Draw a line, and below it a band of two standard deviations if any are given.

    Args:
        axes: Where.
        x: Places, shape (n,).
        y: Values, shape (n,); what is not finite is not drawn.
        std: Standard deviations, shape (n,).
        style: Of `Axes.plot`, with a colour.
    """
    if std is not None:
        max_points = 2000  # matplotlib thins lines, not areas
        few = slice(None, None, len(x) // max_points + 1)
        band = 2.0 * std[few]
        axes.fill_between(
            x[few], y[few] - band, y[few] + band, color=style["color"], alpha=0.2, lw=0
        )
    axes.plot(x, y, **style)


def mark_instants(axes: "Axes", places: Array, label: str, **style: Any) -> None:
    """Mark events on the lower edge of a panel, where they hide no peak.

    Args:
        axes: The panel.
        places: On its x axis, shape (n,).
        label: In the legend.
        style: Of `Axes.plot`.
    """
    axes.plot(
        places,
        np.full(len(places), 0.03),
        label=label,
        transform=axes.get_xaxis_transform(),
        ls="none",
        zorder=4,
        **style,
    )


def make_panels(
    count: int, width_in: float, height_in: float, title: str
) -> tuple["Figure", list["Axes"]]:
    """Return a figure with panels below each other over one x axis.

    No window and no global state of matplotlib is involved.

    Args:
        count: How many panels.
        width_in: Of the figure.
        height_in: Of the figure.
        title: First line: what is shown; further lines: of which run.
    """
    from matplotlib.figure import Figure

    figure = Figure((width_in, height_in), layout="constrained", facecolor="white")
    panels = figure.subplots(count, sharex=True, squeeze=False)[:, 0].tolist()
    figure.suptitle(printable(title), x=0.01, ha="left", fontsize=9.5)
    for axes in panels:
        axes.axhline(0.0, color="#555555", lw=0.6)
    return figure, panels


def add_legend(figure: "Figure", columns: int = 3) -> None:
    """Add one legend of all panels, below them, where it hides nothing."""
    handles: dict[str, Any] = {}
    for axes in figure.axes:
        found = zip(*axes.get_legend_handles_labels(), strict=True)
        handles |= {label: handle for handle, label in found}
    place = "outside lower left"
    figure.legend(handles.values(), handles, loc=place, ncols=columns)


def require_matplotlib(purpose: str, path: str | Path | None = None) -> None:
    """Find out before the work what could not be drawn after it.

    Args:
        purpose: What needs matplotlib, such as ``--report``.
        path: File of a figure, if there is one.

    Raises:
        MissingExtraError: matplotlib or jinja2 is not installed.
        ChartError: The name of the file does not end in one of `FORMATS`.
    """
    if path is not None and Path(path).suffix.lower() not in FORMATS:
        raise ChartError(
            f"cannot write {path}: its name must end in one of {', '.join(FORMATS)}",
            "Name it .png, .svg or .pdf.",
        )
    try:
        import jinja2  # noqa: F401
        import matplotlib.figure  # noqa: F401
    except ImportError as error:
        raise MissingExtraError(
            f"{purpose} needs {error.name or 'matplotlib'}, which is not installed"
        ) from error


def save_figure(figure: "Figure", path: str | Path) -> Path:
    """Write a figure as PNG, SVG or PDF, by the ending of its name.

    Returns:
        The path.

    Raises:
        ChartError: As `require_matplotlib`.
        WriteError: The file cannot be written.
    """
    require_matplotlib("a figure", path)
    suffix = Path(path).suffix.lower()
    buffer = BytesIO()
    with warnings.catch_warnings():
        # A file name in a script that the font lacks is drawn as boxes.
        warnings.filterwarnings("ignore", "Glyph .* missing from")
        figure.savefig(buffer, format=suffix[1:], **FORMATS[suffix])
    return write_file(path, buffer.getvalue())


def write_file(path: str | Path, content: bytes) -> Path:
    """Write a file whole; a full disk leaves the older one as it was.

    Returns:
        The path.

    Raises:
        WriteError: The file cannot be written.
    """
    with write_errors(f"cannot write {path}"), whole_file(path) as file:
        file.write(content)
    return Path(path)
