"""`needleforce force`: forces from joint signals, as table, summary, figure and page."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from needleforce.cli.force_replay import ForceRows, Replay
from needleforce.cli.log import (
    STANDARD_STREAM,
    ChannelRequest,
    LogSession,
    RowOverview,
    check_outputs,
    in_window,
    mapping_from_options,
    open_output,
    suggest_mapping,
)
from needleforce.cli.options import (
    JointColumns,
    Output,
    Reading,
    RobotOptions,
    SensorOptions,
    TareOptions,
)
from needleforce.cli.robot import (
    payload_from_options,
    payload_lines,
    robot_from_options,
    sensor_config,
    with_friction,
)
from needleforce.cli.terminal import CommandError, write_out
from needleforce.plots import (
    Chart,
    Curve,
    Instants,
    LineStyle,
    Page,
    PageTable,
    Panel,
    Section,
    Shading,
    folder_if_filled,
    palette,
    require_matplotlib,
    save_figure,
    save_page_figure,
    settings_table,
    write_page,
)
from needleforce.plots.chart import limits_of
from recordings.columns.force_codes import FORCE_STATUS
from recordings.tables.labels import Labels
from residual import SensorConfig, SensorWarning, Status
from urdf import Robot


def run(
    source: str,
    reading: Reading,
    output: Output,
    robot_options: RobotOptions,
    sensor: SensorOptions,
    tare: TareOptions,
    columns: JointColumns,
) -> int:
    """Run the command and return its exit code.

    Raises:
        CommandError: Options contradict each other, or the log does not fit the robot.
        Exception: The foreseen errors of the packages, see `needleforce.cli.terminal`.
    """
    robot, known = robot_from_options(robot_options, columns.mapping), mapping_from_options(columns)
    channels = ("q", "tau_ext" if sensor.external_torque else "tau", "dq")
    if columns.print_config:
        payload = payload_lines(payload_from_options(robot_options, columns.mapping))
        joints = robot.joint_names
        write_out(suggest_mapping(source, channels, known=known, joints=joints, payload=payload))
        return 0
    if tare.tare is not None and tare.no_tare:
        raise CommandError("--tare and --no-tare contradict each other; give one of them")
    check_outputs(source, output)
    if output.figure is not None:
        require_matplotlib("--figure", output.figure)
    robot, friction = with_friction(robot, sensor.friction)
    config = sensor_config(sensor, friction)
    request = ChannelRequest(
        mapping=known, required=channels[:2], optional=channels[2:], joints=robot.joint_names
    )
    with folder_if_filled(output.report) as folder, LogSession(source, reading, request) as log:
        is_external = sensor.external_torque
        result = estimate_forces(log, robot, config, tare, output, is_external=is_external)
        if output.figure is not None:
            save_figure(force_figure(result, output), output.figure)
        if folder is not None:
            write_force_page(folder, result, log.warnings)
    write_out(format_rows(summary_rows(result)), to_stderr=output.output == STANDARD_STREAM)
    return log.exit_code


# Numbers about all rows of a log of any length, in memory that does not grow.

_MOST_VALUES = 8192


class ThinnedMedian:
    """Exact for few values; of many, the median of every second, fourth, eighth, ..."""

    def __init__(self) -> None:
        self._kept = np.empty(0)
        self._stride, self._seen = 1, 0

    def add(self, values: NDArray[np.float64]) -> None:
        """Take further values, shape (n,)."""
        first = -self._seen % self._stride
        self._kept = np.concatenate((self._kept, values[first :: self._stride]))
        self._seen += len(values)
        while len(self._kept) > _MOST_VALUES:
            self._kept = self._kept[::2]
            self._stride *= 2

    @property
    def value(self) -> float:
        """The median; nan of nothing."""
        return float(np.median(self._kept)) if len(self._kept) else math.nan


class ForceStatistics:
    """Counts rows and remembers ranges."""

    def __init__(self) -> None:
        self.first_s, self.last_s = math.inf, -math.inf
        self.steps_s = ThinnedMedian()
        """Of time steps that advance."""
        self.counts: Counter[Status] = Counter()
        self.warnings: Counter[SensorWarning] = Counter()
        self.ranges_N: dict[Status, tuple[float, float]] = {}
        """Least and largest axial force of the rows of a status."""
        self.std_N = {status: ThinnedMedian() for status in Status}

    def add(self, rows: ForceRows) -> None:
        """Take further rows."""
        latest_s = np.maximum.accumulate(np.concatenate(([self.last_s], rows.t_s)))
        steps = np.diff(latest_s)
        self.steps_s.add(steps[(steps > 0.0) & np.isfinite(steps)])
        self.first_s = min(self.first_s, float(rows.t_s.min()))
        self.last_s = float(latest_s[-1])
        for warning in SensorWarning:
            self.warnings[warning] += int(np.count_nonzero(rows.warnings & warning))
        for status in Status:
            chosen = rows.has_status(status)
            if not chosen.any():
                continue
            self.counts[status] += int(np.count_nonzero(chosen))
            axial_N = rows.axial_N[chosen]
            least, largest = self.ranges_N.get(status, (math.inf, -math.inf))
            least, largest = min(least, float(axial_N.min())), max(largest, float(axial_N.max()))
            self.ranges_N[status] = (least, largest)
            self.std_N[status].add(rows.axial_std_N[chosen])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ForceResult:
    """The outcome of a whole log, of bounded size however long the log.

    Attributes:
        log: What the log is called.
        robot: The arm with its payload.
        config: Settings of the sensor.
        sensor_line: What was estimated from what.
        replay: The sensor after the log: tare, lag, rejected rows, gaps.
        statistics: Numbers about all rows.
        overview: As many rows as a figure needs; all rows of a short log, of a long one those in
            which a force is least or largest for a while.
    """

    log: str
    robot: Robot
    config: SensorConfig
    sensor_line: str
    replay: Replay
    statistics: ForceStatistics
    overview: ForceRows


def estimate_forces(
    log: LogSession,
    robot: Robot,
    config: SensorConfig,
    tare: TareOptions,
    output: Output,
    *,
    is_external: bool,
) -> ForceResult:
    """Run the sensor over a log, entered, and write its forces.

    Raises:
        CommandError: The log does not fit the robot, or the tare is refused.
        RecordingError: The log cannot be read, or the table not written.
    """
    replay = Replay(robot, config, tare, is_external=is_external)
    statistics, overview = ForceStatistics(), RowOverview(_tracked(config))
    has_velocity = False
    with open_output(output, log, lambda: _labels(log, robot, config)) as table:
        for chunk in log:
            has_velocity = "dq_rad_s" in chunk.channels
            rows = replay.run(chunk)
            statistics.add(rows)
            is_initializing = rows.has_status(Status.INITIALIZING)
            overview.add(rows.columns() | {_INITIALIZING: is_initializing})
            if table is not None:
                table.append(force_table(rows, config))
        replay.finish(is_whole=not log.is_interrupted)
    columns = overview.columns()
    del columns[_INITIALIZING]
    return ForceResult(
        log=log.name,
        robot=robot,
        config=config,
        sensor_line=_sensor_line(robot, config, is_external, has_velocity),
        replay=replay,
        statistics=statistics,
        overview=ForceRows(**columns),
    )


_INITIALIZING = "initializing"


def _tracked(config: SensorConfig) -> list[str]:
    """Return the columns of which a figure must not lose the extremes."""
    tracked = ["axial_N", "axial_std_N", "status", "after_gap", _INITIALIZING]
    if config.mode != "axial":
        tracked += ["force_N", "std"]
    return tracked + ["torque_Nm"] * (config.mode == "full")


def _labels(log: LogSession, robot: Robot, config: SensorConfig) -> Labels:
    """Return what a bag of forces says beside the numbers."""
    tool_frame = config.frame if config.frame is not None else robot.tool_frame
    # Frame 0 is Pinocchio's own "universe"; the first of the URDF is its root link.
    base_frame = robot.frame_names[1]
    return Labels(
        start_ns=log.start_ns,
        frame=base_frame if config.axes == "base" else tool_frame,
        events={"force_status": FORCE_STATUS},
    )


def force_table(rows: ForceRows, config: SensorConfig) -> dict[str, NDArray]:
    """Return the columns in the order in which they are written; names carry the unit."""
    columns: dict[str, NDArray] = {
        "t_s": rows.t_s,
        "travel_m": rows.travel_m,
        "axial_N": rows.axial_N,
        "axial_std_N": rows.axial_std_N,
    }
    vectors = [("force", "N", rows.force_N)]
    if config.mode != "axial":
        vectors.append(("force_std", "N", rows.std[:, :3]))
    if config.mode == "full":
        vectors += [("torque", "Nm", rows.torque_Nm), ("torque_std", "Nm", rows.std[:, 3:])]
    for name, unit, values in vectors:
        for i, xyz in enumerate("xyz"):
            columns[f"{name}_{xyz}_in_{config.axes}_{unit}"] = values[:, i]
    return columns | {
        "model_mismatch": rows.model_mismatch,
        "force_warnings": rows.warnings,
        "force_status": rows.status,
    }


# The summary.


def summary_rows(result: ForceResult) -> list[tuple[str, str]]:
    """Return label and text of every line: what was used, what was done, what came out."""
    replay, found = result.replay, result.statistics
    payload = result.robot.payload
    mass_kg = payload.mass_kg if payload is not None else 0.0
    counts = [f"{count} {status.value}" for status in Status if (count := found.counts[status])]
    warnings = [
        f"{count} x {str(warning.name).lower().replace('_', ' ')}"
        for warning, count in found.warnings.most_common()
        if count
    ]
    is_own = result.sensor_line.endswith(_OWN)
    return [
        ("robot", f"{result.robot.model.name}, {result.robot.nv} joints, payload {mass_kg:.3g} kg"),
        ("sensor", result.sensor_line),
        (
            "samples",
            f"{found.counts.total()} in {found.last_s - found.first_s:.4g} s at "
            f"{1.0 / found.steps_s.value:.4g} Hz: {', '.join(counts)}",
        ),
        ("rejected", _rejected(replay)),
        ("gaps", _gaps(replay, result.config)),
        ("warnings", ", ".join(warnings) or "none"),
        *([("velocity", replay.velocity_fault)] if replay.velocity_fault else []),
        ("tare", _tare(replay)),
        ("axial force", _force(found)),
        ("lag", "that of the robot's own estimate" if is_own else f"{1e3 * replay.lag_s:.1f} ms"),
    ]


def format_rows(rows: Sequence[tuple[str, str]]) -> str:
    """Return the lines with their texts below each other."""
    width = max(len(label) for label, _ in rows)
    return "".join(f"{label:<{width}}  {text}\n" for label, text in rows)


_OWN = "from the robot's own external torque"


def _sensor_line(robot: Robot, config: SensorConfig, is_external: bool, has_velocity: bool) -> str:
    frame = config.frame if config.frame is not None else robot.tool_frame
    where = f"{config.mode} force at {frame}" if config.mode != "full" else f"wrench at {frame}"
    if is_external:
        return f"{where}, {_OWN}"
    velocity = "velocity from the log" if has_velocity else "velocity estimated"
    return f"{where}, K = {config.slowest_gain_per_s:g} 1/s, {velocity}"


def _rejected(replay: Replay) -> str:
    rejected = replay.rejected
    if not rejected:
        return "none"
    reasons = "; ".join(f"{count} x {reason}" for reason, count in rejected.most_common(4))
    more = len(rejected) - 4
    return f"{rejected.total()}: {reasons}" + (f"; {more} other reasons" if more > 0 else "")


def _gaps(replay: Replay, config: SensorConfig) -> str:
    if not replay.gaps:
        return f"none longer than {config.max_gap_s:g} s"
    return (
        f"{replay.gaps} longer than {config.max_gap_s:g} s (longest "
        f"{replay.longest_gap_s:.3g} s), after which the filters restarted"
    )


def _tare(replay: Replay) -> str:
    done = replay.tare
    if done is None or done.tare is None:
        return "none: forces carry the errors of the model and of the torque sensors"
    return (
        f"{done} of the log, kind {done.tare.basis.kind!r}, "
        f"offsets up to {done.largest_offset_Nm:.2g} Nm"
    )


def _force(found: ForceStatistics) -> str:
    status = Status.OK if found.counts[Status.OK] else Status.NOT_TARED
    if not found.counts[status]:
        return "none: no sample was valid after the filters had settled"
    least_N, largest_N = found.ranges_N[status]
    note = "" if status is Status.OK else ", not tared"
    return (
        f"{least_N:.3f} to {largest_N:.3f} N, standard deviation "
        f"{found.std_N[status].value:.3f} N (median){note}"
    )


# Charts.

_PANEL_IN = 2.2
_LATE_CLOCK_S = 1e5
_LEAST_TRAVEL_M = 1e-3
"""A chart over depth has nothing to show where the tool hardly moves."""
TRAVEL = "travel of the tool along the needle [mm]"


def force_figure(result: ForceResult, output: Output) -> Chart:
    """Return the chart that the options ask for.

    Raises:
        CommandError: No row lies in the window.
    """
    rows = ForceRows(**in_window(result.overview.columns(), output))
    result = replace(result, overview=rows)
    return travel_chart(result) if output.over == "depth" else force_chart(result)


def force_chart(result: ForceResult) -> Chart:
    """Return every estimated component over time, with its band of two standard deviations."""
    rows, config = result.overview, result.config
    # Seconds since 1970 would leave the axis no digits for what happened.
    is_late = abs(float(rows.t_s[0])) > _LATE_CLOCK_S
    start_s = float(rows.t_s[0]) if is_late else 0.0
    axial = [("axial force", palette.OURS, rows.axial_N, rows.axial_std_N)]
    groups = {palette.FORCE: axial}
    if config.mode != "axial":
        label = f"force,\n{config.axes} axes [N]"
        groups[label] = _components("force", rows.force_N, rows.std[:, :3])
    if config.mode == "full":
        label = f"torque,\n{config.axes} axes [Nm]"
        groups[label] = _components("torque", rows.torque_Nm, rows.std[:, 3:])
    time_s = rows.t_s - start_s
    return Chart(
        title=f"Force on the needle\n{result.log}: {result.sensor_line}",
        x_label="time since the first sample [s]" if is_late else "time of the log [s]",
        panels=tuple(_panel(label, rows, time_s, parts) for label, parts in groups.items()),
        shadings=_shadings(result, time_s, start_s),
        instants=(
            Instants(
                label="rejected",
                style=palette.REJECTED,
                places=tuple(time_s[rows.has_status(Status.REJECTED)].tolist()),
            ),
        ),
        x_limits=(float(time_s.min()), float(time_s.max())),
        height_in=0.8 + _PANEL_IN * len(groups),
    )


def travel_chart(result: ForceResult) -> Chart:
    """Return the tared axial force over travel, as in the paper's Figure 5."""
    rows = result.overview
    tared = rows.has_status(Status.OK)
    axial_N = np.where(rows.after_gap, np.nan, rows.axial_N)[tared]
    place_mm = 1e3 * rows.travel_m[tared]
    curve = Curve(style=palette.OURS, x=place_mm, y=axial_N, label="axial force")
    return Chart(
        title=f"Axial force over travel\n{result.log}",
        x_label=TRAVEL,
        panels=(Panel(y_label=palette.FORCE, curves=(curve,)),),
    )


