"""From a chart to a matplotlib figure."""

from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np

from figures.chart import WIDTH_IN, Chart
from figures.curve import Curve
from figures.limits import limits_of
from figures.line_style import LineStyle
from figures.panel import Panel
from figures.thinning import kept_points

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SETTINGS: dict[Any, Any] = {
    "font.family": "DejaVu Sans",  # comes with matplotlib: the same everywhere
    "font.size": 9.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.7,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e3e3e3",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "legend.fontsize": 9.0,
    "lines.solid_capstyle": "round",
    "axes.formatter.useoffset": False,
    "svg.fonttype": "path",
    "svg.hashsalt": "needleforce",  # equal charts give equal bytes
}
"""Of matplotlib; must hold while a chart is drawn and while it is saved."""
BAND_OPACITY = 0.2
TWO_COLUMNS = 54
"""Letters that two columns of a legend have room for at the usual width; longer words get one."""
LEGEND_ROW_IN = 0.17
TITLE_LETTERS = 50
"""Of a line at the usual width."""


def draw(chart: Chart) -> "Figure":
    """Draw a chart; no window and no global state of matplotlib is involved."""
    from matplotlib.figure import Figure

    figure = Figure(layout="constrained", facecolor="white")
    heights = [panel.height for panel in chart.panels]
    places = figure.subplots(
        len(heights), 1, sharex=True, squeeze=False, gridspec_kw={"height_ratios": heights}
    )[:, 0]
    for place, panel in zip(places, chart.panels, strict=True):
        _mark(place, chart)
        _draw_panel(place, panel, chart.x_limits)
    figure.align_ylabels(list(places))
    places[-1].set_xlabel(chart.x_label)
    if chart.x_limits is not None:
        places[-1].set_xlim(*chart.x_limits)
    if chart.x_ticks:
        places[-1].set_xticks(*zip(*chart.x_ticks, strict=True))
    figure.suptitle(_title(chart), x=0.01, ha="left", fontsize=9.5, fontweight="bold")
    rows = _legend(figure, list(places), chart)
    figure.set_size_inches(chart.width_in, chart.height_in + rows * LEGEND_ROW_IN)
    return figure


def _draw_panel(axes: "Axes", panel: Panel, x_limits: tuple[float, float] | None) -> None:
    if panel.has_zero_line:
        axes.axhline(0.0, color="#555555", linewidth=0.6)
    for curve in panel.curves:
        _draw_curve(axes, curve)
    axes.set_ylabel(panel.y_label)
    axes.set_ylim(*(panel.limits or limits_of(panel.curves, x_limits)))


def _draw_curve(axes: "Axes", curve: Curve) -> None:
    rows = kept_points(curve.y)
    x, y, style = curve.x[rows], curve.y[rows], curve.style
    if curve.std is not None:
        low, high = y - 2.0 * curve.std[rows], y + 2.0 * curve.std[rows]
        axes.fill_between(
            x,
            low,
            high,
            color=style.color,
            alpha=BAND_OPACITY,
            linewidth=0,
            label=curve.band_label,
            rasterized=False,
        )
    axes.plot(x, y, label=curve.label, **_line(style), **_marker(style))


def _line(style: LineStyle) -> dict[str, Any]:
    return {
        "color": style.color,
        "linestyle": "none" if style.marker else style.dash,
        "linewidth": style.width_pt,
        "alpha": style.opacity,
    }


def _marker(style: LineStyle) -> dict[str, Any]:
    if not style.marker:
        return {}
    return {"marker": style.marker, "markersize": style.size_pt, "markeredgewidth": style.width_pt}


def _mark(axes: "Axes", chart: Chart) -> None:
    for shading in chart.shadings:
        for first, last in shading.spans:
            wide, color = shading.least_pt, shading.color
            axes.axvspan(first, last, color=color, linewidth=wide, label=shading.label)
    for instants in chart.instants:
        for place in instants.places:
            axes.axvline(place, label=instants.label, **_line(instants.style))
    for ticks in chart.ticks:
        if ticks.places:
            axes.plot(
                ticks.places,
                np.full(len(ticks.places), 0.02),
                "|",
                color=ticks.color,
                markersize=8,
                transform=axes.get_xaxis_transform(),
                label=ticks.label,
            )


def _legend(figure: "Figure", places: list["Axes"], chart: Chart) -> int:
    """One legend for all panels, below them, where it hides nothing; returns its rows."""
    shown: dict[str, Any] = {}
    for axes in places:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            shown.setdefault(label, handle)
    if not shown:
        return 0
    marks = [mark.label for mark in (*chart.shadings, *chart.instants, *chart.ticks)]
    ordered = sorted(shown, key=lambda label: label in marks)
    columns = _legend_columns(ordered, chart)
    figure.legend(
        [shown[label] for label in ordered],
        ordered,
        loc="outside lower left",
        ncols=columns,
        handlelength=2.2,
        columnspacing=1.2,
        labelspacing=0.3,
    )
    return -(-len(ordered) // columns)


def _legend_columns(labels: list[str], chart: Chart) -> int:
    half = -(-len(labels) // 2)
    longest = [max(map(len, part), default=0) for part in (labels[:half], labels[half:])]
    return 2 if sum(longest) <= TWO_COLUMNS * chart.width_in / WIDTH_IN else 1


def _title(chart: Chart) -> str:
    most = int(TITLE_LETTERS * chart.width_in / WIDTH_IN)
    return "\n".join(part for line in chart.title.splitlines() for part in wrap(line, most))
