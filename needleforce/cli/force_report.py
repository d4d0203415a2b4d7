"""The report: charts, summary, warnings and settings of a log in one page."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from needleforce.cli.force_replay import ForceResult, ForceRows, ForceStatistics, Replay, TareDone
from needleforce.plots import (
    Chart,
    Curve,
    Instants,
    LineStyle,
    Page,
    PageFigure,
    PageTable,
    Panel,
    Section,
    Shading,
    palette,
    save_figure,
    save_page_figure,
    settings_table,
    write_page,
)
from needleforce.plots.chart import WIDTH_IN
from needleforce.plots.page import PAGE
from recordings.columns.force_codes import FORCE_STATUS
from recordings.command.log_session import LogSession
from recordings.tables.labels import Labels
from residual.config import SensorConfig
from residual.estimate import Status
from urdf import Robot

# One component of the chart: which rows it has, and how much room it needs.


class Component(NamedTuple):
    """A component to draw.

    Attributes:
        name: For the legend.
        style: Of the line.
        value: One per row of the log, shape (n,).
        std: Its standard deviation, shape (n,).
    """

    name: str
    style: LineStyle
    value: NDArray[np.float64]
    std: NDArray[np.float64]


class ComponentRows(NamedTuple):
    """A component without skipped rows, interrupted by NaN at gaps in time; all of shape (m,)."""

    t_s: NDArray[np.float64]
    value: NDArray[np.float64]
    std: NDArray[np.float64]
    is_tared: NDArray[np.bool_]


def broken_at_gaps(component: Component, rows: ForceRows) -> ComponentRows:
    """Return what is drawn: a skipped row leaves no hole, a gap in time does."""
    kept = ~rows.has_status(Status.REJECTED)
    t_s = rows.t_s[kept]
    gaps = np.flatnonzero(rows.after_gap[kept])
    return ComponentRows(
        t_s=np.insert(t_s, gaps, t_s[gaps]),
        value=np.insert(component.value[kept], gaps, np.nan),
        std=np.insert(component.std[kept], gaps, np.nan),
        is_tared=np.insert(rows.has_status(Status.OK)[kept], gaps, False),
    )


def component_curves(component: Component, rows: ForceRows, start_s: float) -> list[Curve]:
    """Return the tared part with its band, and the part that was not tared.

    Before a tare the band is the prior's, wider than any chart: the line alone tells more.

    Args:
        component: What to draw.
        rows: The estimates.
        start_s: Log time that is zero in the chart [s].
    """
    drawn = broken_at_gaps(component, rows)
    time_s, tared = drawn.t_s - start_s, drawn.is_tared
    untared = Curve(
        style=replace(palette.UNTARED, color=component.style.color)
        if not tared.any()
        else palette.UNTARED,
        x=time_s,
        y=np.where(tared, np.nan, drawn.value),
        label="not tared" if tared.any() else f"{component.name}, not tared",
    )
    if not tared.any():
        return [untared]
    told = Curve(
        style=component.style,
        x=time_s,
        y=np.where(tared, drawn.value, np.nan),
        label=component.name,
        std=np.where(tared, drawn.std, np.nan),
        band_label=f"{component.name}, ± 2 std",
    )
    return [told] if tared.all() else [untared, told]


def limits(components: list[Component], rows: ForceRows) -> tuple[float, float]:
    """Return lower and upper limit of a panel.

    Room is made for tared rows with their bands, and for zero; what was not tared may leave the
    chart, unless there is nothing else.
    """
    shown, width = rows.has_status(Status.OK), 2.0
    if not shown.any():
        shown, width = rows.has_status(Status.NOT_TARED), 0.0
    edges = [c.value[shown] + sign * c.std[shown] for c in components for sign in (-width, width)]
    finite = np.concatenate([[0.0], *edges])
    finite = finite[np.isfinite(finite)]
    low, high = float(finite.min()), float(finite.max())
    margin = 0.06 * (high - low) or 1.0
    return low - margin, high + margin


# What a reader of the chart must know about each stretch: tare, settling, skipped rows.


def shadings(rows: ForceRows, tare: TareDone | None, start_s: float) -> tuple[Shading, ...]:
    """Return the stretches of the tare and of settling filters.

    Args:
        rows: The estimates.
        tare: The tare, if one was taken.
        start_s: Log time that is zero in the chart [s].
    """
    found = []
    if tare is not None:
        span = (tare.window.start_s - start_s, tare.window.end_s - start_s)
        found.append(Shading(label="tare", color=palette.TARE, spans=(span,)))
    time_s = rows.t_s - start_s
    settling = tuple(
        (float(time_s[first]), float(time_s[last]))
        for first, last in runs(rows.has_status(Status.INITIALIZING))
    )
    if settling:
        found.append(Shading(label="filters settle", color=palette.INITIALIZING, spans=settling))
    return tuple(found)


def skipped_ticks(rows: ForceRows, start_s: float) -> tuple[Instants, ...]:
    """Return strokes at rows that were skipped."""
    places = (rows.t_s - start_s)[rows.has_status(Status.REJECTED)]
    if not len(places):
        return ()
    return (Instants(label="skipped", style=palette.REJECTED, places=tuple(places.tolist())),)


def runs(flags: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return first and last index of every unbroken run of True."""
    edges = np.diff(np.concatenate(([0], flags.astype(np.int8), [0])))
    starts, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
    return list(zip(starts.tolist(), ends.tolist(), strict=True))


