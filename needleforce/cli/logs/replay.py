"""`force`, `check`, `identify`, `report`: from options and a log to its result."""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial, reduce
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd

from needleforce import plots, recordings
from needleforce.cli.logs import figures, forces, layers
from needleforce.cli.logs.columns import (
    has_channels,
    mapping_from_options,
    robot_of_log,
)
from needleforce.cli.logs.forces import ForceRun, name_of, run_forces
from needleforce.cli.logs.result import CaptionedFigure, Draw, Result, save
from needleforce.cli.robot import payload_from_options, payload_lines
from needleforce.cli.shared_options import (
    AllColumns,
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
from needleforce.sensor_replay import STATUS_CODES
from residual import Status
from residual.tool_kinematics import ToolKinematics

if TYPE_CHECKING:
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
        mapping = mapping_from_options(columns)
        model = robot_of_log(source, mapping, robot, columns.mapping)
        wanted = ("q", sensor.torque_channel, "dq")
        payload = payload_lines(payload_from_options(robot, columns.mapping))
        suggestion = suggest_mapping(
            source, wanted, mapping=mapping, joints=model.joint_names, payload=payload
        )
        write_out(suggestion)
        return 0
    check_outputs(source, output)
    run = run_forces(source, robot, sensor, columns)
    # Frame 0 is Pinocchio's own "universe"; the first of the URDF is its root link.
    config = run.replay.config
    frame = run.robot.frame_names[1]
    if config.axes != "base":
        frame = config.frame or run.robot.tool_frame
    labels = TableLabels(frame=frame, prefix="/needleforce", start_ns=run.log.start_ns)
    rows = run.replay.rows.drop(columns="after_gap")
    draw = partial(figures.draw_forces, run.replay, f"Forces: {run.name}", output.over)
    write_outputs(force_result(run), rows, labels, draw, output)
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
    result = force_result(run)
    write_out(result.json() if as_json else result.text())
    replay = run.replay
    is_doubtful = (
        run.warnings
        or run.robot.warnings
        or replay.doubts
        or replay.rejected
        or replay.rows["after_gap"].any()
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
    if columns.print_config:
        wanted = ("depth", "force", *depth_channels(mapping))
        write_out(suggest_mapping(source, wanted, mapping=mapping))
        return 0
    check_outputs(source, output)
    log, found = run_layers(source, mapping, options)
    rows = found.rows.drop(columns=["depth_m", "force_N"])
    prefix = "/needleforce/identification"
    labels = TableLabels(prefix=prefix, start_ns=log.start_ns)
    name = name_of(source)
    title = f"Forces and identified parameters, method {options.method}: {name}"
    draw = partial(figures.draw_layers, found, title, output.over)
    write_outputs(layer_result(name, found, log), rows, labels, draw, output)
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
    source: str, mapping: ColumnMapping, options: IdentificationOptions
) -> tuple[Log, layers.LayerReplay]:
    """Identify the layers of a log; what is wrong with it is said on stderr."""
    optional = depth_channels(mapping)
    log = recordings.read_log(
        source, mapping, required=("depth", "force"), optional=optional
    )
    warn(log.warnings)
    with progress_bar(name_of(source)) as progress:
        found = layers.identify_layers(log, options, progress)
    warn(found.warnings)
    return log, found


def report(
    source: str,
    folder: Path,
    robot: RobotOptions,
    sensor: SensorOptions,
    columns: AllColumns,
    options: IdentificationOptions,
    plan: Path | None,
) -> int:
    """Write the page of a log: of its forces, if it has joint signals, and its layers.

    Returns:
        The exit code.
    """
    mapping = mapping_from_options(columns)
    has_joints = has_channels(source, mapping, ("q", sensor.torque_channel))
    if plan is not None and not has_joints:
        raise CommandError(
            f"--plan {plan}: {source} has no joint positions and torques, so that it "
            "is not known where its needle was; give the log of the arm"
        )
    loaded = None
    if plan is not None:
        from needleforce.cli.session_parts import load_plan

        loaded = load_plan(plan, is_past=True)
    _refuse_harm(source, {f"DIR ({plots.PAGE})": folder / plots.PAGE})
    with plots.whole_folder(folder) as draft:
        if has_joints:
            run = run_forces(source, robot, sensor, columns)
            result = force_result(run)
            # Untared forces have no layers: they are off by a newton.
            if (run.replay.rows["force_status"] == STATUS_CODES[Status.OK]).any():
                result, _ = forces_with_layers(run, options, loaded)
        else:
            log, found = run_layers(source, mapping, options)
            result = layer_result(name_of(source), found, log)
        if draft is not None:
            result.write_page(draft)
    write_out(f"{result.text()}\npage: {folder / plots.PAGE}\n")
    return 0


def forces_with_layers(
    run: ForceRun, options: IdentificationOptions, plan: "LoadedPlan | None" = None
) -> tuple[Result, layers.LayerReplay]:
    """Return what is said of forces, the layers in them, and a plan; and the layers.

    What is wrong with the layers is said on stderr.
    """
    found = layers.identify_layers(_depth_log(run), options)
    warn(found.warnings)
    parts: list[Result] = []
    if plan is not None:
        from needleforce.cli.logs.plan_found import compare_with_plan

        config = run.replay.config
        tool = ToolKinematics(run.robot, config.frame, config.insertion_axis)
        travel_m = run.replay.rows["travel_m"].to_numpy()
        compared, zero = compare_with_plan(
            run.name, plan, tool, run.log["q_rad"], travel_m, found.layers
        )
        warn(compared.warnings)
        found = replace(found, zero=zero or found.zero)
        parts.append(compared)
    parts += [layer_result(run.name, found), force_result(run)]
    return replace(reduce(Result.joined, parts), title="Forces and layers"), found


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


def force_result(run: ForceRun) -> Result:
    """Return what is said of forces."""
    flags = forces.describe_warnings(run.replay)
    marked = [f"samples with {flags}"] if flags else []
    return Result(
        log=run.name,
        title="Forces",
        warnings=(*run.warnings, *run.robot.warnings, *marked),
        facts=forces.describe_forces(run),
        units=_units_of(run.log),
        figures={
            f"forces-over-{over}": CaptionedFigure(
                partial(figures.draw_forces, run.replay, run.name, over), FORCE_CAPTION
            )
            for over in ("time", "depth")
        },
        settings={"sensor": run.replay.config},
    )


def layer_result(
    name: str, found: layers.LayerReplay, log: Log | None = None
) -> Result:
    """Return what is said of layers, and of the log that they were read from."""
    caption = "Layers traversed"
    draw = partial(figures.draw_layers, found, name, "time")
    tissue = layers.find_tissue_doubts(found)
    return Result(
        log=name,
        title="Layers",
        sentences=(layers.describe_layers(found),),
        warnings=(*tissue, *(log.warnings if log else ()), *found.warnings),
        tables={caption: layers.layer_table(found)} if found.layers else {},
        notes={caption: layers.describe_zero(found.zero)},
        units=_units_of(log) if log else {},
        figures={"layers": CaptionedFigure(draw, LAYER_CAPTION)},
        settings={"identification": layers.METHODS[found.method]},
    )


def _units_of(log: Log) -> dict[str, str]:
    """Return in which unit each channel was read."""
    return {unit.channel: str(unit) for unit in log.units}


def write_outputs(
    result: Result, rows: pd.DataFrame, labels: TableLabels, draw: Draw, output: Output
) -> None:
    """Write the table and the figure that are asked for, and print the result.

    Args:
        result: What is printed.
        rows: The estimates, row by row.
        labels: What a bag says of them.
        draw: Draws the figure.
        output: What is asked for.
    """
    if output.output is not None:
        table = {str(name): column.to_numpy() for name, column in rows.items()}
        recordings.write_table(output.output, table, labels=labels)
    write_out(result.text(), to_stderr=output.output == STANDARD_STREAM)
    if output.figure is not None:
        save(draw, output.figure)


def check_outputs(source: str, output: Output) -> None:
    """Refuse now what would fail, or destroy something, after the work is done.

    Raises:
        RecordingError: A file cannot be written, or is the log itself.
    """
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
