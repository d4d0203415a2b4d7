"""The command `needleforce`: a robot's joint signals to forces, forces to layers.

Here stand the commands and their options: frozen dataclasses from which cyclopts builds the parser,
with the text below a field as its help. Whatever computes is imported when a command is run, so
that `--help` answers at once.

Reading order: `terminal` (errors, signals, printing), `log` (a command's log, files and page),
`robot` (the robot from options and TOML files), `force_replay` and `force`, `identify`, `simulate`.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import App, Group, Parameter, UnusedCliTokensError

from needleforce.cli.terminal import CommandError, run_command

LOG = Group("Log", sort_key=1)
OUTPUT = Group("Output", help="Without any of these, only a summary is printed.", sort_key=2)
ROBOT = Group("Robot", sort_key=3)
SENSOR = Group("Sensor", sort_key=4)
TARE = Group("Tare", sort_key=5)
COLUMNS = Group(
    "Columns",
    help="COLUMNS is a column name, a pattern such as q{1..7} or q_*, or names separated by "
    "commas; a unit and a factor may follow, as in z:mm or fz:N:-1. What is not given is found "
    "by its usual names.",
    sort_key=6,
)

Source = Annotated[
    str,
    Parameter(
        name="LOG",
        group=LOG,
        allow_leading_hyphen=True,
        help="Recording: .csv, .csv.gz, .npz, .parquet, or a ROS 2 bag; - for standard input.",
    ),
]

_COLUMN = Parameter(metavar="COLUMNS")


@Parameter(name="*", group=COLUMNS)
@dataclass(frozen=True, kw_only=True)
class Columns:
    """Which columns are which channels; a field of a channel's name holds its columns."""

    time: Annotated[str | None, _COLUMN] = None
    """Time stamp (s, ms, us, ns)."""
    rate: Annotated[float | None, Parameter(metavar="HZ")] = None
    """Sample rate, when there is no time."""
    mapping: Annotated[str | None, Parameter(metavar="FILE")] = None
    """TOML file that says all this."""
    print_config: bool = False
    """Print such a file for this log, to be edited, and stop."""


@Parameter(name="*", group=COLUMNS)
@dataclass(frozen=True, kw_only=True)
class JointColumns(Columns):
    """Channels of `force`."""

    q: Annotated[str | None, _COLUMN] = None
    """Joint position (rad, deg)."""
    dq: Annotated[str | None, _COLUMN] = None
    """Joint velocity (rad/s, deg/s)."""
    tau: Annotated[str | None, _COLUMN] = None
    """Measured joint torque (Nm, mNm)."""
    tau_ext: Annotated[str | None, _COLUMN] = None
    """External joint torque as the robot estimates it (Nm, mNm)."""


@Parameter(name="*", group=COLUMNS)
@dataclass(frozen=True, kw_only=True)
class DepthColumns(Columns):
    """Channels of `identify`."""

    depth: Annotated[str | None, _COLUMN] = None
    """Travel of the needle tip along its axis, growing into the tissue (m, cm, mm, um)."""
    speed: Annotated[str | None, _COLUMN] = None
    """Rate of depth (m/s, cm/s, mm/s, um/s)."""
    force: Annotated[str | None, _COLUMN] = None
    """Axial force, positive when tissue pushes back (N, mN)."""


@Parameter(name="*", group=COLUMNS)
@dataclass(frozen=True, kw_only=True)
class AllColumns(JointColumns, DepthColumns):
    """Channels of `report`."""


Over = Literal["time", "depth"]


@Parameter(name="*", group=OUTPUT)
@dataclass(frozen=True, kw_only=True)
class Output:
    """How long a log is read, and the files to write."""

    follow: Annotated[bool, Parameter(group=LOG)] = False
    """Go on reading as the file (CSV, MCAP) grows, until Ctrl-C or --idle."""
    idle: Annotated[float | None, Parameter(metavar="SECONDS", group=LOG)] = None
    """Stop when nothing new came for so long, with --follow or a pipe."""
    output: Annotated[
        str | None, Parameter(name=("--output", "-o"), metavar="FILE", allow_leading_hyphen=True)
    ] = None
    """Table of the estimates, row by row: .csv, .npz, .parquet, .mcap (a ROS 2 bag), or - for CSV
    on standard output."""
    figure: Annotated[Path | None, Parameter(name=("--figure", "--png"), metavar="FILE")] = None
    """Figure: .png, .svg or .pdf."""
    over: Over = "time"
    """Draw the figure over time, or over the depth of the needle."""
    start: Annotated[float | None, Parameter(name="--from", metavar="X")] = None
    """Start of the figure on its own axis, in seconds or, with --over depth, millimetres."""
    end: Annotated[float | None, Parameter(name="--to", metavar="X")] = None
    """End of the figure, likewise."""
    report: Annotated[Path | None, Parameter(metavar="DIR")] = None
    """Folder for a page with charts, results, warnings and settings."""


