"""`needleforce force`: forces from joint signals, as table, summary, figure and page."""

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from needleforce.cli.force_replay import Replay, Rows, TareWindow, has_status, tare_ends
from needleforce.cli.log import (
    ChannelRequest,
    LogSession,
    RowOverview,
    in_window,
    mapping_from_options,
    open_output,
    result_page,
    run_log,
    time_axis,
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
    PageFigure,
    PageTable,
    Panel,
    Section,
    Shading,
    palette,
    save_page_figure,
    settings_table,
)
from needleforce.plots.chart import limits_of
from needleforce.recordings.channels import FORCE_STATUS
from needleforce.recordings.open_recording import suggest_mapping
from needleforce.recordings.table import Labels
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
    """Run the command and return its exit code; what it raises is reported in one line."""
    robot, known = robot_from_options(robot_options, columns.mapping), mapping_from_options(columns)
    torque, joints = "tau_ext" if sensor.external_torque else "tau", robot.joint_names
    if columns.print_config:
        payload = payload_lines(payload_from_options(robot_options, columns.mapping))
        channels = ("q", torque, "dq")
        write_out(suggest_mapping(source, channels, mapping=known, joints=joints, payload=payload))
        return 0
    if tare.tare is not None and tare.no_tare:
        raise CommandError("--tare and --no-tare contradict each other; give one of them")
    if tare.tare is not None:
        tare_ends(tare.tare, 0.0)  # before a log is waited for
    robot, friction = with_friction(robot, sensor.friction)
    config = sensor_config(sensor, friction)
    request = ChannelRequest(mapping=known, required=("q", torque), optional=("dq",), joints=joints)

    def estimate(log: LogSession) -> ForceResult:
        replay = Replay(robot, config, tare, is_external=sensor.external_torque)
        return estimate_forces(log, replay, output)

    return run_log(source, reading, request, output, estimate)


# From a log to its result.


def estimate_forces(log: LogSession, replay: Replay, output: Output) -> "ForceResult":
    """Run the sensor over a log and write its forces."""
    config = replay.config
    tracked = ["axial_N", "axial_std_N", "status", "after_gap", _IS_INITIALIZING]
    if config.mode != "axial":
        tracked += ["force_N", "std"]
    if config.mode == "full":
        tracked.append("torque_Nm")
    statistics, overview = ForceStatistics(), RowOverview(tracked)
    with open_output(output, log, lambda: _labels(log, replay.robot, config)) as table:
        for chunk in log:
            rows = replay.run(chunk)
            statistics.add(rows)
            overview.add(rows | {_IS_INITIALIZING: has_status(rows, Status.INITIALIZING)})
            if table is not None:
                table.append(force_table(rows, config))
        replay.finish(is_whole=not log.is_interrupted)
    return ForceResult(log.name, replay, statistics, overview.columns())


_IS_INITIALIZING = "is initializing"


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


