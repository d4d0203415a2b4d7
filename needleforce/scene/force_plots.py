"""Forces over time and over depth, with bands of two standard deviations."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from foundation.arrays import Array
from needleforce.depth_zero import find_depth_zero
from needleforce.scene.moment import Moment

CURVES = (("axial force", "#0072b2"), ("tip force", "#d55e00"))
"""Name and colour of each curve; it has a band of two standard deviations."""

AXES = ("depth [mm]", "time [s]")
"""Labels of the x axes of the two plots."""


def force_table(moments: Sequence[Moment]) -> Array:
    """Return time, depth, axial force and deviation, tip force and deviation.

    Only of moments that are tared and valid, and of at most a thousand: shape (n, 6).
    """
    max_rows = 1000
    rows = [
        (
            estimate.time_s,
            find_depth_zero(estimate).shown_mm(estimate.depth_m),
            estimate.wrench.axial,
            estimate.wrench.axial_std,
            estimate.identification.tip_force_N,
            estimate.identification.tip_force_std_N or 0.0,
        )
        for _, estimate in moments[:: len(moments) // max_rows + 1]
        if estimate.status.value == "ok"
    ]
    return np.array(rows).reshape(-1, 6)


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
            for name, color in CURVES:
                series.append(
                    uplot.Series(label=f"{name} [N]", stroke=color, width=2.0)
                )
                edges = (len(series), len(series) + 1)
                bands.append(uplot.Band(series=edges, fill=f"{color}2e"))
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
        """Draw the forces of moments; a plot without any keeps what it shows.

        Over depth those deeper than all before: there no curve runs back.
        """
        table = force_table(moments)
        if not len(table):
            return
        depth_mm = table[:, 1]
        is_deepest = depth_mm >= np.maximum.accumulate(depth_mm)
        shown = {AXES[0]: table[is_deepest], AXES[1]: table}
        for label, rows in shown.items():
            times_s, depths_mm, axial_N, axial_std_N, tip_N, tip_std_N = rows.T
            self.charts[label].data = (
                depths_mm if label == AXES[0] else times_s,
                axial_N,
                axial_N + 2.0 * axial_std_N,
                axial_N - 2.0 * axial_std_N,
                tip_N,
                tip_N + 2.0 * tip_std_N,
                tip_N - 2.0 * tip_std_N,
            )
