"""What every figure has: a title above, a legend below, lines of a style."""

import re
from collections.abc import Sequence
from textwrap import wrap
from typing import TYPE_CHECKING, Any

from needleforce.plots.chart import WIDTH_IN, LineStyle

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TITLE_LETTERS = 54
"""Letters of a title's line at the usual width."""

LEGEND_ROW_IN = 0.17
"""Height of a row of the legend."""

LEGEND_COLUMNS = (4, 3, 2, 1)
"""Columns of the legend: the most that fit are taken."""

_NOT_TEXT = re.compile("[\x00-\x09\x0b-\x1f\x7f-\x9f\ud800-\udfff\ufffe\uffff]")
"""What XML or UTF-8 cannot hold."""


def printable(text: str) -> str:
    r"""Return text that XML and UTF-8 can hold.

    Bytes of a file name that cannot be text become ``\udcff``.
    """
    return _NOT_TEXT.sub(
        lambda match: match.group().encode("unicode_escape").decode(), text
    )


def draw_title(figure: "Figure", title: str, width_in: float) -> str:
    """Draw the first line of a title in bold; return the others, to draw below it."""
    letters = int(width_in / WIDTH_IN * TITLE_LETTERS)
    first, *others = (
        "\n".join(wrap(line, letters)) for line in printable(title).split("\n")
    )
    figure.suptitle(first, x=0.01, ha="left", fontsize=9.5, fontweight="bold")
    return "\n".join(others)


def line_arguments(style: LineStyle) -> dict[str, Any]:
    """Return the arguments of matplotlib for a style."""
    arguments: dict[str, Any] = {"color": style.color, "alpha": style.opacity}
    if style.marker:
        return arguments | {
            "marker": style.marker,
            "ms": style.size_pt,
            "mew": style.width_pt,
            "linestyle": "none",
        }
    return arguments | {"linestyle": style.dash, "linewidth": style.width_pt}


def draw_legend(
    figure: "Figure",
    panels: Sequence["Axes"],
    last: Sequence[str] = (),
    *,
    is_inside: bool = False,
) -> int:
    """Draw one legend for all panels, below them, where it hides nothing.

    Args:
        figure: The figure.
        panels: Its panels.
        last: Labels that come last.
        is_inside: Whether it stands in the figure's own lower margin, where no layout
            makes room for it.

    Returns:
        Its rows.
    """
    handles: dict[str, Any] = {}
    for axes in panels:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    if not handles:
        return 0
    labels = sorted(handles, key=lambda label: label in last)
    ordered = [handles[label] for label in labels]
    place = "lower left" if is_inside else "outside lower left"
    columns = LEGEND_COLUMNS[0]
    for columns in LEGEND_COLUMNS:
        legend = figure.legend(ordered, labels, loc=place, ncols=columns)
        if legend.get_window_extent().width <= figure.bbox.width:
            break
        if columns > 1:
            legend.remove()
    return -(-len(labels) // columns)
