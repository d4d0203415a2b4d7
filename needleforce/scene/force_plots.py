"""Forces over time and over depth, with bands of two standard deviations."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from foundation.arrays import Array
from needleforce.depth_zero import find_depth_zero
from needleforce.scene.moment import Moment

CURVES = (
    ("axial force", "#0072b2", "-", 1),
    ("tip force", "#d55e00", "--", 3),
    ("enhanced force", "#000000", ":", 5),
)
"""Name, colour, dashes, and column of `force_table` of each curve; behind the first two
stands the column of their standard deviation."""

AXES = ("depth [mm]", "time [s]")
"""Labels of the x axes of the two plots."""


def force_table(moments: Sequence[Moment]) -> Array:
    """Return time, axial force and deviation, tip and deviation, enhanced force, depth.

    Only of moments that are tared and valid, and of at most a thousand: shape (n, 7).
    """
    max_rows = 1000
    rows = [
        (
            estimate.time_s,
            estimate.wrench.axial,
            estimate.wrench.axial_std,
            estimate.identification.tip_force_N,
            estimate.identification.tip_force_std_N or 0.0,
            estimate.identification.enhanced_force_N,
            find_depth_zero(estimate).shown_mm(estimate.depth_m),
        )
        for _, estimate in moments[:: len(moments) // max_rows + 1]
        if estimate.status.value == "ok"
    ]
    return np.array(rows).reshape(-1, 7)


def places_of(table: Array) -> dict[str, tuple[Array, Array]]:
    """Return the places of each plot with the rows that it shows.

    Over depth those deeper than all before: there no curve runs back.
    """
    depth_mm = table[:, 6]
    is_deepest = depth_mm >= np.maximum.accumulate(depth_mm)
    deepest = table[is_deepest]
    return {AXES[0]: (deepest[:, 6], deepest), AXES[1]: (table[:, 0], table)}


class ForcePlots:
    """The two plots beside the scene.

    Args:
        gui: Of the page.

    Attributes:
        charts: The plots by the label of their x axis.
    """

    def __init__(self, gui: Any) -> None:
        from viser import uplot

        # A plot cannot be made without a point.
        empty = np.zeros(1)
        self.charts: dict[str, Any] = {}
        for label in AXES:
            series = [uplot.Series(label=label)]
            bands: list[Any] = []
            for name, color, _, column in CURVES:
                series.append(
                    uplot.Series(label=f"{name} [N]", stroke=color, width=2.0)
                )
                if column < CURVES[-1][3]:
                    bands.append(
                        uplot.Band(
                            series=(len(series), len(series) + 1), fill=f"{color}2e"
                        )
                    )
                    edge = uplot.Series(label="± 2 std", stroke=color, width=0.3)
                    series += [edge, edge]
            self.charts[label] = gui.add_uplot(
                (empty,) * len(series),
                tuple(series),
                bands=tuple(bands),
                scales={"x": uplot.Scale(time=False, auto=True)},
                axes=(uplot.Axis(label=label), uplot.Axis(label="force [N]")),
                legend=uplot.Legend(show=False),
                aspect=1.4,
            )

    def draw(self, moments: Sequence[Moment]) -> None:
        """Draw the forces of moments; a plot without any keeps what it shows."""
        for label, (places, rows) in places_of(force_table(moments)).items():
            curves: list[Array] = []
            for _, _, _, column in CURVES:
                force_N = rows[:, column]
                curves.append(force_N)
                if column < CURVES[-1][3]:
                    band_N = 2.0 * rows[:, column + 1]
                    curves += [force_N + band_N, force_N - band_N]
            if len(places):
                self.charts[label].data = (places, *curves)
