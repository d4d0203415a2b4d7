"""Figures of forces and layers over time or depth, drawn by matplotlib."""

from collections.abc import Callable, Sequence
from io import BytesIO
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd

from needleforce.cli.logs.layers import LayerReplay
from needleforce.cli.shared_options import Over
from needleforce.cli.terminal import CommandError
from needleforce.plots import palette
from needleforce.plots.drawing import FORMATS, STYLE, printable, write_file
from needleforce.sensor_replay import STATUS_CODES, SensorReplay
from residual import Status

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH_IN = 4.4
"""Width of a figure whose letters can be read at the width of a phone."""

WIDE_IN = 8.4
"""Width of a figure for wide screens and print."""

Draw = Callable[[float], "Figure"]
"""Draws a figure of a width [in]."""


class Line(NamedTuple):
    """A line of a panel.

    Attributes:
        label: Its name in the legend; empty for none.
        y: Its values, NaN where nothing is drawn.
        style: How matplotlib draws it.
        std: Its standard deviations: a band of two to either side is shaded.
        is_scale: Whether the scale of the panel shows all of it.
    """

    label: str
    y: pd.Series
    style: dict[str, Any]
    std: pd.Series | None = None
    is_scale: bool = True


def save(draw: Draw, path: Path, width_in: float = WIDTH_IN) -> Path:
    """Draw a figure and write it whole, as PNG, SVG or PDF by the ending of its name.

    Returns:
        The path.
    """
    from matplotlib import rc_context

    suffix = path.suffix.lower()
    content = BytesIO()
    with rc_context(fname=STYLE):
        draw(width_in).savefig(content, format=suffix[1:], **FORMATS[suffix])
    return write_file(path, content.getvalue())


def draw_forces(
    replay: SensorReplay, title: str, over: Over, limits: tuple[float, float]
) -> Draw:
    """Return what draws the force along the needle, and the vectors of the mode.

    What was not tared is grey. A rejected row leaves no hole, a gap in time does.

    Args:
        replay: The forces.
        title: Title of the figure.
        over: Time, or travel of the tool.
        limits: Of the x axis, infinite where they are not given.
    """
    all_rows: Any = replay.rows
    start_s, x_label = _time_axis(all_rows["t_s"])
    x = all_rows["t_s"] - start_s
    if over == "depth":
        x = 1e3 * all_rows["travel_m"]
        x_label = "travel from the first row [mm]"
    x_limits = _limits_of(x, limits, x_label)
    is_valid = all_rows["force_status"] != STATUS_CODES[Status.REJECTED]
    rows = all_rows[is_valid]
    is_tared = rows["force_status"] == STATUS_CODES[Status.OK]
    grey = {"color": palette.GREY} if is_tared.any() else {}
    axes_name = replay.config.axes

    def lines_of(name: str, value: str, std: str, style: dict[str, Any]) -> list[Line]:
        y = rows[value].where(~rows["after_gap"])
        untared = Line("not tared", y.where(~is_tared), style | grey, is_scale=not grey)
        return [untared, Line(name, y.where(is_tared), style, rows[std])]

    blue = {"color": palette.BLUE}
    panels = {palette.FORCE: lines_of("axial force", "axial_N", "axial_std_N", blue)}
    components = (
        ("x", {"color": palette.VERMILION}),
        ("y", {"color": palette.GREEN, "ls": "--"}),
        ("z", {"color": palette.PURPLE, "ls": "-."}),
    )
    for vector, unit in (("force", "N"), ("torque", "Nm")):
        end = f"_in_{axes_name}_{unit}"
        if f"{vector}_std_x{end}" in rows:
            panels[f"{vector},\n{axes_name} axes [{unit}]"] = [
                line
                for axis, style in components
                for line in lines_of(
                    f"{vector} {axis}",
                    f"{vector}_{axis}{end}",
                    f"{vector}_std_{axis}{end}",
                    style,
                )
            ]

    def mark(axes: "Axes") -> None:
        if replay.window is not None and over == "time":
            start, end = np.subtract(replay.window, start_s)
            axes.axvspan(start, end, color=palette.TARE, label="tare")

    return _drawing(panels, x[is_valid], title, x_label, x_limits, mark)


