"""Forces over time and over depth, with bands of two standard deviations."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from foundation.arrays import Array
from needleforce.depth_zero import find_depth_zero
from needleforce.scene.moment import Moment

CURVES = (("axial force", "#0072b2"), ("tip force", "#d55e00"))
"""Name and colour of each curve; it has a band of two standard deviations."""


def force_table(moments: Sequence[Moment]) -> Array:
    """Return time, depth, and of each curve the force and the edges of its band.

    Only of moments that are tared and valid, and of at most a thousand: shape (n, 8).
    """
    rows: list[list[float]] = []
    for _, estimate in moments[:: len(moments) // 1000 + 1]:
        if estimate.status.value != "ok":
            continue
        found = estimate.identification
        row = [estimate.time_s, find_depth_zero(estimate).shown_mm(estimate.depth_m)]
        for force_N, std_N in (
            (estimate.wrench.axial, estimate.wrench.axial_std),
            (found.tip_force_N, found.tip_force_std_N or 0.0),
        ):
            row += [force_N, force_N + 2.0 * std_N, force_N - 2.0 * std_N]
        rows.append(row)
    return np.array(rows).reshape(-1, 8)


class ForcePlots:
    """The two plots beside the scene.

    Args:
        gui: Of the page.

    Attributes:
        over_depth: Forces over depth.
        over_time: Forces over time.
    """

    def __init__(self, gui: Any) -> None:
        from viser import uplot

        series = [uplot.Series()]
        bands: list[uplot.Band] = []
        for name, color in CURVES:
            series.append(uplot.Series(label=f"{name} [N]", stroke=color, width=2.0))
            edges = (len(series), len(series) + 1)
            bands.append(uplot.Band(series=edges, fill=f"{color}2e"))
            edge = uplot.Series(label="± 2 std", stroke=color, width=0.3)
            series += [edge, edge]
        self.over_depth, self.over_time = (
            gui.add_uplot(
                (np.zeros(1),) * len(series),  # it cannot be made without a point
                (uplot.Series(label=label), *series[1:]),
                bands=tuple(bands),
                scales={"x": uplot.Scale(time=False, auto=True)},
                axes=(uplot.Axis(label=label), uplot.Axis(label="force [N]")),
                legend=uplot.Legend(show=False),
                aspect=1.4,
            )
            for label in ("depth [mm]", "time [s]")
        )

    def draw(self, moments: Sequence[Moment]) -> None:
        """Draw the forces of moments; a plot without any keeps what it shows.

        Over depth those deeper than all before: there no curve runs back.
        """
        table = force_table(moments)
        if not len(table):
            return
        times_s, depths_mm, *curves_N = table.T
        self.over_time.data = (times_s, *curves_N)
        is_deepest = depths_mm >= np.maximum.accumulate(depths_mm)
        self.over_depth.data = tuple(table[is_deepest, 1:].T)