@Parameter(name="*", group=ROBOT)
@dataclass(frozen=True, kw_only=True)
class RobotOptions:
    """The robot on which the log was recorded."""

    robot: Annotated[str | None, Parameter(metavar="NAME")] = None
    """A known arm: lwr (KUKA LWR 4+, default), panda, ur3, ur5, ur5e, ur10, ur10e, xarm7."""
    urdf: Annotated[str | None, Parameter(metavar="FILE")] = None
    """Any other robot."""
    tool_frame: Annotated[str | None, Parameter(metavar="NAME")] = None
    """Link that carries the payload and whose z axis is the insertion direction (default: that of
    the known arm; of a URDF the last link, if there is one only)."""
    tip_offset: Annotated[tuple[float, float, float] | None, Parameter(metavar="X Y Z")] = None
    """Where the tool is mounted in that frame [m], without editing the URDF."""
    without: Annotated[tuple[str, ...], Parameter(metavar="LINK", consume_multiple=True)] = ()
    """Links to leave out with all that they carry, such as panda_hand where the hand is off."""
    lock: Annotated[
        tuple[str, ...], Parameter(metavar="JOINT[=POSITION]", consume_multiple=True)
    ] = ()
    """With --urdf: joints that are not in the log, held at a position in rad or m (default: 0)."""
    payload: Annotated[str | None, Parameter(metavar="FILE|needle|none")] = None
    """What hangs on the flange: a TOML file; the paper's 304 g force sensor and needle (default of
    the LWR); or nothing (default of other robots); else what the mapping says."""


@Parameter(name="*", group=SENSOR)
@dataclass(frozen=True, kw_only=True)
class SensorOptions:
    """How joint signals become a force."""

    gain: Annotated[float | None, Parameter(metavar="K")] = None
    """Observer gain K in 1/s (lag 1/K)."""
    alignment: Literal["hold", "trapezoid"] | None = None
    """Torques are commands held until the next sample (hold), or a sensor's samples (trapezoid)."""
    mode: Literal["axial", "point", "full"] | None = None
    """Contact: force along the needle (axial), 3-D force at the tip (point), 6-D wrench (full)."""
    insertion_axis: Annotated[tuple[float, float, float] | None, Parameter(metavar="X Y Z")] = None
    """Insertion direction in the tool frame (default: its z axis, 0 0 1)."""
    published: bool = False
    """The method as published."""
    config: Annotated[str | None, Parameter(metavar="FILE")] = None
    """TOML file of further settings."""
    friction: Annotated[str | None, Parameter(metavar="FILE")] = None
    """TOML file of joint friction and rotor inertia."""
    gravity_compensated: bool = False
    """The measured torque leaves gravity out already, as some drivers report it."""
    external_torque: bool = False
    """Read the external torque that the robot estimates itself (tau_ext) instead of tau."""
    tare: Annotated[
        str | None, Parameter(metavar="START:END", allow_leading_hyphen=True, group=TARE)
    ] = None
    """Motion without contact, in seconds of the log's clock, or (+0:+4) from its first stamp."""
    no_tare: Annotated[bool, Parameter(group=TARE)] = False
    """Leave the offset in the forces."""
    force_tare: Annotated[bool, Parameter(group=TARE)] = False
    """Tare even where contact is seen."""


Method = Literal["multilayer", "published", "published-kv"]


@Parameter(name="*", group=SENSOR)
@dataclass(frozen=True, kw_only=True)
class IdentificationOptions:
    """How forces become layers."""

    method: Method = "multilayer"
    """Ours, or the method as published with the multi-layer or the Kelvin-Voigt model."""
    ignore_status: bool = False
    """Use also rows that `needleforce force` has marked as not tared, initializing or doubtful."""


@Parameter(name="*", group=OUTPUT)
@dataclass(frozen=True, kw_only=True)
class SimulationOptions:
    """What is simulated, and where it goes."""

    output: Annotated[Path | None, Parameter(name=("--output", "-o"), metavar="FILE")] = None
    """Recording: .csv, .npz, .parquet, or .mcap, a ROS 2 bag."""
    truth: Annotated[Path | None, Parameter(metavar="FILE")] = None
    """Ground truth, which the robot does not know: forces, depth, layers, ruptures."""
    plant: Literal["ideal", "clean", "fri", "degraded"] = "clean"
    """Plant model: how good arm and sensors are (default: clean)."""
    seed: Annotated[int, Parameter(metavar="N")] = 0
    """Of everything that is drawn at random (default: 0)."""
    list: bool = False
    """Print the scenarios and stop."""


@Parameter(name="*", group=LOG)
@dataclass(frozen=True, kw_only=True)
class LiveOptions:
    """How long an arm is listened to."""

    seconds: Annotated[float, Parameter(metavar="S")] = float("inf")
    """Stop after so long; else at Ctrl-C or when the arm stays away."""
    tare: Annotated[float, Parameter(metavar="S", group=TARE)] = 4.0
    """Of `live`: tare after so many seconds of motion without contact, and again after as many
    where that is refused."""


