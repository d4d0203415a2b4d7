"""`force`, `check`, `identify`, `report`: from options and a log to its result."""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd

from needleforce import plots, recordings
from needleforce.cli.logs import columns as log_columns
from needleforce.cli.logs import figures, layers
from needleforce.cli.logs.columns import name_log
from needleforce.cli.logs.forces import add_forces, find_doubts, run_forces
from needleforce.cli.logs.result import Draw, Result, save
from needleforce.cli.options import (
    AllColumns,
    DepthColumns,
    IdentificationOptions,
    JointColumns,
    Output,
    RobotOptions,
    SensorOptions,
)
from needleforce.cli.robot import payload_from_options, payload_lines
from needleforce.cli.terminal import CommandError, progress_bar, warn, write_out
from needleforce.recordings import output as output_files
from needleforce.recordings.table import STANDARD_STREAM, TableLabels
from needleforce.session_replay import SensorReplay
from residual import Status

if TYPE_CHECKING:
    from needleforce.plan_file import LoadedPlan

DOUBTFUL = 1
"""Exit code of `check` where something in the log is doubtful."""


def force(
    source: Sequence[str],
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
        mapping = log_columns.mapping_from_options(columns)
        model = log_columns.robot_of_log(source, mapping, robot, columns.mapping)
        wanted = ("q", sensor.torque_channel, "dq")
        payload = payload_lines(payload_from_options(robot, columns.mapping))
        suggestion = recordings.suggest_mapping(
            source, wanted, mapping=mapping, joints=model.joint_names, payload=payload
        )
        write_out(suggestion)
        return 0
    check_outputs(source, output)
    replay = run_forces(source, robot, sensor, columns)
    name = name_log(source)
    # Frame 0 is Pinocchio's own "universe"; the first of the URDF is its root link.
    base = replay.robot.frame_names[1]
    tool = replay.config.frame or replay.robot.tool_frame
    frame = base if replay.config.axes == "base" else tool
    labels = TableLabels(frame=frame, start_ns=replay.log.start_ns)
    rows = replay.rows.drop(columns="after_gap")
    draw = partial(figures.draw_forces, replay, f"Forces: {name}", output.over)
    result = Result(log=name, title="Forces")
    add_forces(result, replay)
    write_outputs(result, rows, labels, draw, output)
    return 0


def check(
    source: Sequence[str],
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
    replay = run_forces(source, robot, sensor, columns)
    result = Result(log=name_log(source), title="Forces")
    add_forces(result, replay)
    write_out(result.json() if as_json else result.text())
    is_doubtful = (
        replay.log.warnings
        or find_doubts(replay)
        or replay.robot.warnings
        or replay.doubts
        or replay.rejected
        or replay.rows["after_gap"].any()
    )
    return DOUBTFUL if is_doubtful else 0


def identify(
    source: Sequence[str],
    output: Output,
    options: IdentificationOptions,
    columns: DepthColumns,
) -> int:
    """Identify the layers of a log of depth and force, and write what was asked for.

    Returns:
        The exit code.
    """
    if columns.print_config:
        mapping = log_columns.mapping_from_options(columns)
        wanted = ("depth", "force", *log_columns.depth_channels(mapping))
        write_out(recordings.suggest_mapping(source, wanted, mapping=mapping))
        return 0
    check_outputs(source, output)
    found = run_layers(source, columns, options)
    name = name_log(source)
    labels = TableLabels(
        prefix="/needleforce/identification", start_ns=found.log.start_ns
    )
    title = f"Forces and identified parameters, method {options.method}: {name}"
    draw = partial(figures.draw_layers, found, title, output.over)
    result = Result(log=name, title="Layers")
    layers.add_layers(result, found)
    rows = found.rows.drop(columns=["depth_m", "force_N"])
    write_outputs(result, rows, labels, draw, output)
    return 0


def run_layers(
    source: Sequence[str], columns: DepthColumns, options: IdentificationOptions
) -> layers.LayerReplay:
    """Identify the layers of a log; what is wrong with it is said on stderr."""
    mapping = log_columns.mapping_from_options(columns)
    log = recordings.read_log(
        source,
        mapping,
        required=log_columns.needle_channels(columns),
        optional=("depth", *log_columns.depth_channels(mapping)),
    )
    if columns.constant_speed is not None:
        speed = mapping.knowledge.channels["speed"]
        log = log_columns.add_constant_speed(log, columns.constant_speed, speed)
    warn(log.warnings)
    with progress_bar(name_log(source)) as progress:
        found = layers.identify_layers(log, options, progress)
    warn(found.warnings)
    return found


def report(
    source: Sequence[str],
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
    mapping = log_columns.mapping_from_options(columns)
    joint_channels = ("q", sensor.torque_channel)
    needle_channels = log_columns.needle_channels(columns)
    has_joints = log_columns.has_channels(
        source, mapping, joint_channels, needle_channels
    )
    if has_joints and columns.constant_speed is not None:
        raise CommandError(
            f"--constant-speed: {name_log(source)} has joint positions and torques, "
            "and the depth is the travel of its tool; leave it out"
        )
    loaded = None
    if plan is not None:
        from needleforce.cli.session_parts import load_plan

        if not has_joints:
            raise CommandError(
                f"--plan {plan}: {name_log(source)} has no joint positions and "
                "torques, so that it is not known where its needle was; give the log "
                "of the arm"
            )
        loaded = load_plan(plan, is_past=True)
    result = Result(log=name_log(source), title="Forces" if has_joints else "Layers")
    _refuse_harm(source, {f"DIR ({plots.PAGE})": folder / plots.PAGE})
    with plots.whole_folder(folder) as draft:
        if has_joints:
            replay = run_forces(source, robot, sensor, columns)
            # Untared forces have no layers: they are off by a newton.
            if replay.count_status(Status.OK):
                add_layers_of_forces(result, replay, options, loaded)
            add_forces(result, replay)
        else:
            layers.add_layers(result, run_layers(source, columns, options))
        if draft is not None:
            result.write_page(draft)
    write_out(f"{result.text()}\npage: {folder / plots.PAGE}\n")
    return 0


def add_layers_of_forces(
    result: Result,
    replay: SensorReplay,
    options: IdentificationOptions,
    plan: "LoadedPlan | None" = None,
) -> layers.LayerReplay:
    """Add the layers in the forces of a log to their result, and a plan against them.

    What is wrong with the layers is said on stderr.

    Returns:
        The layers.
    """
    found = layers.identify_layers(layers.depth_log(replay), options)
    warn(found.warnings)
    result.title = "Forces and layers"
    if plan is not None:
        from needleforce.cli.logs.plan_found import compare_with_plan

        found = compare_with_plan(result, plan, replay, found)
    layers.add_layers(result, found)
    return found


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


def check_outputs(source: Sequence[str], output: Output) -> None:
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


def _refuse_harm(source: Sequence[str], paths: Mapping[str, Path]) -> None:
    """Refuse to write two things to one place, or over the log."""
    # Standard input may be a file, too: `< log.csv`.
    places = ["/dev/stdin" if each == STANDARD_STREAM else each for each in source]
    output_files.check_outputs(paths, map(Path, places))
