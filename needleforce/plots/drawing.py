"""Charts drawn with matplotlib, for the screen and for print.

Equal charts give equal bytes.
"""

import re
import warnings
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from foundation.arrays import Array
from needleforce.files import whole_file
from needleforce.plots.chart import (
    BAND_STD,
    WIDTH_IN,
    Chart,
    Curve,
    LineStyle,
    Panel,
    Span,
    is_within,
    limits_of,
)
from needleforce.plots.errors import (
    ChartError,
    MissingExtraError,
    WriteError,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STYLE = Path(__file__).with_name("chart.mplstyle")
"""Must hold while a chart is drawn and while it is saved."""

FORMATS: dict[str, dict[str, Any]] = {
    ".png": {"dpi": 160},
    ".svg": {"metadata": {"Date": None}},
    ".pdf": {"metadata": {"CreationDate": None}},
}
"""Suffix and what matplotlib needs to know; a date would make equal charts differ."""


_NOT_TEXT = re.compile("[\x00-\x09\x0b-\x1f\x7f-\x9f\ud800-\udfff\ufffe\uffff]")
"""What XML or UTF-8 cannot hold."""


def printable(text: str) -> str:
    r"""Return text that XML and UTF-8 can hold.

    Bytes of a file name that cannot be text become ``\udcff``.
    """
    return _NOT_TEXT.sub(
        lambda match: match.group().encode("unicode_escape").decode(), text
    )


def draw(chart: Chart) -> "Figure":
    """Draw a chart; no window and no global state of matplotlib is involved."""
    legend_row_in = 0.17  # Height of a row of the legend
    from matplotlib.figure import Figure

    figure = Figure(
        (chart.width_in, chart.height_in), layout="constrained", facecolor="white"
    )
    heights = [panel.height for panel in chart.panels]
    grid = figure.subplots(
        len(heights), sharex=True, squeeze=False, height_ratios=heights
    )
    panels = list(grid[:, 0])
    for axes, panel in zip(panels, chart.panels, strict=True):
        _draw_marks(axes, chart)
        _draw_panel(axes, panel, chart.x_limits)
    figure.align_ylabels(panels)
    panels[-1].set(xlabel=chart.x_label, xlim=chart.x_limits)
    if chart.x_ticks:
        panels[-1].set_xticks(*zip(*chart.x_ticks, strict=True))
    subtitle = _draw_title(figure, chart.title, chart.width_in)
    # The pad leaves room for the values of cut peaks above the panel.
    panels[0].set_title(subtitle, loc="left", fontsize=8.5, color="#444444", pad=10.0)
    marks = [mark.label for mark in (*chart.shadings, *chart.instants)]
    rows = _draw_legend(figure, panels, marks)
    figure.set_size_inches(chart.width_in, chart.height_in + rows * legend_row_in)
    return figure


def _draw_title(figure: "Figure", title: str, width_in: float) -> str:
    """Draw the first line of a title in bold; return the others, to draw below it."""
    title_letters = 54  # Letters of a title's line at the usual width
    letters = int(width_in / WIDTH_IN * title_letters)
    first, *others = (
        "\n".join(wrap(line, letters)) for line in printable(title).split("\n")
    )
    figure.suptitle(first, x=0.01, ha="left", fontsize=9.5, fontweight="bold")
    return "\n".join(others)


def _line_arguments(style: LineStyle) -> dict[str, Any]:
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


def _draw_legend(
    figure: "Figure",
    panels: Sequence["Axes"],
    last: Sequence[str],
) -> int:
    """Draw one legend for all panels, below them, where it hides nothing.

    Args:
        figure: The figure.
        panels: Its panels.
        last: Labels that come last.

    Returns:
        Its rows.
    """
    legend_columns = (4, 3, 2, 1)  # Columns of the legend: the most that fit are taken
    handles: dict[str, Any] = {}
    for axes in panels:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    if not handles:
        return 0
    labels = sorted(handles, key=lambda label: label in last)
    ordered = [handles[label] for label in labels]
    columns = legend_columns[0]
    for columns in legend_columns:
        legend = figure.legend(ordered, labels, loc="outside lower left", ncols=columns)
        if legend.get_window_extent().width <= figure.bbox.width:
            break
        if columns > 1:
            legend.remove()
    return -(-len(labels) // columns)


def _draw_panel(axes: "Axes", panel: Panel, x_limits: Span | None) -> None:
    """Draw the curves of a panel, and mark where they are cut."""
    axes.axhline(0.0, color="#555555", linewidth=0.6)
    for curve in panel.curves:
        _draw_curve(axes, curve, x_limits)
    limits = panel.limits or limits_of(panel.curves, x_limits)
    axes.set(ylabel=panel.y_label, ylim=limits)
    for edge, side in zip(limits, (-1.0, 1.0), strict=True):
        _mark_cut_curves(axes, panel.curves, edge, side, x_limits)


def _draw_marks(axes: "Axes", chart: Chart) -> None:
    """Draw the shadings and the instants of a chart into a panel."""
    pt_per_in = 72.0
    from matplotlib.transforms import ScaledTranslation

    for label, color, spans, min_width_pt in chart.shadings:
        for start, end in spans:
            axes.axvspan(
                start, end, color=color, linewidth=min_width_pt, label=label, zorder=0.4
            )
    for label, style, places in chart.instants:
        if not places:
            continue
        half_size_in = style.size_pt / pt_per_in / 2.0
        lift = ScaledTranslation(0.0, half_size_in, axes.figure.dpi_scale_trans)
        axes.plot(
            places,
            np.zeros(len(places)),
            label=label,
            transform=axes.get_xaxis_transform() + lift,
            zorder=4,
            **_line_arguments(style),
        )


def _draw_curve(axes: "Axes", curve: Curve, x_limits: Span | None) -> None:
    """Draw a curve, and its band below it."""
    if curve.std is not None:
        _draw_band(axes, curve, curve.std, x_limits)
    axes.plot(curve.x, curve.y, label=curve.label, **_line_arguments(curve.style))


def _draw_band(axes: "Axes", curve: Curve, std: Array, x_limits: Span | None) -> None:
    """Shade the band of a curve, and draw its edges."""
    area_points = 1000  # Points of a band at most, or fewer than twice as many
    band_opacity = 0.2
    x = curve.x
    low = curve.y - BAND_STD * std
    high = curve.y + BAND_STD * std
    # matplotlib thins lines, not areas. All NaN stay, so that no gap is bridged.
    seen = np.flatnonzero(is_within(x, x_limits))
    thinned = seen[:: len(seen) // area_points + 1]
    points = np.union1d(thinned, np.flatnonzero(np.isnan(low)))
    axes.fill_between(
        x[points],
        low[points],
        high[points],
        color=curve.style.color,
        label=curve.band_label,
        alpha=band_opacity,
        linewidth=0,
    )
    for edge in (low, high):  # above the curve, whose noise may fill the band
        axes.plot(x, edge, color=curve.style.color, linewidth=0.5, alpha=0.6, zorder=3)


class _CutPoint(NamedTuple):
    """A point of a curve beyond the edge of its panel."""

    x: float
    y: float
    color: str


def _mark_cut_curves(
    axes: "Axes",
    curves: Sequence[Curve],
    edge: float,
    side: float,
    x_limits: Span | None,
) -> None:
    """Draw triangles where curves leave a panel, and the value of the farthest.

    Args:
        axes: The panel.
        curves: Its curves.
        edge: Upper or lower limit of its y axis.
        side: 1 for the upper edge, -1 for the lower one.
        x_limits: Limits of the x axis; None for all of it.
    """
    farthest: _CutPoint | None = None
    for curve in curves:
        is_cut = (side * curve.y > side * edge) & is_within(curve.x, x_limits)
        if not is_cut.any():
            continue
        x = curve.x[is_cut]
        y = curve.y[is_cut]
        _draw_cut_marks(axes, curve, x, edge, side, x_limits)
        extreme = int(np.argmax(side * y))
        if farthest is None or side * y[extreme] > side * farthest.y:
            farthest = _CutPoint(
                float(x[extreme]), float(y[extreme]), curve.style.color
            )
    if farthest is not None:
        _write_value(axes, farthest, edge)


def _draw_cut_marks(
    axes: "Axes",
    curve: Curve,
    x: Array,
    edge: float,
    side: float,
    x_limits: Span | None,
) -> None:
    """Draw triangles on an edge at places of a curve, shape (n,), but not too many."""
    cut_marks = 40  # Marks of cut curves along an edge at most
    width = np.ptp(x_limits or curve.x[np.isfinite(curve.x)])
    step = width / cut_marks or 1.0
    places = step * np.unique(np.round(x / step))
    axes.plot(
        places,
        np.full(len(places), edge),
        " ",
        marker="^" if side > 0 else "v",
        markersize=3.5,
        color=curve.style.color,
        clip_on=False,
        zorder=5,
    )


def _write_value(axes: "Axes", point: _CutPoint, edge: float) -> None:
    """Write the value of a point on the edge, towards the middle of the panel."""
    value_gap_pt = 4.0  # Gap between the farthest mark of a cut curve and its value
    text = f"{point.y:.3g}" if abs(point.y) < 1e3 else f"{point.y:.0f}"
    text = text.replace("-", "\N{MINUS SIGN}")
    is_right = point.x > np.mean(axes.get_xlim())
    axes.annotate(
        text,
        (point.x, edge),
        (-value_gap_pt if is_right else value_gap_pt, 2.0),
        textcoords="offset points",
        fontsize=7.0,
        color=point.color,
        va="bottom",
        ha="right" if is_right else "left",
    )


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


def save_figure(chart: Chart, path: str | Path) -> Path:
    """Draw a chart and write it as PNG, SVG or PDF, by the ending of its name.

    Returns:
        The path.

    Raises:
        MissingExtraError: As `require_matplotlib`.
        ChartError: As `require_matplotlib`.
        WriteError: The file cannot be written.
    """
    require_matplotlib("a figure", path)
    from matplotlib import rc_context

    suffix = Path(path).suffix.lower()
    with rc_context(fname=STYLE):
        content = _encode(draw(chart), suffix)
    return write_file(path, content)


def draw_svg(chart: Chart) -> bytes:
    """Return a chart as SVG, for a page without other files.

    Raises:
        MissingExtraError: As `require_matplotlib`.
    """
    require_matplotlib("a figure")
    from matplotlib import rc_context

    with rc_context(fname=STYLE):
        return _encode(draw(chart), ".svg")


def _encode(figure: "Figure", suffix: str) -> bytes:
    """Return a figure as the content of a file with a suffix of `FORMATS`."""
    buffer = BytesIO()
    with warnings.catch_warnings():
        # A file name in a script that the font lacks is drawn as boxes.
        warnings.filterwarnings("ignore", "Glyph .* missing from")
        figure.savefig(buffer, format=suffix[1:], **FORMATS[suffix])
    content = buffer.getvalue()
    if suffix != ".svg":
        return content
    # A tenth of a point is finer than any line; the other digits are half of the file.
    return re.sub(rb" \nL (-?\d+\.\d)\d* (-?\d+\.\d)\d*", rb"L\1 \2", content)


def write_file(path: str | Path, content: bytes) -> Path:
    """Write a file whole; a full disk leaves the older one as it was.

    Returns:
        The path.

    Raises:
        WriteError: The file cannot be written.
    """
    try:
        with whole_file(path) as file:
            file.write(content)
    except OSError as error:
        raise WriteError(f"cannot write {path}: {error.strerror or error}") from error
    return Path(path)
