"""`force`, `check`, `identify`, `report`: from options and a log to its result."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from needleforce import plots, recordings
from needleforce.cli.logs import figures, forces, layers
from needleforce.cli.logs.columns import mapping_from_options
from needleforce.cli.logs.result import Figure, Result, Table
from needleforce.cli.robot import payload_from_options, payload_lines
from needleforce.cli.shared_options import (
    DepthColumns,
    IdentificationOptions,
    JointColumns,
    Output,
    RobotOptions,
    SensorOptions,
)
from needleforce.cli.terminal import CommandError, progress_bar, warn, write_out
from needleforce.recordings import ColumnMapping, Log
from needleforce.recordings import output as output_files
from needleforce.recordings.mapping_suggestion import suggest_mapping
from needleforce.recordings.table import STANDARD_STREAM, TableLabels
from needleforce.sensor_replay import STATUS_CODES, SensorReplay
from residual import Status
from residual.tool_kinematics import ToolKinematics
from urdf import Robot

if TYPE_CHECKING:
    from needleforce.cli.logs.plan_found import PlanFound
    from needleforce.plan_file import LoadedPlan

FORCE_CAPTION = (
    "The force of the environment on the tool; the axial force is positive when tissue "
    "pushes back. The band is two standard deviations wide to either side. Grey lines "
    "are not tared: they carry the errors of the model and of the torque sensors."
)

LAYER_CAPTION = (
    "Above, the axial force as it was recorded, the force that the model predicts, the "
    "enhanced force (less the force in free air and the friction of the layers "
    "traversed) and the force at the tip. Below, stiffness and friction of the layer "
    "the tip is in, and the friction of all layers traversed; the band, where the "
    "method states one, is two standard deviations wide to either side. Marks below: "
    "estimated rupture times, and where friction was identified. In the table times "
    "are on the log's clock, and a ? marks what the data do not identify. Where a "
    "membrane is pushed in before it ruptures, layers overlap."
)

DOUBTFUL = 1
"""Exit code of `check` where something in the log is doubtful."""


@dataclass(frozen=True, slots=True, eq=False)
class ForceRun:
    """The forces of a log.

    Attributes:
        name: Name of the log.
        log: The log.
        robot: The robot.
        replay: What the sensor has estimated.
        warnings: What is wrong with the log, and with the torques; said on stderr.
    """

    name: str
    log: Log
    robot: Robot
    replay: SensorReplay
    warnings: tuple[str, ...]


def run_forces(
    source: str, robot: RobotOptions, sensor: SensorOptions, columns: JointColumns
) -> ForceRun:
    """Estimate the forces of a log; what is wrong with it is said on stderr.

    Raises:
        CommandError: Options contradict each other, the log does not fit the robot, or
            the tare is refused.
    """
    model = forces.robot_of_log(source, robot, columns)
    forces.check_tare_options(sensor)
    log = recordings.read_log(
        source,
        mapping_from_options(columns),
        required=("q", forces.torque_channel(sensor)),
        optional=("dq",),
        joints=model.joint_names,
    )
    warnings = log.warnings
    warn(warnings)
    replay, model = forces.estimate_forces(log, model, sensor, _name_of(source))
    doubts = forces.find_doubts(replay)
    warn(doubts)
    return ForceRun(_name_of(source), log, model, replay, (*warnings, *doubts))


def force(
    source: str,
    output: Output,
    robot: RobotOptions,
    sensor: SensorOptions,
    columns: JointColumns,
) -> int:
    """Estimate the forces of a log, and write what was asked for.

    Returns:
        The exit code.
    """
    if columns.print_config:
        model = forces.robot_of_log(source, robot, columns)
        mapping = suggest_mapping(
            source,
            ("q", forces.torque_channel(sensor), "dq"),
            mapping=mapping_from_options(columns),
            joints=model.joint_names,
            payload=payload_lines(payload_from_options(robot, columns.mapping)),
        )
        write_out(mapping)
        return 0
    check_outputs(source, output)
    run = run_forces(source, robot, sensor, columns)
    # Frame 0 is Pinocchio's own "universe"; the first of the URDF is its root link.
    config = run.replay.config
    frame = run.robot.frame_names[1]
    if config.axes != "base":
        frame = config.frame if config.frame is not None else run.robot.tool_frame
    write_rows(run.replay.rows.drop(columns="after_gap"), output, run.log, frame=frame)
    result = force_result(run, None, None)
    title = f"Forces: {run.name}"
    draw = figures.draw_forces(run.replay, title, output.over, window_of(output))
    show(result, output, draw)
    return 0


def check(
    source: str,
    robot: RobotOptions,
    sensor: SensorOptions,
    columns: JointColumns,
    *,
    as_json: bool,
) -> int:
    """Print what `force` says of a log and of its tare.

    Returns:
        The exit code: `DOUBTFUL` where something is.
    """
    run = run_forces(source, robot, sensor, columns)
    replay = run.replay
    result = force_result(run, None, None)
    write_out(result.json() if as_json else result.text())
    is_doubtful = (
        run.warnings
        or run.robot.warnings
        or replay.doubts
        or replay.rejected
        or np.any(replay.rows["after_gap"])
    )
    return DOUBTFUL if is_doubtful else 0


def identify(
    source: str,
    output: Output,
    options: IdentificationOptions,
    columns: DepthColumns,
) -> int:
    """Identify the layers of a log of depth and force, and write what was asked for.

    Returns:
        The exit code.
    """
    mapping = mapping_from_options(columns)
    optional = depth_channels(mapping)
    if columns.print_config:
        wanted = ("depth", "force", *optional)
        write_out(suggest_mapping(source, wanted, mapping=mapping))
        return 0
    check_outputs(source, output)
    log, found = run_layers(source, mapping, optional, options)
    estimates = found.rows.drop(columns=["depth_m", "force_N"])
    write_rows(estimates, output, log, prefix="/needleforce/identification")
    result = layer_result(_name_of(source), found, log)
    title = f"Forces and identified parameters, method {options.method}: {result.log}"
    draw = figures.draw_layers(found, title, output.over, window_of(output))
    show(result, output, draw)
    return 0


def depth_channels(mapping: ColumnMapping) -> tuple[str, ...]:
    """Return what is read beside depth and force.

    What `needleforce force` states of the axial force holds for no other force.
    """
    channels = ("speed", "force_std", "force_status", "force_warnings")
    force_spec = mapping.channels.get("force")
    if force_spec is None or "axial" in force_spec.patterns[0].lower():
        return channels
    return tuple(
        name for name in channels if name == "speed" or name in mapping.channels
    )


def run_layers(
    source: str,
    mapping: ColumnMapping,
    optional: Sequence[str],
    options: IdentificationOptions,
) -> tuple[Log, layers.LayerReplay]:
    """Identify the layers of a log; what is wrong with it is said on stderr."""
    log = recordings.read_log(
        source, mapping, required=("depth", "force"), optional=optional
    )
    warn(log.warnings)
    with progress_bar(_name_of(source)) as progress:
        found = layers.identify_layers(log, options, progress)
    warn(found.warnings)
    return log, found


def report_layers(
    source: str, folder: Path, options: IdentificationOptions, columns: DepthColumns
) -> int:
    """Write the page of a log of depth and force.

    Returns:
        The exit code.
    """
    mapping = mapping_from_options(columns)
    with _report_folder(source, folder) as draft:
        log, found = run_layers(source, mapping, depth_channels(mapping), options)
        result = layer_result(_name_of(source), found, log)
        result.write_page(draft)
    write_out(f"{result.text()}\npage: {folder / plots.PAGE}\n")
    return 0


def report_forces(
    source: str,
    folder: Path,
    robot: RobotOptions,
    sensor: SensorOptions,
    columns: JointColumns,
    options: IdentificationOptions,
    plan: "LoadedPlan | None",
) -> int:
    """Write the page of a log of joint signals: forces, layers, plan.

    Returns:
        The exit code.
    """
    with _report_folder(source, folder) as draft:
        run = run_forces(source, robot, sensor, columns)
        found: layers.LayerReplay | None = None
        on_plan: PlanFound | None = None
        if np.any(run.replay.rows["force_status"] == STATUS_CODES[Status.OK]):
            found = layers.identify_layers(_depth_log(run), options)
            warn(found.warnings)
            if plan is not None:
                on_plan = _compare(run, found, plan)
                warn(on_plan.doubts())
                found = replace(found, zero=on_plan.zero or found.zero)
        result = force_result(run, found, on_plan)
        result.write_page(draft)
    write_out(f"{result.text()}\npage: {folder / plots.PAGE}\n")
    return 0


@contextmanager
def _report_folder(source: str, folder: Path) -> Iterator[Path]:
    """Yield a folder whose files appear under ``folder`` at the end, or not at all."""
    _refuse_harm(source, {f"DIR ({plots.PAGE})": folder / plots.PAGE})
    with plots.whole_folder(folder) as draft:
        assert draft is not None
        yield draft


def _depth_log(run: ForceRun) -> Log:
    """Return forces as `needleforce identify` would read them from their table."""
    rows = run.replay.rows
    columns = {
        "depth_m": "travel_m",
        "force_N": "axial_unsmoothed_N",
        "force_std_N": "axial_unsmoothed_std_N",
        "force_status": "force_status",
        "force_warnings": "force_warnings",
    }
    channels = {name: rows[column].to_numpy() for name, column in columns.items()}
    return Log(t_s=run.log.t_s, channels=channels)


def _compare(
    run: ForceRun, found: layers.LayerReplay, plan: "LoadedPlan"
) -> "PlanFound":
    """Compare the needle and the ruptures with a plan."""
    from needleforce.cli.logs.plan_found import compare_with_plan

    config = run.replay.config
    tool = ToolKinematics(run.robot, config.frame, config.insertion_axis)
    travel_m = run.replay.rows["travel_m"].to_numpy()
    return compare_with_plan(plan, tool, run.log["q_rad"], travel_m, found.layers)


def force_result(
    run: ForceRun, found: layers.LayerReplay | None, on_plan: "PlanFound | None"
) -> Result:
    """Return what is said of forces, the layers in them, and a plan."""
    flags = forces.describe_warnings(run.replay)
    warnings = [*run.warnings, *run.robot.warnings]
    warnings += [] if flags == "none" else [f"samples with {flags}"]
    depths = "identify and report count below first contact"
    tables: list[Table] = []
    sentences: list[str] = []
    title = "Forces"
    everywhere = (-np.inf, np.inf)
    page_figures = [
        Figure(
            name=f"forces-over-{over}",
            draw=figures.draw_forces(run.replay, run.name, over, everywhere),
            caption=FORCE_CAPTION,
        )
        for over in ("time", "depth")
    ]
    settings = {"sensor": run.replay.config}
    files: dict[str, bytes] = {}
    if found is not None:
        layer = layer_result(run.name, found, run.log)
        title = "Forces and layers"
        depths = f"depths of layers count {found.zero.name}"
        tables += layer.tables
        sentences += layer.sentences
        warnings = [*layer.warnings, *warnings]
        page_figures = [*layer.figures, *page_figures]
        settings |= layer.settings
    if on_plan is not None:
        from needleforce.cli.logs.plan_found import NOTE

        sentences += on_plan.sentences()
        warnings = [*on_plan.doubts(), *warnings]
        if len(on_plan.ruptures):
            tables.append(
                Table(caption="Plan against found", rows=on_plan.ruptures, note=NOTE)
            )
        files["needle_on_plan.json"] = on_plan.state_json()
    facts = forces.describe_forces(run.replay, run.robot, run.log, depths=depths)
    return Result(
        log=run.name,
        title=title,
        sentences=tuple(sentences),
        warnings=tuple(warnings),
        facts=tuple(facts),
        tables=tuple(tables),
        units=_units_of(run.log),
        figures=tuple(page_figures),
        settings=settings,
        files=files,
    )


def layer_result(name: str, found: layers.LayerReplay, log: Log) -> Result:
    """Return what is said of layers."""
    note = layers.describe_zero(found.zero)
    table = Table(caption="Layers traversed", rows=layers.layer_table(found), note=note)
    draw = figures.draw_layers(found, name, "time", (-np.inf, np.inf))
    return Result(
        log=name,
        title="Layers",
        sentences=(layers.describe_layers(found),),
        warnings=(*layers.find_tissue_doubts(found), *log.warnings, *found.warnings),
        facts=(),
        tables=(table,) if found.layers else (),
        units=_units_of(log),
        figures=(Figure(name="layers", draw=draw, caption=LAYER_CAPTION),),
        settings={"identification": layers.METHODS[found.method]},
        files={},
    )


def _units_of(log: Log) -> tuple[tuple[str, str], ...]:
    return tuple((unit.channel, str(unit)) for unit in log.units)


def _name_of(source: str) -> str:
    return "standard input" if source == STANDARD_STREAM else Path(source).name


def show(result: Result, output: Output, draw: figures.Draw) -> None:
    """Print a result, and write its figure where one is asked for."""
    write_out(result.text(), to_stderr=output.output == STANDARD_STREAM)
    if output.figure is not None:
        figures.save(draw, output.figure)


def write_rows(
    rows: pd.DataFrame,
    output: Output,
    log: Log,
    *,
    frame: str = "",
    prefix: str = "/needleforce",
) -> None:
    """Write the table of the estimates, if one is asked for, on the log's clock."""
    if output.output is not None:
        columns = {str(name): column.to_numpy() for name, column in rows.items()}
        labels = TableLabels(frame=frame, prefix=prefix, start_ns=log.start_ns)
        recordings.write_table(output.output, columns, labels=labels)