# The chart: axial force with its 2-sigma band over time, the other components below.


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
        instants=skipped_ticks(rows, start_s),
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


# The table a user reads at the end: what was used, what was done, what came out.


Rows = list[tuple[str, str]]


def summary_rows(result: ForceResult) -> Rows:
    """Return label and text of every line of the summary."""
    replay, forces = result.replay, result.statistics
    own_lag = "that of the robot's own estimate"
    return [
        ("robot", _robot(result.robot)),
        ("sensor", result.sensor_line),
        ("samples", _samples(forces)),
        ("skipped", _skipped(replay)),
        ("gaps", _gaps(replay, result.config)),
        ("warnings", _cautions(forces)),
        *([("velocity", replay.velocity_fault)] if replay.velocity_fault else []),
        ("tare", _tare(replay)),
        ("axial force", _force(forces)),
        ("lag", own_lag if result.is_external else f"{1e3 * replay.lag_s:.1f} ms"),
    ]


def format_rows(rows: Rows) -> str:
    """Return the lines with their texts below each other."""
    width = max(len(label) for label, _ in rows)
    return "".join(f"{label:<{width}}  {text}\n" for label, text in rows)


def _robot(robot: Robot) -> str:
    mass_kg = robot.payload.mass_kg if robot.payload is not None else 0.0
    return f"{robot.model.name}, {robot.nv} joints, payload {mass_kg:.3g} kg"


def _samples(forces: ForceStatistics) -> str:
    duration_s = forces.last_s - forces.first_s
    counts = [f"{forces[status].count} {status.value}" for status in Status if forces[status].count]
    rate_hz = 1.0 / forces.step_s
    return f"{forces.rows} in {duration_s:.4g} s at {rate_hz:.4g} Hz: {', '.join(counts)}"


def _skipped(replay: Replay) -> str:
    if not replay.skipped:
        return "none"
    reasons = "; ".join(f"{count} x {reason}" for reason, count in replay.skipped.most_common(4))
    more = len(replay.skipped) - 4
    return f"{replay.skipped.total()}: {reasons}" + (f"; {more} other reasons" if more > 0 else "")


def _gaps(replay: Replay, config: SensorConfig) -> str:
    if not replay.gaps:
        return f"none longer than {config.max_gap_s:g} s"
    return (
        f"{replay.gaps} longer than {config.max_gap_s:g} s (longest "
        f"{replay.longest_gap_s:.3g} s), after which the filters started anew"
    )


def _cautions(forces: ForceStatistics) -> str:
    told = [
        f"{count} x {str(caution.name).lower().replace('_', ' ')}"
        for caution, count in forces.warnings.most_common()
        if count
    ]
    return ", ".join(told) or "none"


def _tare(replay: Replay) -> str:
    done = replay.tare
    if done is None:
        return "none: forces carry the errors of the model and of the torque sensors"
    return (
        f"{done.window} of the log, kind {done.tare.basis.kind!r}, "
        f"offsets up to {done.largest_offset_Nm:.2g} Nm"
    )


def _force(forces: ForceStatistics) -> str:
    shown, note = forces[Status.OK], ""
    if not shown.count:
        shown, note = forces[Status.NOT_TARED], ", not tared"
    if not shown.count:
        return "none: no sample was sound and settled"
    return (
        f"{shown.least_N:.3f} to {shown.largest_N:.3f} N, standard deviation {shown.std_N:.3f} N "
        f"(median){note}"
    )