def draw_layers(
    found: LayerReplay, title: str, over: Over, limits: tuple[float, float]
) -> Draw:
    """Return what draws forces above, parameters below, as in Figure 8 of Ferro et al.

    Args:
        found: The layers.
        title: Title of the figure.
        over: Time, or depth of the needle.
        limits: Of the x axis, infinite where they are not given.
    """
    rows: Any = found.rows
    start_s, x_label = _time_axis(rows["t_s"])
    x = rows["t_s"] - start_s
    if over == "depth":
        x = 1e3 * (rows["depth_m"] - found.zero.depth_m)
        x_label = f"depth {found.zero.name} [mm]"
    x_limits = _limits_of(x, limits, x_label)
    # Estimates before the first row that was used are not drawn.
    known = rows.where(rows["used"].cumsum() > 0)
    green = {"color": palette.GREEN, "lw": 2.6, "alpha": 0.45}
    blue = {"color": palette.BLUE}
    purple = {"color": palette.PURPLE, "ls": "-."}
    predicted = {"color": palette.ORANGE, "ls": "--"}
    panels = {
        palette.FORCE: [
            Line("axial force, as recorded", rows["force_N"], green),
            Line("predicted", known["predicted_force_N"], predicted, is_scale=False),
            Line("tip force", known["tip_force_N"], purple),
            Line("enhanced force", known["enhanced_force_N"], blue),
        ]
    }
    friction = palette.FRICTION
    if found.method.endswith("kv"):
        friction = "friction B\n[Ns/m]"
    for label, name in (
        (palette.STIFFNESS, "stiffness_N_per_m"),
        (friction, "friction_Ns_per_m2"),
        (palette.CUMULATIVE_FRICTION, "cumulative_friction_Ns_per_m"),
    ):
        std = known[name.replace("_N", "_std_N", 1)]
        panels[label] = [Line("", known[name], blue, std)]
    events = {
        "estimated rupture time": [each.rupture.time_s for each in found.layers],
        "friction identified": rows.loc[rows["identified_layer"] > 0, "t_s"],
        "hard contact": rows.loc[rows["hard_contact"] > 0, "t_s"],
    }
    markers: tuple[dict[str, Any], ...] = (
        {"marker": "|", "ms": 13.0},
        {"marker": "."},
        {"marker": "x"},
    )

    def mark(axes: "Axes") -> None:
        for (label, times_s), style in zip(events.items(), markers, strict=True):
            if len(times_s) and over == "time":
                place = np.subtract(times_s, start_s)
                bottom = np.zeros(len(place))
                transform = axes.get_xaxis_transform()
                style: dict[str, Any] = {"color": "black", "ls": "none"} | style
                axes.plot(place, bottom, label=label, transform=transform, **style)

    return _drawing(panels, x, title, x_label, x_limits, mark)


def _drawing(
    panels: dict[str, list[Line]],
    x: pd.Series,
    title: str,
    x_label: str,
    x_limits: tuple[float, float],
    mark: Callable[["Axes"], None],
) -> Draw:
    """Return what draws panels below each other, by their labels, with one legend."""

    def draw(width_in: float) -> "Figure":
        from matplotlib.figure import Figure

        size_in = (width_in, 1.8 + 1.3 * len(panels))
        figure = Figure(size_in, layout="constrained", facecolor="white")
        grid = figure.subplots(len(panels), sharex=True, squeeze=False)[:, 0]
        handles: dict[str, Any] = {}
        for axes, (label, lines) in zip(grid, panels.items(), strict=True):
            axes.axhline(0.0, color="#555555", lw=0.6)
            axes.set(ylabel=label, ylim=_scale_of(lines))
            mark(axes)
            for line in lines:
                _draw_line(axes, x, line)
            pairs = zip(*axes.get_legend_handles_labels(), strict=True)
            handles |= {name: handle for handle, name in pairs}
        grid[-1].set(xlabel=x_label, xlim=x_limits)
        text = "\n".join(wrap(printable(title), int(10.0 * width_in)))
        figure.suptitle(text, x=0.01, ha="left", fontweight="bold")
        columns = 2 if width_in < WIDE_IN else 4
        place = "outside lower left"
        figure.legend(handles.values(), handles, loc=place, ncols=columns)
        return figure

    return draw


def _draw_line(axes: "Axes", x: pd.Series, line: Line) -> None:
    """Draw a line, and its band below it."""
    area_points = 2000  # matplotlib thins lines, not areas
    if not line.y.notna().any():
        return
    axes.plot(x, line.y, label=line.label or None, **line.style)
    if line.std is not None:
        step = len(x) // area_points + 1
        low = (line.y - 2.0 * line.std)[::step]
        high = (line.y + 2.0 * line.std)[::step]
        color = line.style["color"]
        axes.fill_between(x[::step], low, high, color=color, alpha=0.2, lw=0)


def _scale_of(lines: Sequence[Line]) -> tuple[float, float] | None:
    """Return the limits of the y axis that show the lines; None without any value."""
    shown = [line.y for line in lines if line.is_scale and line.y.notna().any()]
    if not shown:
        return None
    low = min(0.0, *(float(y.min()) for y in shown))
    high = max(0.0, *(float(y.max()) for y in shown))
    margin = 0.1 * (high - low) or 1.0
    return low - margin, high + margin


def _time_axis(t_s: pd.Series) -> tuple[float, str]:
    """Return the time that is zero in a figure of stamps, and the label."""
    late_clock_s = 1e5  # beyond it an axis has no digits for what happened
    if abs(t_s.iloc[0]) > late_clock_s:
        return float(t_s.iloc[0]), "time since the first sample [s]"
    return 0.0, "time of the log [s]"


def _limits_of(
    x: pd.Series, limits: tuple[float, float], x_label: str
) -> tuple[float, float]:
    """Return what ``--from`` and ``--to`` leave of an axis; refuse to draw nothing."""
    finite = x[np.isfinite(x)]
    low = float(finite.min()) if len(finite) else 0.0
    high = float(finite.max()) if len(finite) else 1.0
    start = max(low, limits[0])
    end = min(high, limits[1])
    if np.isfinite(limits).any() and not start < end:
        raise CommandError(
            f"no figure from {limits[0]:g} to {limits[1]:g}: its axis, {x_label}, runs "
            f"from {low:g} to {high:g}; expected --from and --to within that"
        )
    return start, end
