"""Charts as plain data: panels over one x axis.

What a chart shows can be tested without drawing it; `drawing` draws it.

    panel = Panel(y_label=palette.FORCE, curves=(curve,))
    chart = Chart(title="Forces", x_label=palette.TIME, panels=(panel,))
    save_figure(chart.within(10.0, 20.0), "forces.pdf")
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.arrays import Array
from needleforce.plots.errors import ChartError

Span = tuple[float, float]
"""From a place of an axis to another."""

Dash = str | tuple[float, tuple[float, ...]]
"""Dashes as matplotlib names them: "-", or (offset, (on, off, ...))."""

WIDTH_IN = 4.4
"""Width of a chart beside another; its letters can be read at the width of a phone."""

WIDE_IN = 8.4
"""Width of a chart alone on a page."""


MARGIN = 0.06
"""Space above and below, in heights of what is shown."""

BAND_STD = 2.0
"""Standard deviations to either side that a band is wide."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LineStyle:
    """How one kind of curve or event is drawn; a style with a marker draws no line.

    Attributes:
        color: Colour, as matplotlib names it.
        dash: Dashes of the line.
        width_pt: Width of the line, or of the edge of the marker.
        opacity: From 0, not seen, to 1.
        marker: Marker, as matplotlib names it; empty for a line.
        size_pt: Size of the marker.
    """

    color: str
    dash: Dash = "-"
    width_pt: float = 1.1
    opacity: float = 1.0
    marker: str = ""
    size_pt: float = 7.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Curve:
    """One line of a panel; a value that is not finite is not drawn.

    Attributes:
        style: How it is drawn.
        x: Places on the x axis, shape (n,).
        y: Values, shape (n,).
        label: Its name in the legend; None for none there.
        std: Standard deviations, shape (n,): a band of two to either side is shaded.
        band_label: Name of the band in the legend; None for none there.

    Raises:
        ChartError: The arrays have other shapes.
    """

    style: LineStyle
    x: Array
    y: Array
    label: str | None = None
    std: Array | None = None
    band_label: str | None = None

    def __post_init__(self) -> None:
        for name in ("x", "y", "std"):
            value = getattr(self, name)
            if value is not None and (np.ndim(value) != 1 or len(value) != len(self.x)):
                raise ChartError(
                    f"curve {self.label!r}: {name} has shape {np.shape(value)} where x "
                    f"has {np.shape(self.x)}"
                )


@dataclass(frozen=True, slots=True, kw_only=True)
class Panel:
    """One of the panels that share the x axis of a chart.

    Attributes:
        y_label: Label of its y axis.
        curves: Its curves; the last one is drawn on top.
        limits: Limits of the y axis; None for `limits_of` the curves. What is cut off
            is marked.
        height: Its height, over that of other panels.
    """

    y_label: str
    curves: tuple[Curve, ...]
    limits: Span | None = None
    height: float = 1.0


class Shading(NamedTuple):
    """Spans of the x axis behind the curves of every panel.

    Attributes:
        label: Their name in the legend.
        color: Their colour.
        spans: From where to where each reaches.
        min_width_pt: Each is at least so wide, so that it is seen.
    """

    label: str
    color: str
    spans: tuple[Span, ...]
    min_width_pt: float = 0.0


class Instants(NamedTuple):
    """Events in every panel: markers on the lower edge, where they hide no peak.

    Attributes:
        label: Their name in the legend.
        style: How they are drawn.
        places: Where they are on the x axis.
    """

    label: str
    style: LineStyle
    places: tuple[float, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Chart:
    """Panels below each other over one x axis, with one legend below them.

    Attributes:
        title: First line: what is shown, in bold; further lines: of which run.
        x_label: Label of the x axis.
        panels: The panels from above, at least one.
        shadings: Spans that are marked in every panel.
        instants: Events that are marked in every panel.
        x_limits: Limits of the x axis; None for what the curves need.
        x_ticks: Places on the x axis and what stands there; none for numbers.
        width_in: Width.
        height_in: Height without the legend.

    Raises:
        ChartError: There is no panel.
    """

    title: str
    x_label: str
    panels: tuple[Panel, ...]
    shadings: tuple[Shading, ...] = ()
    instants: tuple[Instants, ...] = ()
    x_limits: Span | None = None
    x_ticks: tuple[tuple[float, str], ...] = ()
    width_in: float = WIDTH_IN
    height_in: float = 3.0

    def __post_init__(self) -> None:
        if not self.panels:
            raise ChartError(f"chart {self.title!r} has no panel")

    def within(self, first: float, last: float) -> "Chart":
        """Return the chart between two places of the x axis.

        Its y axes fit what is seen there.

        Raises:
            ChartError: The second place is not behind the first.
        """
        if not first < last:
            raise ChartError(
                f"window from {first:g} to {last:g}; the end must lie after the start"
            )
        panels = tuple(replace(panel, limits=None) for panel in self.panels)
        return replace(self, panels=panels, x_limits=(first, last))


def limits_of(curves: Sequence[Curve], x_limits: Span | None) -> Span:
    """Return limits of a y axis that show zero, and most of every curve and its band.

    Args:
        curves: The curves of a panel.
        x_limits: Limits of the x axis; None for all of it.
    """
    # Per cent of the edges of a curve's band that its panel shows
    shown_band_percent = 95.0
    shown_percent = 99.8  # Per cent of the points of a curve that its panel shows
    edges = [0.0]
    for curve in curves:
        is_seen = np.isfinite(curve.y) & is_within(curve.x, x_limits)
        if not is_seen.any():
            continue
        y = curve.y[is_seen]
        edges += [*np.percentile(y, (100.0 - shown_percent, shown_percent))]
        if curve.std is not None:
            half_width = np.nan_to_num(BAND_STD * curve.std[is_seen], posinf=0.0)
            edges += [np.percentile(y - half_width, 100.0 - shown_band_percent)]
            edges += [np.percentile(y + half_width, shown_band_percent)]
    low = float(min(edges))
    high = float(max(edges))
    margin = MARGIN * (high - low) or 1.0
    return low - margin, high + margin


def is_within(x: Array, x_limits: Span | None) -> NDArray[np.bool_]:
    """Return which finite places of an axis lie within limits, shape (n,)."""
    low, high = x_limits or (-np.inf, np.inf)
    return (x >= low) & (x <= high) & np.isfinite(x)