def force_table(rows: Rows, config: SensorConfig) -> dict[str, NDArray]:
    """Return the columns in the order in which they are written; names carry the unit."""
    table = {name: rows[name] for name in ("t_s", "travel_m", "axial_N", "axial_std_N")}
    vectors = [("force", "N", rows["force_N"])]
    if config.mode != "axial":
        vectors.append(("force_std", "N", rows["std"][:, :3]))
    if config.mode == "full":
        vectors.append(("torque", "Nm", rows["torque_Nm"]))
        vectors.append(("torque_std", "Nm", rows["std"][:, 3:]))
    for name, unit, values in vectors:
        for i, xyz in enumerate("xyz"):
            table[f"{name}_{xyz}_in_{config.axes}_{unit}"] = values[:, i]
    table["model_mismatch"] = rows["model_mismatch"]
    table["force_warnings"] = rows["warnings"]
    table["force_status"] = rows["status"]
    return table


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
    """Counts rows and remembers ranges, in memory that does not grow with the log."""

    def __init__(self) -> None:
        self.first_s, self.last_s = math.inf, -math.inf
        self.steps_s = ThinnedMedian()
        """Of time steps that advance."""
        self.counts: Counter[Status] = Counter()
        self.warnings: Counter[SensorWarning] = Counter()
        self.ranges_N = {status: (math.inf, -math.inf) for status in Status}
        """Least and largest axial force of the rows of a status."""
        self.std_N = {status: ThinnedMedian() for status in Status}

    def add(self, rows: Rows) -> None:
        """Take further rows."""
        latest_s = np.maximum.accumulate(np.concatenate(([self.last_s], rows["t_s"])))
        steps = np.diff(latest_s)
        self.steps_s.add(steps[(steps > 0.0) & np.isfinite(steps)])
        self.first_s = min(self.first_s, float(rows["t_s"].min()))
        self.last_s = float(latest_s[-1])
        for warning in SensorWarning:
            self.warnings[warning] += int(np.count_nonzero(rows["warnings"] & warning))
        for status in Status:
            chosen = has_status(rows, status)
            if chosen.any():
                self.counts[status] += int(np.count_nonzero(chosen))
                axial_N = rows["axial_N"][chosen]
                low_N, high_N = self.ranges_N[status]
                low_N, high_N = min(low_N, axial_N.min()), max(high_N, axial_N.max())
                self.ranges_N[status] = (float(low_N), float(high_N))
                self.std_N[status].add(rows["axial_std_N"][chosen])


@dataclass(frozen=True, slots=True, eq=False)
class ForceResult:
    """The outcome of a whole log, of bounded size however long the log.

    Attributes:
        log: What the log is called.
        replay: The sensor after the log: robot, settings, tare, lag, rejected rows, gaps.
        statistics: Numbers about all rows.
        rows: As many as a figure needs; all rows of a short log, of a long one those in which a
            force is least or largest for a while.
    """

    log: str
    replay: Replay
    statistics: ForceStatistics
    rows: Rows

    def text(self) -> str:
        """Return the lines of the summary with their texts below each other."""
        lines = list(summary_lines(self.replay, self.statistics))
        width = max(len(label) for label, _ in lines)
        return "".join(f"{label:<{width}}  {text}\n" for label, text in lines)

    def figure(self, output: Output) -> Chart:
        """Return the chart that the options ask for."""
        shown = replace(self, rows=in_window(self.rows, output))
        return travel_chart(shown) if output.over == "depth" else force_chart(shown)

    def page(self, folder: Path, warnings: Sequence[str]) -> Page:
        """Save the charts of a report in a folder and return the page that shows them."""
        summary = PageTable(
            caption="What was used, done and found",
            head=("", ""),
            rows=tuple(summary_lines(self.replay, self.statistics)),
        )
        return result_page(
            f"Forces from {self.log}",
            f"Made by `needleforce force`: {self.replay.description}.",
            warnings,
            tuple(_page_figures(self, folder)),
            Section(heading="Summary", anchor="summary", tables=(summary,)),
            settings_table(self.replay.config, "Sensor: as in a file for --config, SI units"),
        )


# The summary.


def summary_lines(replay: Replay, found: ForceStatistics) -> Iterator[tuple[str, str]]:
    """Yield label and text of every line: what was used, what was done, what came out."""
    payload = replay.robot.payload
    mass_kg = payload.mass_kg if payload is not None else 0.0
    yield "robot", f"{replay.robot.model.name}, {replay.robot.nv} joints, payload {mass_kg:.3g} kg"
    yield "sensor", replay.description
    counts = [f"{count} {status.value}" for status in Status if (count := found.counts[status])]
    rate_hz = 1.0 / found.steps_s.value
    span = f"{found.counts.total()} in {found.last_s - found.first_s:.4g} s at {rate_hz:.4g} Hz"
    yield "samples", f"{span}: {', '.join(counts)}"
    reasons = [f"{count} x {reason}" for reason, count in replay.rejected.most_common()]
    listed = "; ".join(
        [*reasons[:4], *([f"{len(reasons) - 4} other reasons"] * (len(reasons) > 4))]
    )
    yield "rejected", f"{replay.rejected.total()}: {listed}" if reasons else "none"
    yield "gaps", _gaps(replay)
    warnings = [
        f"{count} x {str(warning.name).lower().replace('_', ' ')}"
        for warning, count in found.warnings.most_common()
        if count
    ]
    yield "warnings", ", ".join(warnings) or "none"
    if replay.velocity_fault:
        yield "velocity", replay.velocity_fault
    yield "tare", _tare(replay.tare)
    yield "axial force", _force(found)
    lag = "that of the robot's own estimate"
    yield "lag", lag if replay.is_external else f"{1e3 * replay.lag_s:.1f} ms"