def window_of(output: Output) -> tuple[float, float]:
    """Return what ``--from`` and ``--to`` say of the x axis, infinite if nothing."""
    start = -np.inf if output.start is None else output.start
    end = np.inf if output.end is None else output.end
    return start, end


def check_outputs(source: str, output: Output) -> None:
    """Refuse now what would fail, or destroy something, after the work is done.

    Raises:
        CommandError: The window of the figure is empty.
        RecordingError: A file cannot be written, or is the log itself.
    """
    start, end = window_of(output)
    if not start < end:
        raise CommandError(
            f"--from {start:g} --to {end:g}: expected --from before --to"
        )
    paths: dict[str, Path] = {}
    if output.output is not None:
        recordings.check_writable(output.output)
        if output.output != STANDARD_STREAM:
            paths["-o"] = Path(output.output)
    if output.figure is not None:
        plots.require_matplotlib("--figure", output.figure)
        output_files.require_place(output.figure)
        paths["--figure"] = output.figure
    _refuse_harm(source, paths)


def _refuse_harm(source: str, paths: Mapping[str, Path]) -> None:
    """Refuse to write two things to one place, or over the log."""
    # Standard input may be a file, too: `< log.csv`.
    place = "/dev/stdin" if source == STANDARD_STREAM else source
    output_files.check_outputs(paths, Path(place))
