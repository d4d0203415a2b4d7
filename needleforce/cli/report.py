"""The command `needleforce report`."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from needleforce.cli.application import LOG, LOGS, app
from needleforce.cli.shared_options import (
    AllColumns,
    IdentificationOptions,
    RobotOptions,
    SensorOptions,
    Source,
)
from needleforce.cli.terminal import CommandError


@app.command(name="report", group=LOGS)
def report_command(
    log: Source,
    folder: Annotated[
        Path, Parameter(name="DIR", group=LOG, help="Created if missing.")
    ],
    /,
    *,
    robot: RobotOptions = RobotOptions(),
    sensor: SensorOptions = SensorOptions(),
    options: IdentificationOptions = IdentificationOptions(),
    columns: AllColumns = AllColumns(),
    plan: Annotated[
        Path | None,
        Parameter(
            metavar="FILE",
            group=LOG,
            help="Plan to compare with what was found (plan.json, or its folder); the "
            "log needs joint positions.",
        ),
    ] = None,
) -> int:
    """Write a page with charts, results, warnings and settings of a log into a folder.

    From a log with joint positions and torques: the forces, as by `needleforce force`,
    and the layers found in them, as by `needleforce identify`. From a log with depth
    and force: the layers. DIR/index.html needs no other file.

    needleforce report insertion.csv report
    """
    from needleforce.cli.logs import replay
    from needleforce.cli.logs.columns import has_channels
    from needleforce.cli.plan_option import load_plan

    torque = "tau_ext" if sensor.external_torque else "tau"
    if has_channels(log, columns, ("q", torque)):
        loaded = load_plan(plan, is_past=True)
        return replay.report_forces(
            log, folder, robot, sensor, columns, options, loaded
        )
    if plan is not None:
        raise CommandError(
            f"--plan {plan}: {log} has no joint positions and torques, so that it is "
            "not known where its needle was; give the log of the arm"
        )
    return replay.report_layers(log, folder, options, columns)
