"""Forces over time and over depth, with bands of two standard deviations."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from foundation.arrays import Array
from needleforce.scene.legend import LINE, LegendLine, legend_html
from needleforce.scene.nodes import PATH_COLOR, Color
from needleforce.scene.state_ring import FIELDS

TIME_LABEL = "time [s]"
DEPTH_LABEL = "depth [mm]"
FORCE_LABEL = "force [N]"

M_TO_MM = 1e3

COLUMN = {name: column for column, name in enumerate(FIELDS)}
"""Columns of rows by the names of their fields."""


class ForceCurve(NamedTuple):
    """A force in the plots.

    Attributes:
        name: In the legend.
        field: Of a row, with its values.
        std_field: Of a row, with their standard deviations; empty where none are known.
        color: Told apart also without red or green.
        dash: Pixels drawn and left out; empty for a line without gaps.
    """

    name: str
    field: str
    std_field: str
    color: Color
    dash: tuple[float, ...] = ()

    @property
    def hex_color(self) -> str:
        """The colour as ``#rrggbb``."""
        return "#{:02x}{:02x}{:02x}".format(*self.color)


CURVES = (
    ForceCurve("axial force", "force_N", "force_std_N", Color(0, 114, 178)),
    ForceCurve("tip force", "tip_N", "tip_std_N", Color(213, 94, 0), (8.0, 3.0)),
    ForceCurve("enhanced force", "enhanced_N", "", Color(0, 0, 0), (2.0, 3.0)),
)


class ForcePlots:
    """The two plots.

    Over depth the planned boundaries are drawn, too, from the start. A curve that
    begins with nan would leave a plot empty: where nothing is known yet, curves end.

    Args:
        gui: Of the page.
        boundaries_m: Planned, below the entry; none without a planned entry.

    Attributes:
        charts: The plots by the label of their x axis.
    """

    def __init__(self, gui: Any, boundaries_m: Sequence[float] = ()) -> None:
        self._boundaries_mm = M_TO_MM * np.array(boundaries_m, dtype=float)
        names = [LegendLine(LINE, curve.color, curve.name) for curve in CURVES]
        names.append(LegendLine(LINE, PATH_COLOR, "planned boundary"))
        gui.add_html(legend_html(names))
        self.charts = {
            label: _add_chart(gui, label) for label in (DEPTH_LABEL, TIME_LABEL)
        }
        self.draw(np.empty((0, len(FIELDS))), 0.0)

    def draw(self, rows: Array, zero_m: float) -> None:
        """Draw the forces of rows, shape (n, k), where they were good.

        Args:
            rows: See `view_row`.
            zero_m: Depth from which shown depths count.
        """
        rows = shown_rows(rows)
        times_s = rows[:, COLUMN["time_s"]]
        curves = _curves_of(rows)
        axis_s = times_s if len(times_s) else np.array([0.0, 1.0])
        self.charts[TIME_LABEL].data = (axis_s, np.zeros(len(axis_s)), *curves)
        deepest = deepest_rows(rows)
        depths_mm = M_TO_MM * (deepest[:, COLUMN["depth_m"]] - zero_m)
        self.charts[DEPTH_LABEL].data = self._over_depth(depths_mm, _curves_of(deepest))

    def _over_depth(self, depths_mm: Array, curves: list[Array]) -> tuple[Array, ...]:
        """Return depths, planned boundaries and forces for the plot over depth.

        A boundary is a line that rises and falls at one depth; between boundaries it
        lies on the axis. Forces beyond the depths that are known are not drawn.
        """
        boundaries_mm = self._boundaries_mm
        if len(depths_mm):
            boundaries_mm = boundaries_mm[boundaries_mm >= depths_mm[0]]
        elif not len(boundaries_mm):
            depths_mm = np.array([0.0, 1.0])
            return (depths_mm, np.zeros(2), *curves)
        places_mm = np.sort(np.concatenate([depths_mm, boundaries_mm.repeat(3)]))
        top_N = max((float(curve.max()) for curve in curves if len(curve)), default=1.0)
        planned_N = np.zeros(len(places_mm))
        starts = np.searchsorted(places_mm, boundaries_mm)
        planned_N[starts + 1] = max(top_N, 1.0)
        if not len(depths_mm):
            return (places_mm, planned_N, *curves)
        reached_mm = places_mm[places_mm <= depths_mm[-1]]
        shown = [np.interp(reached_mm, depths_mm, curve) for curve in curves]
        return (places_mm, planned_N, *shown)


def shown_rows(rows: Array) -> Array:
    """Return rows, shape (n, k), that were good, thinned to those that are drawn."""
    rows = rows[rows[:, COLUMN["is_good"]] > 0.0]
    max_points = 500  # of a curve
    return rows[:: max(len(rows) // max_points, 1)]


def deepest_rows(rows: Array) -> Array:
    """Return the rows deeper than all before: over depth no curve runs back."""
    depth_m = rows[:, COLUMN["depth_m"]]
    return rows[depth_m >= np.maximum.accumulate(depth_m)]


def _curves_of(rows: Array) -> list[Array]:
    """Return the forces of rows, each with the edges of its band behind it."""
    curves: list[Array] = []
    for curve in CURVES:
        force_N = rows[:, COLUMN[curve.field]]
        curves.append(force_N)
        if curve.std_field:
            band_N = 2.0 * rows[:, COLUMN[curve.std_field]]
            curves += [force_N + band_N, force_N - band_N]
    return curves


def _add_chart(gui: Any, x_label: str) -> Any:
    """Add a plot of the curves, each with its band."""
    from viser import uplot

    line_px = 2.0
    band_px = 0.3  # of the two lines that bound a band
    series = [
        uplot.Series(label=x_label),
        uplot.Series(label="planned boundary", stroke="#3c3c3c", width=1.0),
    ]
    bands = []
    for curve in CURVES:
        line = uplot.Series(
            label=f"{curve.name} [N]",
            stroke=curve.hex_color,
            width=line_px,
            dash=curve.dash,
        )
        series.append(line)
        if not curve.std_field:
            continue
        upper = len(series)
        bands.append(uplot.Band(series=(upper, upper + 1), fill=f"{curve.hex_color}2e"))
        series += [
            uplot.Series(label=label, stroke=curve.hex_color, width=band_px)
            for label in ("+ 2 std", "- 2 std")
        ]

    return gui.add_uplot(
        tuple(np.zeros(1) for _ in series),
        tuple(series),
        bands=tuple(bands),
        scales={
            "x": uplot.Scale(time=False, auto=True),
            # At least from 0 to 1.1 N: the boundaries reach to 1 N.
            "y": uplot.Scale(
                auto=True,
                range={
                    "min": {"pad": 0.1, "soft": 0.0, "mode": 1},
                    "max": {"pad": 0.1, "soft": 1.1, "mode": 1},
                },
            ),
        },
        axes=(uplot.Axis(label=x_label), uplot.Axis(label=FORCE_LABEL)),
        # Its entries would be taller than the plot; the words above it say the same.
        legend=uplot.Legend(show=False),
        aspect=1.4,
    )
