"""`needleforce force`: forces from joint signals, as table, summary, figure and
page.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from needleforce import plots
from needleforce.cli.logs.layer_result import IdentificationResult, identify_layers
from needleforce.cli.logs.log_session import LogSession, mapping_from_options
from needleforce.cli.logs.outputs import open_output, run_log
from needleforce.cli.logs.row_overview import RowOverview, span, time_axis
from needleforce.cli.logs.sensor_replay import Rows, SensorReplay, has_status
from needleforce.cli.logs.tare_schedule import rejections, tare_window
from needleforce.cli.robot import (
    payload_from_options,
    payload_lines,
    robot_from_options,
    sensor_config,
    with_friction,
)
from needleforce.cli.shared_options import (
    IdentificationOptions,
    JointColumns,
    Output,
    Over,
    RobotOptions,
    SensorOptions,
)
from needleforce.cli.terminal import CommandError, aligned, write_out
from needleforce.plots import Chart, Curve, LineStyle, Panel, palette
from needleforce.plots.chart import limits_of
from needleforce.recordings.channel_request import ChannelRequest
from needleforce.recordings.mapping_suggestion import suggest_mapping
from needleforce.recordings.table import TableLabels
from residual import SensorConfig, SensorWarning, Status


def run(
    source: str,
    output: Output,
    robot_options: RobotOptions,
    sensor: SensorOptions,
    columns: JointColumns,
    layers: IdentificationOptions | None = None,
) -> int:
    """Run the command, with the layers that the forces show if they are asked for,
    too.
    """
    robot = robot_from_options(robot_options, columns.mapping)
    known = mapping_from_options(columns)
    torque = "tau_ext" if sensor.external_torque else "tau"
    joints = robot.joint_names
    if columns.print_config:
        payload = payload_lines(payload_from_options(robot_options, columns.mapping))
        channels = ("q", torque, "dq")
        write_out(
            suggest_mapping(
                source, channels, mapping=known, joints=joints, payload=payload
            )
        )
        return 0
    if sensor.no_tare and (sensor.force_tare or sensor.tare is not None):
        given = "--tare" if sensor.tare is not None else "--force-tare"
        raise CommandError(
            f"{given} and --no-tare contradict each other; give one of them"
        )
    if sensor.tare is not None:
        tare_window(sensor.tare, 0.0)  # before a log is waited for
    robot, friction = with_friction(robot, sensor.friction)
    config = sensor_config(sensor, friction)
    request = ChannelRequest(
        mapping=known, required=("q", torque), optional=("dq",), joints=joints
    )

    def estimate(log: LogSession) -> ForceResult:
        return estimate_forces(log, SensorReplay(robot, config, sensor), output, layers)

    return run_log(source, output, request, estimate)


# From a log to its result.

_CHANNELS = {
    "depth_m": "travel_m",
    "force_N": "axial_unsmoothed_N",
    "force_std_N": "axial_std_N",
}
_CHANNELS |= {name: name for name in ("force_status", "force_warnings")}


def estimate_forces(
    log: LogSession,
    replay: SensorReplay,
    output: Output,
    layers: IdentificationOptions | None = None,
) -> "ForceResult":
    """Run the sensor over a log and write its forces; with options, find the layers
    in them.
    """
    config = replay.config
    tracked = ["axial_N", "axial_std_N", "force_status", "after_gap"]
    tracked += ["force_N", "std"] if config.mode != "axial" else []
    tracked += ["torque_Nm"] if config.mode == "full" else []
    result = ForceResult(log.name, replay)
    overview = RowOverview(tracked)
    forces = []
    # Frame 0 is Pinocchio's own "universe"; the first of the URDF is its root link.
    frame = replay.robot.frame_names[1] if config.axes == "base" else replay.frame
    with open_output(output, log, TableLabels(frame=frame)) as table:
        for chunk in log:
            rows = replay.run(chunk)
            result.add(rows)
            overview.add(rows)
            if table is not None:
                table.append(force_table(rows, config))
            if layers is not None:
                # As `needleforce identify` would read them from their table.
                channels = {name: rows[column] for name, column in _CHANNELS.items()}
                forces.append(replace(chunk, channels=channels))
        replay.finish(is_whole=not log.is_stopped())
    result.rows = overview.columns()
    if layers is not None and result.counts[Status.OK]:
        result.layers = identify_layers(forces, log.name, layers)
    return result


def force_table(rows: Rows, config: SensorConfig) -> dict[str, NDArray]:
    """Return the columns in the order in which they are written; names carry the
    unit.
    """
    table = {name: rows[name] for name in ("t_s", "travel_m", "axial_N", "axial_std_N")}
    for name, unit, values, std in _vectors(rows, config):
        for column, numbers in ((name, values), (f"{name}_std", std)):
            columns = zip("xyz", () if numbers is None else numbers.T, strict=False)
            table |= {
                f"{column}_{xyz}_in_{config.axes}_{unit}": each for xyz, each in columns
            }
    last = ("axial_unsmoothed_N", "model_mismatch", "force_warnings", "force_status")
    return table | {name: rows[name] for name in last}


def _vectors(rows: Rows, config: SensorConfig) -> list[tuple[str, str, NDArray, Any]]:
    """Return name, unit, components and their standard deviations, None where none
    are known.
    """
    std = None if config.mode == "axial" else rows["std"][:, :3]
    vectors: list[tuple[str, str, NDArray, Any]] = [
        ("force", "N", rows["force_N"], std)
    ]
    if config.mode == "full":
        vectors.append(("torque", "Nm", rows["torque_Nm"], rows["std"][:, 3:]))
    return vectors


class ForceResult:
    """The outcome of a whole log, of bounded size however long the log."""

    def __init__(self, log: str, replay: SensorReplay) -> None:
        self.log = log
        self.replay = replay
        self.rows: Rows = {}  # for a figure
        self.layers: IdentificationResult | None = (
            None  # what the forces show, if asked for
        )
        self.counts: Counter[Status] = Counter()
        self.warnings: Counter[SensorWarning] = Counter()
        self._rate_hz = np.nan
        # Of the axial force of the rows of a status: least, largest, sum of standard
        # deviations.
        self._axial_N = {status: (np.inf, -np.inf, 0.0) for status in Status}

    def add(self, rows: Rows) -> None:
        """Count further rows."""
        t_s = rows["t_s"]
        if not self.counts and (steps := np.diff(t_s))[steps > 0.0].size:
            self._rate_hz = 1.0 / float(np.median(steps[steps > 0.0]))
        for warning in SensorWarning:
            self.warnings[warning] += int(
                np.count_nonzero(rows["force_warnings"] & warning)
            )
        for status, (low_N, high_N, total_N) in self._axial_N.items():
            chosen = has_status(rows, status)
            axial_N = rows["axial_N"][chosen]
            std_N = rows["axial_std_N"][chosen]
            self.counts[status] += len(axial_N)
            low_N = np.min(axial_N, initial=low_N)
            high_N = np.max(axial_N, initial=high_N)
            self._axial_N[status] = (low_N, high_N, total_N + float(std_N.sum()))

    def text(self) -> str:
        """Return the lines of the summary, and of the layers if they were asked for."""
        summary = aligned(self.summary())
        return summary if self.layers is None else f"{summary}\n{self.layers.text()}"

    def summary(self) -> Iterator[tuple[str, str]]:
        """Yield label and text of every line: what was used, what was done, what
        came out.
        """
        replay = self.replay
        payload = self.replay.robot.payload
        mass_kg = payload.mass_kg if payload is not None else 0.0
        name = replay.robot.model.name
        joints = replay.robot.nv
        yield "robot", f"{name}, {joints} joints, payload {mass_kg:.3g} kg"
        yield "sensor", replay.description
        span = f"{self.counts.total()} in {replay.duration_s:.4g} s"
        counts = [
            f"{count} {status.value}"
            for status in Status
            if (count := self.counts[status])
        ]
        yield "samples", f"{span} at {self._rate_hz:.4g} Hz: {', '.join(counts)}"
        yield "rejected", rejections(replay.rejected) or "none"
        gaps = replay.gaps
        limit = f"longer than {replay.config.max_gap_s:g} s"
        text = f"{gaps} {limit} (longest {replay.longest_gap_s:.6g} s): filters restart after each"
        if 2 * self.counts[Status.INITIALIZING] > self.counts.total():
            text += (
                "; too few samples, or the unit of time is wrong: --time COLUMN:UNIT"
            )
        yield "gaps", text if gaps else f"none {limit}"
        most = [
            (str(warning.name), count) for warning, count in self.warnings.most_common()
        ]
        found = [
            f"{count} x {name.lower().replace('_', ' ')}"
            for name, count in most
            if count
        ]
        yield "warnings", ", ".join(found) or "none"
        if replay.velocity_fault:
            yield "velocity", replay.velocity_fault
        if replay.question:
            yield "signals", replay.question
        yield "tare", self._tare()
        yield "axial force", self._force()
        lag = "that of the robot's own estimate"
        yield (
            "lag",
            lag if replay.is_external else f"{1e3 * replay.sensor.lag_s:.1f} ms",
        )

    def _tare(self) -> str:
        window = self.replay.tare
        if window is None or window.tare is None:
            return (
                "none: forces carry the errors of the model and of the torque sensors"
            )
        tare = window.tare
        offset_Nm = float(np.abs(tare.mean[: len(tare.noise_Nm2)]).max())
        return (
            f"{window} of the log, kind {tare.kind!r}, offsets up to {offset_Nm:.2g} Nm"
        )

    def _force(self) -> str:
        status = Status.OK if self.counts[Status.OK] else Status.NOT_TARED
        if not self.counts[status]:
            return "none: no sample was valid after the filters had settled"
        low_N, high_N, total_N = self._axial_N[status]
        spread = f"standard deviation {total_N / self.counts[status]:.3f} N (mean)"
        note = "" if status is Status.OK else ", not tared"
        return f"{low_N:.3f} to {high_N:.3f} N, {spread}{note}"

    def chart(self, over: Over = "time") -> Chart:
        """Return every estimated component with its band of two standard deviations."""
        rows = self.rows
        config = self.replay.config
        tare = self.replay.tare
        start_s, x_label = time_axis(rows["t_s"])
        x = rows["t_s"] - start_s
        axial = ("axial force", palette.OURS, rows["axial_N"], rows["axial_std_N"])
        groups: dict[str, list[_Component]] = {palette.FORCE: [axial]}
        for name, unit, values, std in _vectors(rows, config):
            if std is not None:
                groups[f"{name},\n{config.axes} axes [{unit}]"] = [
                    (f"{name} {xyz}", palette.COMPONENTS[i], values[:, i], std[:, i])
                    for i, xyz in enumerate("xyz")
                ]
        rejected = tuple(x[has_status(rows, Status.REJECTED)].tolist())
        spans = (
            () if tare is None else ((tare.start_s - start_s, tare.end_s - start_s),)
        )
        marks = {
            "shadings": (plots.Shading(label="tare", color=palette.TARE, spans=spans),),
            "instants": (plots.Instants("rejected", palette.REJECTED, rejected),),
        }
        if over == "depth":
            x = 1e3 * rows["travel_m"]
            marks = {}
            x_label = "travel of the tool along the needle [mm]"
        return Chart(
            title=f"Force on the needle\n{self.log}: {self.replay.description}",
            x_label=x_label,
            panels=tuple(
                panel_of(label, rows, x, parts) for label, parts in groups.items()
            ),
            height_in=0.8 + _PANEL_IN * len(groups),
            x_limits=span(x),
            **marks,
        )

    def sections(self, folder: Path) -> tuple[plots.Section, ...]:
        """Save the charts of a report in a folder and return the sections of its
        page.
        """
        travel_m = self.rows["travel_m"][has_status(self.rows, Status.OK)]
        is_moving = len(travel_m) and np.ptp(travel_m) >= _LEAST_TRAVEL_M
        figures: tuple[plots.PageFigure, ...] = ()
        for over, caption in _CAPTIONS.items():
            if over == "time" or is_moving:
                words = {
                    "alt": f"Estimated forces of {self.log} over {over}",
                    "caption": caption,
                }
                chart = self.chart(over)
                place = folder / f"forces-over-{over}.svg"
                figures += (
                    plots.save_page_figure(chart, place, is_alone=True, **words),
                )
        made = f"Made by `needleforce force`: {self.replay.description}."
        caption = "What was used, done and found"
        lines = tuple(self.summary())
        summary = plots.PageTable(caption=caption, head=("", ""), rows=lines)
        settings = plots.settings_table(
            self.replay.config, "As in a file for --config, SI units"
        )
        return (
            plots.Section(
                heading="Forces", anchor="forces", paragraphs=(made,), figures=figures
            ),
            plots.Section(heading="Summary", anchor="summary", tables=(summary,)),
            plots.Section(
                heading="Settings of the sensor", anchor="sensor", tables=(settings,)
            ),
            *(() if self.layers is None else self.layers.sections(folder)),
        )


_CAPTIONS: dict[Over, str] = {
    "time": "The force of the environment on the tool; the axial force is positive when tissue "
    "pushes back. The band is two standard deviations wide to either side. Grey lines are not "
    "tared: they carry the errors of the model and of the torque sensors.",
    "depth": "The same over the travel of the tool along the needle since the first sample: in "
    "tissue the upper branch is the insertion, the lower the withdrawal.",
}


_LEAST_TRAVEL_M = (
    1e-3  # a chart over travel has nothing to show where the tool hardly moves
)


_PANEL_IN = 2.2


_Component = tuple[str, LineStyle, NDArray[np.float64], NDArray[np.float64]]


def panel_of(
    label: str, rows: Rows, x: NDArray, components: Sequence[_Component]
) -> Panel:
    """Return of each component the tared part with its band, below it what was not
    tared in grey.

    The scale is that of the tared rows, if there are any. A rejected row leaves no
    hole, a gap in time does. Before a tare the band is the prior's, wider than any
    chart: the line alone shows more.
    """
    kept = ~has_status(rows, Status.REJECTED)
    x = x[kept]
    tared = has_status(rows, Status.OK)[kept]
    curves: list[Curve] = []
    for name, style, values, std in components:
        y = np.where(rows["after_gap"], np.nan, values)[kept]
        if not tared.all():
            grey = palette.UNTARED
            what = "not tared"
            if not tared.any():
                grey = replace(grey, color=style.color)
                what = f"{name}, not tared"
            curves.append(
                Curve(style=grey, x=x, y=np.where(tared, np.nan, y), label=what)
            )
        if tared.any():
            band = {
                "std": np.where(tared, std[kept], np.nan),
                "band_label": f"{name}, ± 2 std",
            }
            y = np.where(tared, y, np.nan)
            curves.append(Curve(style=style, x=x, y=y, label=name, **band))
    scaled = [curve for curve in curves if curve.std is not None]
    limits = limits_of(scaled, None) if scaled else None
    return Panel(y_label=label, curves=tuple(curves), limits=limits)