def write_report(folder: Path, result: ForceResult, warnings: Sequence[str]) -> Path:
    """Write ``index.html``, which needs no other file, and beside it the charts.

    Args:
        folder: Exists.
        result: The estimates.
        warnings: What was told about the log.

    Returns:
        The page.

    Raises:
        figures.FiguresError: A file cannot be written.
    """
    page = Page(
        title=f"Forces from {result.log}",
        lead=(f"Made by `python -m residual`: {result.sensor_line}.",),
        sections=(
            Section(
                heading="Forces",
                anchor="forces",
                notices=tuple(f"Warning: {text}" for text in warnings),
                figures=tuple(_figures(folder, result)),
            ),
            Section(heading="Summary", anchor="summary", tables=(_summary(result),)),
            Section(
                heading="Settings",
                anchor="settings",
                paragraphs=("As in a file for `--config`; SI units.",),
                tables=(settings_table(result.config, "Sensor"),),
            ),
        ),
    )
    return write_page(folder / PAGE, page)


def _figures(folder: Path, result: ForceResult) -> list[PageFigure]:
    chart = travel_chart(result)
    over_time = save_page_figure(
        force_chart(result),
        folder / "forces.svg",
        is_alone=chart is None,
        alt=f"Estimated forces of {result.log} over time",
        caption="The force of the environment on the tool; the axial force is positive when "
        "tissue pushes back. The band is two standard deviations wide to either side: model "
        "errors, offsets and noise as the tare has learnt them. Grey lines are not tared and "
        "mean little.",
    )
    if chart is None:
        return [over_time]
    over_travel = save_page_figure(
        chart,
        folder / "forces-over-travel.svg",
        alt=f"Axial force of {result.log} over the travel of the tool",
        caption="The same axial force over the travel of the tool along the needle since the "
        "first sample: in tissue the upper branch belongs to the way in, the lower to the way "
        "out.",
    )
    return [over_time, over_travel]


def _summary(result: ForceResult) -> PageTable:
    return PageTable(
        caption="What was used, done and found", head=("", ""), rows=tuple(summary_rows(result))
    )


# The chart as a picture.


_WIDTH_IN = 9.0


def save_picture(path: str | Path, result: ForceResult) -> None:
    """Draw the estimates.

    Args:
        path: File to write, PNG, SVG or PDF.
        result: The estimates.

    Raises:
        figures.FiguresError: The file cannot be written.
    """
    save_figure(force_chart(result, _WIDTH_IN), path)


# The columns of the table of forces; every name carries its unit.


Columns = dict[str, NDArray[np.float64] | NDArray[np.int64]]


def force_table(rows: ForceRows, config: SensorConfig) -> Columns:
    """Return the columns in the order in which they are written.

    Args:
        rows: The estimates.
        config: The sensor's settings, for mode and axes.

    Returns:
        Name to values, each of shape (n,).
    """
    columns: Columns = {
        "t_s": rows.t_s,
        "travel_m": rows.travel_m,
        "axial_N": rows.axial_N,
        "axial_std_N": rows.axial_std_N,
    }
    columns |= _vector_force_table("force", "N", config.axes, rows.force_N)
    if config.mode != "axial":
        columns |= _vector_force_table("force_std", "N", config.axes, rows.std[:, :3])
    if config.mode == "full":
        columns |= _vector_force_table("torque", "Nm", config.axes, rows.torque_Nm)
        columns |= _vector_force_table("torque_std", "Nm", config.axes, rows.std[:, 3:])
    columns |= {
        "model_mismatch": rows.model_mismatch,
        "force_warnings": rows.warnings,
        "force_status": rows.status,
    }
    return columns


def _vector_force_table(name: str, unit: str, axes: str, values: NDArray[np.float64]) -> Columns:
    return {f"{name}_{xyz}_in_{axes}_{unit}": values[:, i] for i, xyz in enumerate("xyz")}


# What a bag of forces says beside the numbers.


def force_labels(log: LogSession, robot: Robot, config: SensorConfig) -> Labels:
    """Return the source's clock, the frame whose axes the forces have, and the words of a status.

    Args:
        log: The log, of which rows have been read.
        robot: The arm.
        config: Names axes and frame.
    """
    tool_frame = config.frame if config.frame is not None else robot.tool_frame
    # Frame 0 is Pinocchio's own "universe"; the first of the URDF is its root link.
    base_frame = robot.frame_names[1]
    return Labels(
        start_ns=log.start_ns,
        frame=base_frame if config.axes == "base" else tool_frame,
        events={"force_status": FORCE_STATUS},
    )
