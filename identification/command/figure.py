"""The chart after the paper's Figure 8."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from figures import Chart, Curve, Instants, Panel, palette, save_png
from figures.chart import WIDTH_IN
from identification.command.result import IdentificationResult

Columns = Mapping[str, NDArray[np.float64]]

_FORCES = (
    ("force_N", "axial force, as recorded", palette.READING),
    ("predicted_force_N", "predicted", palette.PREDICTED),
    ("tip_force_N", "tip force", palette.TIP),
    ("enhanced_force_N", "enhanced force", palette.OURS),
)
_PANELS = (
    ("stiffness_N_per_m", "stiffness_std_N_per_m", palette.STIFFNESS),
    ("friction_Ns_per_m2", "friction_std_Ns_per_m2", palette.FRICTION),
    (
        "cumulative_friction_Ns_per_m",
        "cumulative_friction_std_Ns_per_m",
        palette.CUMULATIVE_FRICTION,
    ),
)
_OF_KELVIN_VOIGT = "friction B\n[Ns/m]"
_MOST_OF, _ROOM = 97.0, 1.5
"""Per cent of a parameter's values that its panel must hold, and how much more it shows."""
_PICTURE_IN = 8.0
_LATE_CLOCK_S = 1e5


def save_figure(path: str | Path, result: IdentificationResult) -> None:
    """Write the chart as PNG.

    Args:
        path: File to write.
        result: With an overview.

    Raises:
        figures.FiguresError: It cannot be drawn or written.
    """
    save_png(identification_chart(result, _PICTURE_IN), path)


def identification_chart(result: IdentificationResult, width_in: float = WIDTH_IN) -> Chart:
    """Forces above; stiffness, friction and cumulative friction below.

    Continuous upright lines mark the dated ruptures, dashed ones the compensations.

    Args:
        result: With an overview.
        width_in: Of the chart.
    """
    # Seconds since 1970 would leave the axis no digits for what happened.
    is_late = abs(float(result.overview["t_s"][0])) > _LATE_CLOCK_S
    start_s = float(result.overview["t_s"][0]) if is_late else 0.0
    rows = _drawn(result.overview, start_s)
    forces = tuple(
        Curve(style=style, x=rows["t_s"], y=rows[name], label=label)
        for name, label, style in _FORCES
    )
    return Chart(
        title=f"{result.log}, method {result.method}",
        x_label="time since the first sample [s]" if is_late else palette.TIME,
        panels=(
            Panel(y_label=palette.FORCE, curves=forces, height=2.0),
            *(_parameter(result.method, rows, *panel) for panel in _PANELS),
        ),
        instants=(
            Instants(
                label="rupture, as dated",
                style=palette.RUPTURE,
                places=tuple(t_s - start_s for t_s in result.ruptures_s),
            ),
            Instants(
                label="friction compensated",
                style=palette.COMPENSATION,
                places=tuple(t_s - start_s for t_s in result.compensations_s),
            ),
        ),
        x_limits=(float(rows["t_s"].min()), float(rows["t_s"].max())),
        width_in=width_in,
        height_in=6.4,
    )


def _drawn(rows: Columns, start_s: float) -> dict[str, NDArray[np.float64]]:
    """Return the rows in time from `start_s`; nothing is known before the first absorbed one."""
    is_unknown = np.cumsum(rows["absorbed"]) == 0
    recorded = {"t_s": rows["t_s"] - start_s, "force_N": rows["force_N"]}
    return {name: np.where(is_unknown, np.nan, values) for name, values in rows.items()} | recorded


def _parameter(method: str, rows: Columns, name: str, spread: str, label: str) -> Panel:
    values, std = rows[name], rows[spread]
    is_stated = bool(np.isfinite(std).any())
    curve = Curve(
        style=palette.OURS,
        x=rows["t_s"],
        y=values,
        std=std if is_stated else None,
        band_label="± 2 std" if is_stated else None,
    )
    is_kv = name == "friction_Ns_per_m2" and method.endswith("kv")
    return Panel(
        y_label=_OF_KELVIN_VOIGT if is_kv else label, curves=(curve,), limits=_limits(values)
    )


def _limits(values: NDArray[np.float64]) -> tuple[float, float]:
    """Return room for nearly all values that are not zero; transients may leave the panel."""
    told = values[np.isfinite(values) & (values != 0.0)]
    if not told.size:
        return -0.1, 1.0
    low, high = np.percentile(told, (100.0 - _MOST_OF, _MOST_OF)).tolist()
    top = max(_ROOM * high, 1e-9)
    return min(_ROOM * low, -0.08 * top), top
