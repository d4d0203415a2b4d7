"""The command `needleforce check`."""

from typing import Annotated

from cyclopts import Parameter

from needleforce.cli.application import LOGS, OUTPUT, app
from needleforce.cli.shared_options import (
    JointColumns,
    RobotOptions,
    SensorOptions,
    Source,
)


@app.command(name="check", group=LOGS)
def check_command(
    log: Source,
    /,
    *,
    json: Annotated[bool, Parameter(group=OUTPUT, help="Print JSON.")] = False,
    robot: RobotOptions = RobotOptions(),
    sensor: SensorOptions = SensorOptions(),
    columns: JointColumns = JointColumns(),
) -> int:
    """Print what `force` says of a log and of its motion without contact.

    Robot, channels, samples, gaps, warnings, and from the tare the torques' scale and
    the missing mass. The exit code is 0 if nothing is doubtful, else 1.

    needleforce check insertion.csv --robot ur5e --tare +0:+4
    """
    from needleforce.cli.logs.replay import check

    return check(log, robot, sensor, columns, as_json=json)
