"""The chart: axial force with its 2-sigma band over time, the other components below."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from figures import Chart, Curve, Panel, palette
from figures.chart import WIDTH_IN
from residual.command.curves import Component, component_curves, limits
from residual.command.force_result import ForceResult
from residual.command.force_rows import ForceRows
from residual.command.status_marks import shadings, skipped_ticks
from residual.sensor_config import SensorConfig
from residual.wrench_estimate import Status

_PANEL_IN = 2.2
_LATE_CLOCK_S = 1e5
_LEAST_TRAVEL_M = 1e-3
"""A chart over travel has nothing to show where the tool hardly moves."""


def force_chart(result: ForceResult, width_in: float = WIDTH_IN) -> Chart:
    """Return every estimated component over time.

    Args:
        result: The estimates.
        width_in: Of the chart.
    """
    rows, config = result.overview, result.config
    # Seconds since 1970 would leave the axis no digits for what happened.
    is_late = abs(float(rows.t_s[0])) > _LATE_CLOCK_S
    start_s = float(rows.t_s[0]) if is_late else 0.0
    panels = tuple(
        _panel(label, components, rows, start_s)
        for label, components in _groups(rows, config).items()
    )
    return Chart(
        title=f"{result.log}\n{result.sensor_line}",
        x_label="time since the first sample [s]" if is_late else "time of the log [s]",
        panels=panels,
        shadings=shadings(rows, result.replay.tare, start_s),
        ticks=skipped_ticks(rows, start_s),
        x_limits=(float(rows.t_s.min()) - start_s, float(rows.t_s.max()) - start_s),
        width_in=width_in,
        height_in=0.8 + _PANEL_IN * len(panels),
    )


def travel_chart(result: ForceResult) -> Chart | None:
    """Return the tared axial force over travel, as in the paper's Figure 5; None if there is none.

    Args:
        result: The estimates.
    """
    rows = result.overview
    tared = rows.has_status(Status.OK)
    place_mm = 1e3 * rows.travel_m[tared]
    if not tared.any() or np.ptp(place_mm) < 1e3 * _LEAST_TRAVEL_M:
        return None
    axial_N = np.where(rows.after_gap[tared], np.nan, rows.axial_N[tared])
    curve = Curve(style=palette.OURS, x=place_mm, y=axial_N, label="axial force")
    return Chart(
        title=f"{result.log}\naxial force over travel",
        x_label="travel of the tool along the needle [mm]",
        panels=(Panel(y_label=palette.FORCE, curves=(curve,)),),
    )


def _panel(label: str, components: list[Component], rows: ForceRows, start_s: float) -> Panel:
    """Return the curves that are to be seen: what was not tared may lie outside."""
    low, high = limits(components, rows)
    curves = [curve for item in components for curve in component_curves(item, rows, start_s)]
    seen = [curve for curve in curves if ((curve.y >= low) & (curve.y <= high)).any()]
    return Panel(y_label=label, curves=tuple(seen or curves), limits=(low, high))


def _groups(rows: ForceRows, config: SensorConfig) -> dict[str, list[Component]]:
    axial = Component("axial force", palette.OURS, rows.axial_N, rows.axial_std_N)
    groups = {palette.FORCE: [axial]}
    if config.mode != "axial":
        label = f"force,\n{config.axes} axes [N]"
        groups[label] = _vector("force", rows.force_N, rows.std[:, :3])
    if config.mode == "full":
        label = f"torque,\n{config.axes} axes [Nm]"
        groups[label] = _vector("torque", rows.torque_Nm, rows.std[:, 3:])
    return groups


def _vector(what: str, values: NDArray[np.float64], std: NDArray[np.float64]) -> list[Component]:
    dashes = (palette.OURS.dash, palette.DASHED, palette.DASH_DOTTED)
    return [
        Component(
            f"{what} {name}",
            replace(palette.UNTARED, color=palette.AXES_XYZ[i], dash=dashes[i]),
            values[:, i],
            std[:, i],
        )
        for i, name in enumerate("xyz")
    ]
