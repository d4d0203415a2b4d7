"""`needleforce force`: from options and a log to forces, and layers if asked for."""

from dataclasses import replace
from typing import TYPE_CHECKING

from needleforce.cli.logs.force_page import ForcePage
from needleforce.cli.logs.force_result import ForceResult, force_table
from needleforce.cli.logs.log_session import LogSession, mapping_from_options
from needleforce.cli.logs.outputs import open_output, run_log
from needleforce.cli.logs.replay_setup import (
    prepare,
    robot_of_log,
    torque_channel,
)
from needleforce.cli.logs.row_overview import RowOverview
from needleforce.cli.logs.torque_summary import describe_doubt
from needleforce.cli.robot import (
    payload_from_options,
    payload_lines,
)
from needleforce.cli.shared_options import (
    IdentificationOptions,
    JointColumns,
    Output,
    RobotOptions,
    SensorOptions,
)
from needleforce.cli.terminal import write_out
from needleforce.recordings.log import LogRows
from needleforce.recordings.mapping_suggestion import suggest_mapping
from needleforce.recordings.table import TableLabels
from needleforce.sensor_replay import ForceRows, SensorReplay
from residual import SensorConfig, SensorWarning, Status

if TYPE_CHECKING:
    from needleforce.cli.logs.plan_found import PlanWatch
    from needleforce.plan_file import LoadedPlan


def run(
    source: str,
    output: Output,
    robot_options: RobotOptions,
    sensor: SensorOptions,
    columns: JointColumns,
    layers: IdentificationOptions | None = None,
    plan: "LoadedPlan | None" = None,
) -> int:
    """Estimate the forces of a log, and the layers in them if asked for.

    Args:
        source: The log as the command line names it.
        output: How long it is read, and which files are written.
        robot_options: The robot.
        sensor: How joint signals become a force.
        columns: Which columns are which channels.
        layers: How forces become layers; None for forces alone.
        plan: The plan against which they are compared, if any.

    Returns:
        The exit code.

    Raises:
        CommandError: Options contradict each other, or the log does not fit the robot.
    """
    if columns.print_config:
        write_out(_suggested_mapping(source, robot_options, sensor, columns))
        return 0
    replay, request = prepare(source, robot_options, sensor, columns)

    def estimate(log: LogSession) -> ForcePage:
        return estimate_forces(log, replay, output, layers, plan)

    return run_log(source, output, request, estimate)


def _suggested_mapping(
    source: str,
    robot_options: RobotOptions,
    sensor: SensorOptions,
    columns: JointColumns,
) -> str:
    """Return the mapping of a log that ``--print-config`` prints."""
    robot = robot_of_log(source, robot_options, sensor, columns)
    payload = payload_lines(payload_from_options(robot_options, columns.mapping))
    return suggest_mapping(
        source,
        ("q", torque_channel(sensor), "dq"),
        mapping=mapping_from_options(columns),
        joints=robot.joint_names,
        payload=payload,
    )


def estimate_forces(
    log: LogSession,
    replay: SensorReplay,
    output: Output,
    layers: IdentificationOptions | None = None,
    plan: "LoadedPlan | None" = None,
) -> ForcePage:
    """Run the sensor over a log and write its forces into the table of the output.

    Args:
        log: The log, which is read to its end.
        replay: The sensor.
        output: Which files are written.
        layers: How forces become layers; None for forces alone.
        plan: The plan against which they are compared, if any.
    """
    config = replay.config
    result = ForceResult(log.name, replay)
    overview = RowOverview(_tracked_columns(config))
    chunks: list[LogRows] = []
    watch = None if plan is None else _watch_plan(plan, replay)
    # Frame 0 is Pinocchio's own "universe"; the first of the URDF is its root link.
    frame = replay.robot.frame_names[1] if config.axes == "base" else replay.frame
    with open_output(output, log, TableLabels(frame=frame)) as table:
        for chunk in log:
            rows = replay.run(chunk)
            result.add(rows)
            overview.add(rows)
            if table is not None:
                table.append(force_table(rows, config))
            if watch is not None:
                watch.add(chunk.channels["q_rad"], rows["travel_m"])
            if layers is not None:
                chunks.append(_as_depth_log(chunk, rows))
        result.count_bad_stamps(log.log.left_out)
        replay.finish(is_whole=not log.is_stopped())
    _warn_of_torques(log, replay, result)
    result.rows = overview.columns()
    if layers is None or not result.counts[Status.OK]:
        return ForcePage(result)
    return _with_layers(result, chunks, layers, watch)


def _watch_plan(plan: "LoadedPlan", replay: SensorReplay) -> "PlanWatch":
    """Return what compares the needle with its plan."""
    from needleforce.cli.logs.plan_found import PlanWatch

    return PlanWatch(plan, replay)


def _with_layers(
    result: ForceResult,
    chunks: list[LogRows],
    options: IdentificationOptions,
    watch: "PlanWatch | None",
) -> ForcePage:
    """Return forces with the layers in them, against the plan if there is one.

    Forces alone take neither the time nor the memory of the identifier: it is imported
    here.
    """
    from needleforce.cli.logs.layer_page import LayerPage
    from needleforce.cli.logs.layer_result import identify_layers

    found = identify_layers(chunks, result.log, options)
    if watch is None:
        return ForcePage(result, LayerPage(found))
    found = replace(found, zero=watch.zero or found.zero)
    return ForcePage(result, LayerPage(found), watch.compare(found.layers))


def _warn_of_torques(
    log: LogSession, replay: SensorReplay, result: ForceResult
) -> None:
    """Warn of what the tare, and the rows after it, show to be wrong with torques."""
    diagnosis = replay.sensor.diagnosis
    if doubt := describe_doubt(diagnosis):
        log.warn(f"torque: {doubt}")
    mismatched = result.warnings[SensorWarning.MODEL_MISMATCH]
    # A knock mismatches for a moment; a wrong arm or payload does most of the time.
    if mismatched > 0.1 * result.counts[Status.OK]:
        log.warn(
            f"model mismatch in {mismatched} of {result.counts[Status.OK]} rows: their "
            "torques are not those of a force on the needle's tip of this arm; check "
            "--robot, --payload and the factor of --tau, and what else touched the arm"
        )


def _tracked_columns(config: SensorConfig) -> list[str]:
    """Return the columns whose extremes a figure must show."""
    tracked = ["axial_N", "axial_std_N", "force_status", "after_gap"]
    if config.mode != "axial":
        tracked += ["force_N", "std"]
    if config.mode == "full":
        tracked += ["torque_Nm"]
    return tracked


_COLUMN_OF_CHANNEL = {
    "depth_m": "travel_m",
    "force_N": "axial_unsmoothed_N",
    "force_std_N": "axial_unsmoothed_std_N",
    "force_status": "force_status",
    "force_warnings": "force_warnings",
}
"""Columns of the forces that are the channels of the identification."""


def _as_depth_log(chunk: LogRows, rows: ForceRows) -> LogRows:
    """Return forces as `needleforce identify` would read them from their table."""
    channels = {name: rows[column] for name, column in _COLUMN_OF_CHANNEL.items()}
    return replace(chunk, channels=channels)