def _gaps(replay: Replay) -> str:
    limit_s = replay.config.max_gap_s
    if not replay.gaps:
        return f"none longer than {limit_s:g} s"
    return (
        f"{replay.gaps} longer than {limit_s:g} s (longest {replay.longest_gap_s:.3g} s), after "
        "which the filters restarted"
    )


def _tare(done: TareWindow | None) -> str:
    if done is None or done.tare is None:
        return "none: forces carry the errors of the model and of the torque sensors"
    kind, offset_Nm = done.tare.basis.kind, done.largest_offset_Nm
    return f"{done} of the log, kind {kind!r}, offsets up to {offset_Nm:.2g} Nm"


def _force(found: ForceStatistics) -> str:
    status = Status.OK if found.counts[Status.OK] else Status.NOT_TARED
    if not found.counts[status]:
        return "none: no sample was valid after the filters had settled"
    low_N, high_N = found.ranges_N[status]
    spread = f"standard deviation {found.std_N[status].value:.3f} N (median)"
    note = "" if status is Status.OK else ", not tared"
    return f"{low_N:.3f} to {high_N:.3f} N, {spread}{note}"


# Charts.

_PANEL_IN = 2.2
_LEAST_TRAVEL_M = 1e-3
"""A chart over travel has nothing to show where the tool hardly moves."""


def force_chart(result: ForceResult) -> Chart:
    """Return every estimated component over time, with its band of two standard deviations."""
    rows, config = result.rows, result.replay.config
    start_s, time = time_axis(rows["t_s"])
    x = rows["t_s"] - start_s
    axial = ("axial force", palette.OURS, rows["axial_N"], rows["axial_std_N"])
    groups: dict[str, list[_Component]] = {palette.FORCE: [axial]}
    vectors = [("force", "N", rows["force_N"], rows["std"][:, :3])] * (config.mode != "axial")
    vectors += [("torque", "Nm", rows["torque_Nm"], rows["std"][:, 3:])] * (config.mode == "full")
    dashes = (palette.OURS.dash, palette.DASHED, palette.DASH_DOTTED)
    styles = [
        replace(palette.UNTARED, color=color, dash=dash)
        for color, dash in zip(palette.AXES_XYZ, dashes, strict=True)
    ]
    for name, unit, values, std in vectors:
        groups[f"{name},\n{config.axes} axes [{unit}]"] = [
            (f"{name} {xyz}", styles[i], values[:, i], std[:, i]) for i, xyz in enumerate("xyz")
        ]
    rejected = tuple(x[has_status(rows, Status.REJECTED)].tolist())
    return Chart(
        title=f"Force on the needle\n{result.log}: {result.replay.description}",
        x_label=time,
        panels=tuple(_panel(label, rows, x, parts) for label, parts in groups.items()),
        shadings=_shadings(result, x, start_s),
        instants=(Instants(label="rejected", style=palette.REJECTED, places=rejected),),
        x_limits=(float(x.min()), float(x.max())),
        height_in=0.8 + _PANEL_IN * len(groups),
    )


