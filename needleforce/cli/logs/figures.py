"""Figures of forces and layers over time or depth, drawn by matplotlib."""

from collections.abc import Mapping, Sequence
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from needleforce import plots
from needleforce.cli.options import Over
from needleforce.plots import palette
from needleforce.plots.drawing import printable
from needleforce.session_replay import STATUS_CODES, SensorReplay
from residual import Status

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from needleforce.cli.logs.layers import LayerReplay

Line = dict[str, Any]
"""A line of a panel: `y`, perhaps `std`, and the style and label of `plots.draw_line`;
a line that `is_beside` the others does not stretch the scale of its panel."""


def draw_forces(
    replay: SensorReplay, title: str, over: Over, width_in: float
) -> "Figure":
    """Return the force along the needle.

    What was not tared is grey. A rejected row leaves no hole, a gap in time does.

    Args:
        replay: The forces.
        title: Title of the figure.
        over: Time, or travel of the tool.
        width_in: Width of the figure.
    """
    all_rows: Any = replay.rows
    start_s, x_label = _time_axis(all_rows["t_s"])
    rows = all_rows[all_rows["force_status"] != STATUS_CODES[Status.REJECTED]]
    x = rows["t_s"] - start_s
    if over == "depth":
        x = 1e3 * rows["travel_m"]
        x_label = "travel from the first row [mm]"
    y = rows["axial_N"].where(~rows["after_gap"])
    is_tared = rows["force_status"] == STATUS_CODES[Status.OK]
    untared: Line = {
        "y": y.where(~is_tared),
        "label": "not tared",
        "color": palette.GREY,
        "is_beside": bool(is_tared.any()),
    }
    tared: Line = {
        "y": y.where(is_tared),
        "std": rows["axial_std_N"],
        "label": "axial force",
        "color": palette.BLUE,
    }
    figure = _draw_panels(
        {palette.FORCE: [untared, tared]}, x, title, x_label, width_in
    )
    if replay.window is not None and over == "time":
        start, end = np.subtract(replay.window, start_s)
        figure.axes[0].axvspan(start, end, color=palette.TARE, label="tare")
    plots.add_legend(figure, 2 if width_in < plots.WIDE_IN else 4)
    return figure


def draw_layers(
    found: "LayerReplay", title: str, over: Over, width_in: float
) -> "Figure":
    """Return forces above, parameters below, as in Figure 8 of Ferro et al.

    Args:
        found: The layers.
        title: Title of the figure.
        over: Time, or depth of the needle.
        width_in: Width of the figure.
    """
    rows: Any = found.rows
    start_s, x_label = _time_axis(rows["t_s"])
    x = rows["t_s"] - start_s
    if over == "depth":
        x = 1e3 * (rows["depth_m"] - found.zero.depth_m)
        x_label = f"depth {found.zero.name} [mm]"
    # Estimates before the first row that was used are not drawn.
    known = rows.where(rows["used"].cumsum() > 0)
    forces: Mapping[str, Line] = {
        "axial force, as recorded": {
            "y": rows["force_N"],
            "color": palette.GREEN,
            "lw": 2.6,
            "alpha": 0.45,
        },
        "predicted": {
            "y": known["predicted_force_N"],
            "color": palette.ORANGE,
            "ls": "--",
            "is_beside": True,
        },
        "tip force": {"y": known["tip_force_N"], "color": palette.PURPLE, "ls": "-."},
        "enhanced force": {"y": known["enhanced_force_N"], "color": palette.BLUE},
    }
    panels = {palette.FORCE: [{**line, "label": name} for name, line in forces.items()]}
    friction = palette.FRICTION
    if found.method.endswith("kv"):
        friction = "friction B\n[Ns/m]"
    for label, name in (
        (palette.STIFFNESS, "stiffness_N_per_m"),
        (friction, "friction_Ns_per_m2"),
        (palette.CUMULATIVE_FRICTION, "cumulative_friction_Ns_per_m"),
    ):
        std = known[name.replace("_N", "_std_N", 1)]
        panels[label] = [{"y": known[name], "std": std, "color": palette.BLUE}]
    figure = _draw_panels(panels, x, title, x_label, width_in)
    events = {
        "estimated rupture time": [each.rupture.time_s for each in found.layers],
        "friction identified": rows.loc[rows["identified_layer"] > 0, "t_s"],
        "hard contact": rows.loc[rows["hard_contact"] > 0, "t_s"],
    }
    for (label, times_s), marker in zip(events.items(), "|.x", strict=True):
        for axes in figure.axes if len(times_s) and over == "time" else ():
            places = np.subtract(times_s, start_s)
            plots.mark_instants(axes, places, label, color="black", marker=marker)
    plots.add_legend(figure, 2 if width_in < plots.WIDE_IN else 4)
    return figure


def _draw_panels(
    panels: Mapping[str, Sequence[Line]],
    x: pd.Series,
    title: str,
    x_label: str,
    width_in: float,
) -> "Figure":
    """Return a figure with panels below each other, by their labels."""
    height_in = 1.8 + 1.3 * len(panels)
    lines_of_title = "\n".join(wrap(printable(title), int(10.0 * width_in)))
    figure, grid = plots.make_panels(len(panels), width_in, height_in, lines_of_title)
    for axes, (label, lines) in zip(grid, panels.items(), strict=True):
        axes.set(ylabel=label, ylim=_scale_of(lines))
        for line in lines:
            style = {key: line[key] for key in line.keys() - {"y", "std", "is_beside"}}
            if line["y"].notna().any():
                places = x.to_numpy()
                plots.draw_line(axes, places, line["y"], line.get("std"), **style)
    grid[-1].set(xlabel=x_label)
    return figure


def _scale_of(lines: Sequence[Line]) -> tuple[float, float] | None:
    """Return the limits of the y axis that show the lines; None without any value."""
    shown = pd.concat([line["y"] for line in lines if not line.get("is_beside")])
    if not shown.notna().any():
        return None
    low = min(0.0, float(shown.min()))
    high = max(0.0, float(shown.max()))
    margin = 0.1 * (high - low) or 1.0
    return low - margin, high + margin


def _time_axis(t_s: pd.Series) -> tuple[float, str]:
    """Return the time that is zero in a figure of stamps, and the label."""
    late_clock_s = 1e5  # beyond it an axis has no digits for what happened
    if abs(t_s.iloc[0]) > late_clock_s:
        return float(t_s.iloc[0]), "time since the first sample [s]"
    return 0.0, "time of the log [s]"
