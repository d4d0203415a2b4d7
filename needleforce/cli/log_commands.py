"""The commands on a log: `needleforce force`, `check`, `identify`, `report`, `view`."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from needleforce.cli.application import LOG, LOGS, OUTPUT, app
from needleforce.cli.shared_options import (
    AllColumns,
    DepthColumns,
    IdentificationOptions,
    JointColumns,
    Output,
    RobotOptions,
    SensorOptions,
    Source,
    ViewOptions,
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


@app.command(name="identify", group=LOGS)
def identify_command(
    log: Source,
    /,
    *,
    output: Output = Output(),
    options: IdentificationOptions = IdentificationOptions(),
    columns: DepthColumns = DepthColumns(),
) -> int:
    """Identify ruptures, layers, stiffness and friction from depth and axial force.

    Read a log with time, depth, force and perhaps speed. Depth grows into the tissue;
    force is positive when tissue pushes back. Times are on the log's clock. A ? marks
    values that the data do not identify.

    needleforce identify forces.csv -o layers.csv --figure layers.png
    """
    from needleforce.cli.logs.replay import identify

    return identify(log, output, options, columns)


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


@app.command(name="view", group=LOGS)
def view_command(
    recording: Annotated[Path, Parameter(name="RECORDING", group=LOG)],
    /,
    *,
    options: ViewOptions = ViewOptions(),
    robot: RobotOptions = RobotOptions(),
) -> int:
    """Show a recording of joint signals in a 3-D scene in the browser, until Ctrl-C.

    needleforce view insertion.csv --tare 13
    """
    from needleforce.cli.logs.session_view import view_recording

    return view_recording(recording, options, robot)