def travel_chart(result: ForceResult) -> Chart:
    """Return the tared axial force over travel, as in the paper's Figure 5."""
    tared = has_status(result.rows, Status.OK)
    axial_N = np.where(result.rows["after_gap"], np.nan, result.rows["axial_N"])[tared]
    place_mm = 1e3 * result.rows["travel_m"][tared]
    curve = Curve(style=palette.OURS, x=place_mm, y=axial_N, label="axial force")
    return Chart(
        title=f"Axial force over travel\n{result.log}",
        x_label="travel of the tool along the needle [mm]",
        panels=(Panel(y_label=palette.FORCE, curves=(curve,)),),
    )


_Component = tuple[str, LineStyle, NDArray[np.float64], NDArray[np.float64]]


def _panel(
    label: str, rows: Rows, x: NDArray[np.float64], components: Sequence[_Component]
) -> Panel:
    """Return the curves; the scale is that of the tared rows, if there are any."""
    curves = [curve for part in components for curve in component_curves(rows, x, *part)]
    tared = [curve for curve in curves if curve.std is not None]
    limits = limits_of(tared, None) if tared else None
    return Panel(y_label=label, curves=tuple(curves), limits=limits)


def component_curves(
    rows: Rows,
    x: NDArray[np.float64],
    name: str,
    style: LineStyle,
    value: NDArray[np.float64],
    std: NDArray[np.float64],
) -> list[Curve]:
    """Return the tared part of a component with its band, and the part that was not tared.

    A rejected row leaves no hole, a gap in time does. Before a tare the band is the prior's, wider
    than any chart: the line alone shows more.
    """
    kept = ~has_status(rows, Status.REJECTED)
    gaps = np.flatnonzero(rows["after_gap"][kept])
    x = np.insert(x[kept], gaps, x[kept][gaps])
    value, std = (np.insert(values[kept], gaps, np.nan) for values in (value, std))
    tared = np.insert(has_status(rows, Status.OK)[kept], gaps, False)
    grey = palette.UNTARED
    if not tared.any():
        untared = replace(grey, color=style.color)
        return [Curve(style=untared, x=x, y=value, label=f"{name}, not tared")]
    curve = Curve(
        style=style,
        x=x,
        y=np.where(tared, value, np.nan),
        label=name,
        std=np.where(tared, std, np.nan),
        band_label=f"{name}, ± 2 std",
    )
    if tared.all():
        return [curve]
    return [Curve(style=grey, x=x, y=np.where(tared, np.nan, value), label="not tared"), curve]


def _shadings(result: ForceResult, x: NDArray[np.float64], start_s: float) -> tuple[Shading, ...]:
    found, tare = [], result.replay.tare
    if tare is not None:
        span = (tare.start_s - start_s, tare.end_s - start_s)
        found.append(Shading(label="tare", color=palette.TARE, spans=(span,)))
    flags = has_status(result.rows, Status.INITIALIZING).astype(np.int8)
    edges = np.diff(np.concatenate(([0], flags, [0])))
    first, last = x[np.flatnonzero(edges == 1)], x[np.flatnonzero(edges == -1) - 1]
    if len(first):
        spans = tuple(zip(first.tolist(), last.tolist(), strict=True))
        found.append(Shading(label="filters settle", color=palette.INITIALIZING, spans=spans))
    return tuple(found)


def _page_figures(result: ForceResult, folder: Path) -> Iterator[PageFigure]:
    yield save_page_figure(
        force_chart(result),
        folder / "forces.svg",
        alt=f"Estimated forces of {result.log} over time",
        caption="The force of the environment on the tool; the axial force is positive when "
        "tissue pushes back. The band is two standard deviations wide to either side. Grey "
        "lines are not tared: they carry the errors of the model and of the torque sensors.",
        is_alone=True,
    )
    travel_m = result.rows["travel_m"][has_status(result.rows, Status.OK)]
    if len(travel_m) and np.ptp(travel_m) >= _LEAST_TRAVEL_M:
        yield save_page_figure(
            travel_chart(result),
            folder / "forces-over-travel.svg",
            alt=f"Axial force of {result.log} over the travel of the tool",
            caption="The same axial force over the travel of the tool along the needle since the "
            "first sample: in tissue the upper branch is the insertion, the lower the withdrawal.",
            is_alone=True,
        )
