"""Lines and points in space, as plain data, and their drawing to one scale."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from foundation.arrays import Array
from needleforce.plots.chart import WIDTH_IN, LineStyle
from needleforce.plots.errors import ChartError
from needleforce.plots.frame import (
    LEGEND_ROW_IN,
    draw_legend,
    draw_title,
    line_arguments,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ELEVATION_DEG = 18.0
"""Height of the eye above the horizontal plane."""

AZIMUTH_DEG = -58.0
"""Direction of the eye about the vertical axis, from x."""

TICKS = 3
"""Ticks on each axis, at most one more."""


class SpaceCurve(NamedTuple):
    """A line in space, or points where its style has a marker.

    Attributes:
        style: How it is drawn.
        points: Its points in order, shape (n, 3).
        label: Its name in the legend; None for none there.
    """

    style: LineStyle
    points: Array
    label: str | None = None


class SpaceAxes(NamedTuple):
    """Words on the axes of space.

    Attributes:
        x: On the first one.
        y: On the second one.
        z: On the third one, which points up.
    """

    x: str
    y: str
    z: str


@dataclass(frozen=True, slots=True, kw_only=True)
class SpaceChart:
    """Curves in space, drawn without perspective and with one scale on all axes.

    Attributes:
        title: First line: what is shown, in bold; further lines: of which run.
        axes: Words on its axes.
        curves: Its curves.
        low: Least values on the three axes, shape (3,).
        high: Largest values, shape (3,).
        width_in: Width.
        height_in: Height without the legend.

    Raises:
        ChartError: The chart is empty, or a limit is none.
    """

    title: str
    axes: SpaceAxes
    curves: tuple[SpaceCurve, ...]
    low: Array
    high: Array
    width_in: float = WIDTH_IN
    height_in: float = 4.4

    def __post_init__(self) -> None:
        if not self.curves or not np.all(np.less(self.low, self.high)):
            raise ChartError(
                f"chart {self.title!r} has {len(self.curves)} curves between "
                f"{self.low} and {self.high}; give it curves and limits that rise"
            )


def draw_space(chart: SpaceChart) -> "Figure":
    """Draw curves in space; no global state of matplotlib is involved."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    figure = Figure((chart.width_in, chart.height_in), facecolor="white")
    # Loosely typed: the stubs of matplotlib do not know axes in space.
    axes: Any = figure.add_axes((0.02, 0.2, 0.9, 0.74), projection="3d")
    axes.set_proj_type("ortho")
    axes.view_init(ELEVATION_DEG, AZIMUTH_DEG)
    limits = np.transpose((chart.low, chart.high))
    axes.set(xlim=limits[0], ylim=limits[1], zlim=limits[2])
    axes.set_box_aspect(limits[:, 1] - limits[:, 0], zoom=0.9)
    axes.set(xlabel=chart.axes.x, ylabel=chart.axes.y, zlabel=chart.axes.z)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_major_locator(MaxNLocator(TICKS))
        axis.pane.fill = False
    axes.tick_params(labelsize=7.5, pad=-1)
    for curve in chart.curves:
        axes.plot(*curve.points.T, label=curve.label, **line_arguments(curve.style))
    subtitle = draw_title(figure, chart.title, chart.width_in)
    figure.text(0.01, 0.925, subtitle, va="top", fontsize=8.5, color="#444444")
    rows = draw_legend(figure, [axes], is_inside=True)
    figure.set_size_inches(chart.width_in, chart.height_in + rows * LEGEND_ROW_IN)
    return figure
