"""The command `needleforce`: a robot's joint signals to forces, forces to layers.

Here stand the commands of the chain, in `live_commands` those of the packages around
it: an arm, a scene, demonstrations; `options` has what they take. Whatever computes is
imported when a command is run, so that `--help` answers at once.

Reading order: `options`, `terminal` (errors, signals, printing), `log` (a command's
log, files and page), `robot` (the robot from options and TOML files), `force_replay`
and `force`, `identify`, `simulate`.
"""

import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter, UnusedCliTokensError

from needleforce.cli import live_commands
from needleforce.cli import options as cli
from needleforce.cli.options import app
from needleforce.cli.terminal import CommandError, run_command

__all__ = ["app", "live_commands", "main"]


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command with its arguments, or those of the process, and return its exit
    code.
    """

    def dispatch() -> int:
        tokens = list(sys.argv[1:] if argv is None else argv)
        # As a path it would be the current folder.
        if empty := [token for token in tokens if re.fullmatch(r"(-[\w-]+=)?", token)]:
            raise CommandError(
                f"{empty[0]!r}: nothing is given there; leave it out, or give a name or a value "
                "(a variable of the shell may not be set)"
            )
        try:
            command, bound, _ = app.parse_args(
                tokens, exit_on_error=False, print_error=False
            )
        except UnusedCliTokensError as error:
            unused = " ".join(map(repr, error.unused_tokens or ()))
            raise CommandError(
                f"{unused}: not expected here; a command takes one name, and options begin with --"
            ) from error
        return command(*bound.args, **bound.kwargs) or 0

    return run_command(dispatch)


@app.command(name="simulate")
def simulate_command(
    scenario: Annotated[
        str | None,
        Parameter(
            name="SCENARIO", group=cli.OUTPUT, help="What is simulated; see --list."
        ),
    ] = None,
    /,
    *,
    options: cli.SimulationOptions = cli.SimulationOptions(),
) -> int:
    """Simulate an insertion and write it as a recording.

    Joint positions, velocities and torques of a KUKA LWR 4+, and the wrench of a force
    sensor at the needle, as a robot would have recorded them.

    needleforce simulate gel-25-constant -o insertion.mcap --truth truth.csv
    """
    from needleforce.cli.simulate import run

    return run(scenario, options)


@app.command(name="force")
def force_command(
    log: cli.Source,
    /,
    *,
    output: cli.Output = cli.Output(),
    robot: cli.RobotOptions = cli.RobotOptions(),
    sensor: cli.SensorOptions = cli.SensorOptions(),
    columns: cli.JointColumns = cli.JointColumns(),
) -> int:
    """Estimate the force on a needle from a robot's recorded joint signals.

    Read a log with time, q, tau and perhaps dq. The estimates are valid once the sensor
    has been tared on motion without contact. Without --tare and --no-tare, that is the
    first 2 s after the filters have settled; if contact is seen there, the command
    stops and says so.

    needleforce force insertion.csv --tare 0:4 -o forces.csv --figure forces.png
    """
    from needleforce.cli.force import run

    return run(log, output, robot, sensor, columns)


@app.command(name="identify")
def identify_command(
    log: cli.Source,
    /,
    *,
    output: cli.Output = cli.Output(),
    options: cli.IdentificationOptions = cli.IdentificationOptions(),
    columns: cli.DepthColumns = cli.DepthColumns(),
) -> int:
    """Identify ruptures, layers, stiffness and friction from depth, speed and axial
    force.

    Read a log with time, depth, force and perhaps speed. Depth grows into the tissue;
    force is positive when tissue pushes back. Times are on the log's clock. A ? marks
    values that the data do not identify.

    needleforce identify forces.csv -o layers.csv --figure layers.png
    """
    from needleforce.cli.identify import run

    return run(log, output, options, columns)


@app.command(name="report")
def report_command(
    log: cli.Source,
    folder: Annotated[
        Path, Parameter(name="DIR", group=cli.LOG, help="Created if missing.")
    ],
    /,
    *,
    robot: cli.RobotOptions = cli.RobotOptions(),
    sensor: cli.SensorOptions = cli.SensorOptions(),
    options: cli.IdentificationOptions = cli.IdentificationOptions(),
    columns: cli.AllColumns = cli.AllColumns(),
) -> int:
    """Write a page with charts, results, warnings and settings of a log into a folder.

    From a log with joint positions and torques: the forces, as by `needleforce force`,
    and the layers found in them, as by `needleforce identify`. From a log with depth
    and force: the layers. DIR/index.html needs no other file.

    needleforce report insertion.csv report
    """
    from needleforce.cli import force, identify
    from needleforce.cli.log import has_channels

    output = cli.Output(report=folder)
    if has_channels(
        log, columns, ("q", "tau_ext" if sensor.external_torque else "tau")
    ):
        return force.run(log, output, robot, sensor, columns, options)
    return identify.run(log, output, options, columns)
