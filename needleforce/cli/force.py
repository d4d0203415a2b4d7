"""The command `needleforce force`."""

from needleforce.cli.application import LOGS, app
from needleforce.cli.shared_options import (
    JointColumns,
    Output,
    RobotOptions,
    SensorOptions,
    Source,
)


@app.command(name="force", group=LOGS)
def force_command(
    log: Source,
    /,
    *,
    output: Output = Output(),
    robot: RobotOptions = RobotOptions(),
    sensor: SensorOptions = SensorOptions(),
    columns: JointColumns = JointColumns(),
) -> int:
    """Estimate the force on a needle from a robot's recorded joint signals.

    Read a log with time, q, tau and perhaps dq. The estimates are valid once the sensor
    has been tared on motion without contact. Without --tare and --no-tare, that is the
    first 2 s after the filters have settled; if contact is seen there, the command
    stops and says so.

    needleforce force insertion.csv --tare 0:4 -o forces.csv --figure forces.png
    """
    from needleforce.cli.logs.replay import force

    return force(log, output, robot, sensor, columns)
