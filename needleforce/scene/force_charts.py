"""The forces of a film as two charts: over time, and over depth."""

from collections.abc import Sequence

import numpy as np

from foundation.arrays import Array
from needleforce.plots import (
    Chart,
    Curve,
    DrawnChart,
    Instants,
    LineStyle,
    Panel,
    draw_svg,
    palette,
)
from needleforce.scene.force_plots import (
    COLUMN,
    CURVES,
    FORCE_LABEL,
    M_TO_MM,
    TIME_LABEL,
    ForceCurve,
    deepest_rows,
    shown_rows,
)


def draw_force_charts(
    rows: Array, zero_m: float, zero_name: str, events_s: Sequence[float]
) -> dict[str, DrawnChart]:
    """Draw the forces of rows, shape (n, k), by the field of a `FilmFrame` below them.

    Args:
        rows: See `view_row`.
        zero_m: Depth from which shown depths count.
        zero_name: Of that depth, such as ``below first contact``.
        events_s: When ruptures were detected [s].
    """
    rows = shown_rows(rows)
    deepest = deepest_rows(rows)
    times_s = rows[:, COLUMN["time_s"]]
    depths_mm = M_TO_MM * (deepest[:, COLUMN["depth_m"]] - zero_m)
    numbers = np.searchsorted(deepest[:, COLUMN["time_s"]], np.array(events_s))
    events_mm = depths_mm[np.clip(numbers, 0, max(len(depths_mm) - 1, 0))]
    over_time = _chart(TIME_LABEL, rows, times_s, events_s)
    over_depth = _chart(
        f"depth {zero_name} [mm]", deepest, depths_mm, events_mm.tolist()
    )
    return {"time_s": draw_svg(over_time), "depth_mm": draw_svg(over_depth)}


def _chart(x_label: str, rows: Array, x: Array, events: Sequence[float]) -> Chart:
    """Return a chart of all forces of rows over places of an axis, shape (n,)."""
    # On the lower edge of the chart.
    mark = LineStyle(color=palette.ORANGE, marker="|", width_pt=2.0, size_pt=11.0)
    curves = tuple(_curve(curve, rows, x) for curve in CURVES)
    axis = x_label.partition(" ")[0]
    return Chart(
        title=f"Forces over {axis}; bands: two standard deviations",
        x_label=x_label,
        panels=(Panel(y_label=FORCE_LABEL, curves=curves),),
        instants=(Instants("rupture", mark, tuple(events)),),
        height_in=2.6,
    )


def _curve(curve: ForceCurve, rows: Array, x: Array) -> Curve:
    """Return one force of rows with its band."""
    std_N = rows[:, COLUMN[curve.std_field]] if curve.std_field else None
    dash = (0.0, curve.dash) if curve.dash else "-"
    return Curve(
        style=LineStyle(color=curve.hex_color, dash=dash),
        x=x,
        y=rows[:, COLUMN[curve.field]],
        label=f"{curve.name} [N]",
        std=std_N,
    )