ArmName = Annotated[
    str,
    Parameter(
        name="ARM",
        group=LOG,
        help="fri or fri:PORT (KUKA LWR 4+ that sends to this machine), franka:ADDRESS, "
        "ur:ADDRESS, or sim:SCENARIO for a simulated one.",
    ),
]

# The commands.

app = App(
    name="needleforce",
    help="Needle-tip force from a robot's joint torques, and the layers that the needle passes.",
    default_parameter=Parameter(negative=(), show_default=False),
    help_format="markdown",
    version_flags=["--version"],
    group_parameters=LOG,
    group_arguments=LOG,
)
app.register_install_completion_command(help="Install completion for bash, zsh or fish.")


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command with its arguments, or those of the process, and return its exit code."""

    def dispatch() -> int:
        tokens = list(sys.argv[1:] if argv is None else argv)
        try:
            command, bound, _ = app.parse_args(tokens, exit_on_error=False, print_error=False)
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
    output: Output = Output(),
    robot: RobotOptions = RobotOptions(),
    sensor: SensorOptions = SensorOptions(),
    columns: JointColumns = JointColumns(),
) -> int:
    """Estimate the force on a needle from a robot's recorded joint signals.

    Read a log with time, q, tau and perhaps dq. The estimates are good once the sensor was tared
    on motion without contact. Without --tare and --no-tare, the first 2 s after the filters have
    settled are taken for such motion; if contact is seen there, the command stops and says so.

    needleforce force insertion.csv --tare 0:4 -o forces.csv --figure forces.png
    """
    from needleforce.cli.force import run

    return run(log, output, robot, sensor, columns)


@app.command(name="identify")
def identify_command(
    log: Source,
    /,
    *,
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

    return run(log, output, options, columns)


@app.command(name="report")
def report_command(
    log: Source,
    folder: Annotated[Path, Parameter(name="DIR", group=LOG, help="Made if it is not there.")],
    /,
    *,
    robot: RobotOptions = RobotOptions(),
    sensor: SensorOptions = SensorOptions(),
    options: IdentificationOptions = IdentificationOptions(),
    columns: AllColumns = AllColumns(),
) -> int:
    """Write a page with charts, results, warnings and settings of a log into a folder.

    A log with joint positions and torques gives the forces, as `needleforce force` does, and the
    layers that they show, as `needleforce identify` does; one with depth and force the layers.
    DIR/index.html needs no other file.

    needleforce report insertion.csv report
    """
    from needleforce.cli import force, identify
    from needleforce.cli.log import has_channels

    output = Output(report=folder)
    if has_channels(log, columns, ("q", "tau_ext" if sensor.external_torque else "tau")):
        return force.run(log, output, robot, sensor, columns, options)
    return identify.run(log, output, options, columns)


@app.command(name="demo")
def demo_command(
    kind: Annotated[
        Literal["guidance", "teleop", "autonomous", "rcm", "abdomen"],
        Parameter(name="KIND", group=LOG),
    ],
    /,
    *,
    report: Annotated[Path | None, Parameter(metavar="DIR", group=OUTPUT)] = None,
    figure: Annotated[Path | None, Parameter(metavar="FILE", group=OUTPUT)] = None,
    data: Annotated[
        Path | None,
        Parameter(
            metavar="DIR",
            group=LOG,
            help="Of abdomen: folder with ct.nii.gz and labels.nii.gz; else an analytic torso.",
        ),
    ] = None,
    seed: Annotated[int, Parameter(metavar="N", group=LOG, help="Of abdomen.")] = 0,
) -> int:
    """Show the needle moved in closed loop on the simulated arm, or planned on a CT (abdomen).

    Prints a table, and writes a page into DIR; --figure writes the first picture alone. Simulation
    only: not a medical device.

    needleforce demo teleop --report demo
    """
    if kind == "abdomen":
        from needleforce.cli import demo_abdomen

        return demo_abdomen.run(report, figure, data, seed)
    from needleforce.cli.demo import run

    return run(kind, report, figure)


@app.command(name="record")
def record_command(
    arm: ArmName,
    /,
    *,
    output: Annotated[
        Path, Parameter(name=("--output", "-o"), metavar="FILE", group=OUTPUT, help="Recording.")
    ],
    options: LiveOptions = LiveOptions(),
    robot: RobotOptions = RobotOptions(),
) -> int:
    """Write an arm's joint signals into a recording as they come, until Ctrl-C.

    needleforce record fri -o insertion.mcap
    """
    from needleforce.cli.live import record

    return record(arm, output, options, robot)


@app.command(name="live")
def live_command(
    arm: ArmName,
    /,
    *,
    options: LiveOptions = LiveOptions(),
    robot: RobotOptions = RobotOptions(),
) -> int:
    """Watch an arm: force on the needle, tip force, depth, ruptures, warnings, until Ctrl-C.

    Move the needle in free air first: the tare is taken after --tare seconds of that.

    needleforce live sim:stack-glove-constant
    """
    from needleforce.cli.live import watch

    return watch(arm, options, robot)
