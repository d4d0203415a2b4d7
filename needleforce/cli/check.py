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
    """Say what a log and its motion without contact verify, and what they do not.

    Channels, clock, samples, velocities, noise, and from the tare the torques' order,
    signs and scale and the payload. Every cause of a doubt has been tried on the log
    itself. The exit code is 0 if nothing is doubtful, else 1.

    needleforce check insertion.csv --robot ur5e --tare +0:+4
    """
    from needleforce.cli.logs.check_run import run

    return run(log, robot, sensor, columns, as_json=json)
