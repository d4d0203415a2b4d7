"""From a log to its result: rows in, forces out, as they come."""

from argparse import Namespace

from recordings.command.log_session import LogSession
from recordings.command.output_arguments import open_output
from recordings.command.row_overview import RowOverview
from recordings.tables.labels import Labels
from residual.command.force_labels import force_labels
from residual.command.force_result import ForceResult
from residual.command.force_rows import ForceRows
from residual.command.force_statistics import ForceStatistics
from residual.command.force_table import force_table
from residual.command.joint_signals import joint_signals
from residual.command.replay import Replay
from residual.command.taring import TareRequest
from residual.sensor_config import SensorConfig
from residual.wrench_estimate import Status
from urdf import Robot

_SETTLING = "settling"


def run_log(
    arguments: Namespace,
    log: LogSession,
    robot: Robot,
    config: SensorConfig,
    request: TareRequest,
) -> ForceResult:
    """Run the sensor over a log and write its forces.

    Args:
        arguments: Of the command: where the table goes, which torque is read.
        log: The log, entered.
        robot: The arm with its payload.
        config: Settings of the sensor.
        request: Where to tare.

    Raises:
        CommandError: The log does not fit the robot, or the tare is refused.
        recordings.RecordingError: The log cannot be read, or the table not written.
    """
    replay, forces = Replay(robot, config, request), ForceStatistics()
    overview = RowOverview(_tracked(config))
    has_velocity = False

    def labels() -> Labels:
        return force_labels(log, robot, config)

    with open_output(arguments, is_live=log.is_live, labels=labels) as table:
        for chunk in log:
            signals = joint_signals(chunk, robot, is_external=arguments.external_torque)
            has_velocity = signals.dq_rad_s is not None
            rows = replay.run(signals)
            forces.add(rows)
            overview.add(rows.columns() | {_SETTLING: rows.has_status(Status.SETTLING)})
            if table is not None:
                table.append(force_table(rows, config))
        replay.finish(is_whole=not log.is_interrupted)
    return ForceResult(
        log=log.name,
        robot=robot,
        config=config,
        is_external=arguments.external_torque,
        has_velocity=has_velocity,
        replay=replay,
        statistics=forces,
        overview=ForceRows.of_columns(overview.columns()),
    )


def _tracked(config: SensorConfig) -> list[str]:
    """Return the columns of which a picture must not lose the extremes."""
    tracked = ["axial_N", "axial_std_N", "status", "after_gap", _SETTLING]
    if config.mode != "axial":
        tracked += ["force_N", "std"]
    if config.mode == "full":
        tracked.append("torque_Nm")
    return tracked
