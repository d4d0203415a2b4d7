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
    from needleforce.cli.logs.replay import report

    return report(log, folder, robot, sensor, columns, options, plan)
