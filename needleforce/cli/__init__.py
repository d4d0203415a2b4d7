"""The command `needleforce`: a robot's joint signals to forces, forces to layers.

`options` holds the options of all sub-commands, `terminal` what every command does with errors and
signals, `log` a command's log and files, `robot` the robot from options and TOML files. `force`
with `force_replay`, `identify` and `simulate` do the work; they are imported when they are run, so
that `--help` answers at once.
"""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from cyclopts import App, CycloptsError, Parameter, UnusedCliTokensError

from needleforce.cli.options import (
    LOG,
    OUTPUT,
    AllColumns,
    DepthColumns,
    IdentificationOptions,
    JointColumns,
    Output,
    Reading,
    RobotOptions,
    SensorOptions,
    SimulationOptions,
    Source,
    TareOptions,
)
from needleforce.cli.terminal import CommandError, run_command

_PLAIN = Parameter(negative=(), show_default=False)

app = App(
    name="needleforce",
    help="Needle-tip force from a robot's joint torques, and the layers that the needle passes.",
    default_parameter=_PLAIN,
    help_format="markdown",
    version_flags=["--version"],
    group_parameters=LOG,
    group_arguments=LOG,
)
app.register_install_completion_command(help="Install completion for bash, zsh or fish.")


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code, see `needleforce.cli.terminal`.

    Args:
        argv: Arguments without the program's name; those of the process when None.
    """
    return run_command(lambda: _dispatch(argv), (CycloptsError,))


def _dispatch(argv: Sequence[str] | None) -> int:
    tokens = list(sys.argv[1:] if argv is None else argv)
    try:
        command, bound, _ = app.parse_args(tokens, exit_on_error=False, print_error=False)
    except UnusedCliTokensError as error:
        unused = " ".join(map(repr, error.unused_tokens or ()))
        raise CommandError(
            f"{unused}: not expected here; a command takes one name, and options begin with --"
        ) from error
    return command(*bound.args, **bound.kwargs) or 0


@app.command(name="simulate")
def simulate_command(
    scenario: Annotated[
        str | None, Parameter(name="SCENARIO", group=OUTPUT, help="What is simulated; see --list.")
    ] = None,
    /,
    *,
    options: SimulationOptions = SimulationOptions(),
) -> int:
    """Simulate an insertion and write it as a recording.

    Joint positions, velocities and torques of a KUKA LWR 4+, and the wrench of a force sensor at
    the needle, as a robot would have recorded them.

    needleforce simulate gel-25-constant -o insertion.mcap --truth truth.csv
    """
    from needleforce.cli.simulate import run

    return run(scenario, options)


@app.command(name="force")
def force_command(
    log: Source,
    /,
    *,
    reading: Reading = Reading(),
    output: Output = Output(),
    robot: RobotOptions = RobotOptions(),
    sensor: SensorOptions = SensorOptions(),
    tare: TareOptions = TareOptions(),
    columns: JointColumns = JointColumns(),
) -> int:
    """Estimate the force on a needle from a robot's recorded joint signals.

    Read a log with time, q, tau and perhaps dq. The estimates are good once the sensor was tared
    on motion without contact. Without --tare and --no-tare, the first 2 s after the filters have
    settled are taken for such motion; if contact is seen there, the command stops and says so.

    needleforce force insertion.csv --tare 0:4 -o forces.csv --figure forces.png
    """
    from needleforce.cli.force import run

    return run(log, reading, output, robot, sensor, tare, columns)


@app.command(name="identify")
def identify_command(
    log: Source,
    /,
    *,
    reading: Reading = Reading(),
    output: Output = Output(),
    options: IdentificationOptions = IdentificationOptions(),
    columns: DepthColumns = DepthColumns(),
) -> int:
    """Identify ruptures, layers, stiffness and friction from depth, speed and axial force.

    Read a log with time, depth, force and perhaps speed. Depth grows into the tissue; force is
    positive when tissue pushes back. Times are on the log's clock. A ? marks what the data do not
    identify.

    needleforce identify forces.csv -o layers.csv --figure layers.png
    """
    from needleforce.cli.identify import run

    return run(log, reading, output, options, columns)


@app.command(name="report")
def report_command(
    log: Source,
    folder: Annotated[Path, Parameter(name="DIR", group=LOG, help="Made if it is not there.")],
    /,
    *,
    robot: RobotOptions = RobotOptions(),
    sensor: SensorOptions = SensorOptions(),
    tare: TareOptions = TareOptions(),
    options: IdentificationOptions = IdentificationOptions(),
    columns: AllColumns = AllColumns(),
) -> int:
    """Write a page with charts, results, warnings and settings of a log into a folder.

    A log with joint positions and torques gives the forces, as `needleforce force` does; one with
    depth and force the layers, as `needleforce identify` does. DIR/index.html needs no other file.

    needleforce report insertion.csv report
    """
    from needleforce.cli.log import has_channels

    output = Output(report=folder)
    if has_channels(log, columns, ("q", "tau_ext" if sensor.external_torque else "tau")):
        return force_command(
            log, output=output, robot=robot, sensor=sensor, tare=tare, columns=columns
        )
    return identify_command(log, output=output, options=options, columns=columns)