_Component = tuple[str, LineStyle, NDArray[np.float64], NDArray[np.float64]]


def _components(
    what: str, values: NDArray[np.float64], std: NDArray[np.float64]
) -> list[_Component]:
    dashes = (palette.OURS.dash, palette.DASHED, palette.DASH_DOTTED)
    return [
        (f"{what} {name}", replace(palette.UNTARED, color=color, dash=dash), *columns)
        for name, color, dash, *columns in zip(
            "xyz", palette.AXES_XYZ, dashes, values.T, std.T, strict=True
        )
    ]


def _panel(
    label: str, rows: ForceRows, time_s: NDArray[np.float64], components: list[_Component]
) -> Panel:
    """Return the curves; the scale is that of the tared rows, if there are any."""
    curves = [curve for part in components for curve in component_curves(rows, time_s, *part)]
    tared = [curve for curve in curves if curve.std is not None]
    limits = limits_of(tared, None) if tared else None
    return Panel(y_label=label, curves=tuple(curves), limits=limits)


def component_curves(
    rows: ForceRows,
    time_s: NDArray[np.float64],
    name: str,
    style: LineStyle,
    value: NDArray[np.float64],
    std: NDArray[np.float64],
) -> list[Curve]:
    """Return the tared part of a component with its band, and the part that was not tared.

    A rejected row leaves no hole, a gap in time does. Before a tare the band is the prior's, wider
    than any chart: the line alone shows more.
    """
    kept = ~rows.has_status(Status.REJECTED)
    gaps = np.flatnonzero(rows.after_gap[kept])
    x = np.insert(time_s[kept], gaps, time_s[kept][gaps])
    y, std = (np.insert(values[kept], gaps, np.nan) for values in (value, std))
    is_tared = np.insert(rows.has_status(Status.OK)[kept], gaps, False)
    curves = []
    if not is_tared.all():
        label = "not tared" if is_tared.any() else f"{name}, not tared"
        untared = palette.UNTARED
        untared = untared if is_tared.any() else replace(untared, color=style.color)
        curves.append(Curve(style=untared, x=x, y=np.where(is_tared, np.nan, y), label=label))
    if is_tared.any():
        y, std = (np.where(is_tared, values, np.nan) for values in (y, std))
        band = f"{name}, ± 2 std"
        curves.append(Curve(style=style, x=x, y=y, label=name, std=std, band_label=band))
    return curves or [Curve(style=style, x=x, y=y, label=name)]


