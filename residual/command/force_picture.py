"""The picture: axial force with its 2-sigma band over time, the other components below."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from residual.command.curves import Curve, broken_at_gaps, limits
from residual.command.errors import CommandError
from residual.command.force_result import ForceResult
from residual.command.force_rows import ForceRows
from residual.command.status_marks import MARKS, draw_status_marks
from residual.sensor_config import SensorConfig

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_AXIAL, _XYZ, _GREY = "#1f5fa8", ("#c8553d", "#3b8f5a", "#5b5ea6"), "#8c8c8c"
_BAND: dict[str, Any] = {"alpha": 0.22, "linewidth": 0}
_LINE: dict[str, Any] = {"linewidth": 1.2}
_TEXT: dict[str, Any] = {"frameon": False, "fontsize": 9}
_LATE_CLOCK_S = 1e5


def check_picture(path: str | Path) -> None:
    """Find out before the work what `save_picture` would refuse after it.

    Args:
        path: PNG file to write.

    Raises:
        CommandError: There is no such folder, or matplotlib is not installed.
    """
    folder = Path(path).parent
    if not folder.is_dir():
        raise CommandError(f"cannot write {path}: there is no folder {folder}")
    try:
        import matplotlib.figure  # noqa: F401
    except ImportError as error:
        raise CommandError(
            "--png needs matplotlib, which is not installed; "
            "install it with: pip install 'needleforce[plots]'"
        ) from error


def save_picture(path: str | Path, result: ForceResult) -> None:
    """Draw the estimates.

    Args:
        path: PNG file to write.
        result: The estimates.

    Raises:
        CommandError: The file cannot be written.
    """
    try:
        _draw(result).savefig(path, format="png")
    except OSError as error:
        raise CommandError(f"cannot write {path}: {error.strerror or error}") from error


def _draw(result: ForceResult) -> "Figure":
    rows, config = result.overview, result.config
    # Not pyplot: no window and no global state.
    from matplotlib.figure import Figure

    groups = _groups(rows, config)
    figure = Figure(figsize=(11.0, 1.4 + 2.8 * len(groups)), dpi=130, layout="constrained")
    panels = figure.subplots(len(groups), 1, sharex=True, squeeze=False)[:, 0]
    # Seconds since 1970 would leave the axis no digits for what happened.
    is_late = abs(float(rows.t_s[0])) > _LATE_CLOCK_S
    start_s = float(rows.t_s[0]) if is_late else 0.0
    for panel, (label, curves) in zip(panels, groups.items(), strict=True):
        draw_status_marks(panel, rows, result.replay.tare, start_s)
        _draw_curves(panel, curves, rows, start_s)
        panel.set_ylabel(label)
        panel.grid(color="0.9", linewidth=0.7)
        panel.set_axisbelow(True)
        panel.spines[["top", "right"]].set_visible(False)
        _legend(panel, has_marks=panel is panels[0])
    panels[0].set_title(f"{result.log}: {result.sensor_line}", loc="left", fontsize=11)
    panels[-1].set_xlabel("time since the first sample [s]" if is_late else "time of the log [s]")
    panels[-1].set_xlim(rows.t_s.min() - start_s, rows.t_s.max() - start_s)
    return figure


def _groups(rows: ForceRows, config: SensorConfig) -> dict[str, list[Curve]]:
    axial = Curve("axial force", _AXIAL, rows.axial_N, rows.axial_std_N)
    groups = {"axial force [N]": [axial]}
    if config.mode != "axial":
        label = f"force, {config.axes} axes [N]"
        groups[label] = _vector(rows.force_N, rows.std[:, :3])
    if config.mode == "full":
        label = f"torque, {config.axes} axes [Nm]"
        groups[label] = _vector(rows.torque_Nm, rows.std[:, 3:])
    return groups


def _vector(values: NDArray[np.float64], std: NDArray[np.float64]) -> list[Curve]:
    return [Curve(name, _XYZ[i], values[:, i], std[:, i]) for i, name in enumerate("xyz")]


def _draw_curves(panel: "Axes", curves: list[Curve], rows: ForceRows, start_s: float) -> None:
    panel.axhline(0.0, color="0.35", linewidth=0.7)
    for curve in curves:
        drawn = broken_at_gaps(curve, rows)
        time_s, value, tared = drawn.t_s - start_s, drawn.value, drawn.is_tared
        if tared.any():
            low, high = value - 2.0 * drawn.std, value + 2.0 * drawn.std
            panel.fill_between(time_s, low, high, where=tared, color=curve.color, **_BAND)
            panel.plot(
                time_s, np.where(tared, value, np.nan), label=curve.name, color=curve.color, **_LINE
            )
        # Before a tare the band is the prior's, wider than any picture: the line alone tells more.
        name, color = (None, _GREY) if tared.any() else (f"{curve.name}, not tared", curve.color)
        panel.plot(time_s, np.where(tared, np.nan, value), label=name, color=color, **_LINE)
    panel.set_ylim(*limits(curves, rows))


def _legend(panel: "Axes", has_marks: bool) -> None:
    """Explain the lines, and the marks they share in the first panel only."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles, labels = panel.get_legend_handles_labels()
    shown = [
        (handle, label)
        for handle, label in zip(handles, labels, strict=True)
        if has_marks or label not in MARKS
    ]
    if has_marks and panel.collections:
        shown.append((Patch(color=_AXIAL, **_BAND), "± 2 standard deviations"))
        shown.append((Line2D([], [], color=_GREY), "not tared"))
    panel.legend(*zip(*shown, strict=True), loc="upper left", bbox_to_anchor=(1.0, 1.02), **_TEXT)