def _shadings(
    result: ForceResult, time_s: NDArray[np.float64], start_s: float
) -> tuple[Shading, ...]:
    found, tare = [], result.replay.tare
    if tare is not None:
        span = (tare.start_s - start_s, tare.end_s - start_s)
        found.append(Shading(label="tare", color=palette.TARE, spans=(span,)))
    flags = result.overview.has_status(Status.INITIALIZING).astype(np.int8)
    edges = np.diff(np.concatenate(([0], flags, [0])))
    first, last = time_s[np.flatnonzero(edges == 1)], time_s[np.flatnonzero(edges == -1) - 1]
    if len(first):
        spans = tuple(zip(first.tolist(), last.tolist(), strict=True))
        found.append(Shading(label="filters settle", color=palette.INITIALIZING, spans=spans))
    return tuple(found)


# The page.


def write_force_page(folder: Path, result: ForceResult, warnings: Sequence[str]) -> Path:
    """Write ``index.html``, which needs no other file, and beside it the charts.

    Raises:
        FiguresError: A file cannot be written.
    """
    figures = [
        save_page_figure(
            force_chart(result),
            folder / "forces.svg",
            alt=f"Estimated forces of {result.log} over time",
            caption="The force of the environment on the tool; the axial force is positive when "
            "tissue pushes back. The band is two standard deviations wide to either side. Grey "
            "lines are not tared: they carry the errors of the model and of the torque sensors.",
            is_alone=True,
        )
    ]
    tared = result.overview.has_status(Status.OK)
    if tared.any() and np.ptp(result.overview.travel_m[tared]) >= _LEAST_TRAVEL_M:
        over_travel = save_page_figure(
            travel_chart(result),
            folder / "forces-over-travel.svg",
            alt=f"Axial force of {result.log} over the travel of the tool",
            caption="The same axial force over the travel of the tool along the needle since the "
            "first sample: in tissue the upper branch is the insertion, the lower the withdrawal.",
            is_alone=True,
        )
        figures.append(over_travel)
    summary = PageTable(
        caption="What was used, done and found", head=("", ""), rows=tuple(summary_rows(result))
    )
    sections = (
        Section(
            heading="Forces",
            anchor="forces",
            notices=tuple(f"Warning: {text}" for text in warnings),
            figures=tuple(figures),
        ),
        Section(heading="Summary", anchor="summary", tables=(summary,)),
        Section(
            heading="Settings",
            anchor="settings",
            paragraphs=("As in a file for `--config`; SI units.",),
            tables=(settings_table(result.config, "Sensor"),),
        ),
    )
    lead = (f"Made by `needleforce force`: {result.sensor_line}.",)
    page = Page(title=f"Forces from {result.log}", lead=lead, sections=sections)
    return write_page(folder / "index.html", page)
