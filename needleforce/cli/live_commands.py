"""The commands `record`, `live`, `view` and `demo`, and their options."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Group, Parameter

from needleforce.cli.options import LOG, TARE, RobotOptions, app

OUTPUT = Group("Output", sort_key=2)

LWR = RobotOptions()  # The arm unless another is named


Constants = tuple[float, float, float, float, float, float]


@Parameter(name="*", group=LOG)
@dataclass(frozen=True, kw_only=True)
class LiveOptions:
    """How long an arm is listened to."""

    seconds: Annotated[float, Parameter(metavar="S")] = float("inf")
    """Stop after so long; else at Ctrl-C or when the arm stays away."""
    motor_constants: Annotated[Constants | None, Parameter(metavar="K1 ... K6")] = None
    """Of ur: joint torque per motor current of each joint [Nm/A]; a UR sends no torques
    (docs/panda.md)."""


@Parameter(name="*", group=OUTPUT)
@dataclass(frozen=True, kw_only=True)
class WatchOptions:
    """What an arm is watched with."""

    plan: Annotated[Path | None, Parameter(metavar="FILE", group=LOG)] = None
    """Plan to match ruptures with (plan.json, or its folder): see docs/scene.md."""
    reference: Annotated[str | None, Parameter(metavar="ADDRESS", group=LOG)] = None
    """ATI Net F/T between flange and tool: its axial force, and the rms difference since the tare,
    are shown next to the estimate."""
    reference_axis: Annotated[tuple[float, float, float], Parameter(metavar="X Y Z", group=LOG)] = (
        0.0,
        0.0,
        1.0,
    )
    """Direction of insertion in that sensor's axes (default: 0 0 1)."""
    view: Annotated[bool, Parameter(negative="")] = False
    """Open the scene in a browser page beside the session."""
    port: Annotated[int, Parameter(metavar="N")] = 8080
    """Its port (default: 8080); another is taken if it is busy."""
    tare: Annotated[float, Parameter(metavar="S", group=TARE)] = 4.0
    """Tare after so many seconds of motion without contact (default: 4), and again after as many
    where that is refused."""


@Parameter(name="*", group=LOG)
@dataclass(frozen=True, kw_only=True)
class ViewOptions:
    """What is shown beside a recording, and where."""

    anatomy: Annotated[Path | None, Parameter(metavar="DIR")] = None
    """Folder with plan.json and labels.nii.gz (or .nrrd, .seg.nrrd): see docs/scene.md."""
    mapping: Annotated[str | None, Parameter(metavar="FILE")] = None
    """TOML file that says which columns are which, as `needleforce force --print-config` writes."""
    tare: Annotated[float, Parameter(metavar="S", group=TARE)] = 4.0
    """Tare after so many seconds of motion without contact (default: 4), and again after as many
    where that is refused."""
    export: Annotated[Path | None, Parameter(metavar="FILE", group=OUTPUT)] = None
    """Write the scene as one page (.html) with the insertion as a film, and end."""
    host: Annotated[str, Parameter(metavar="ADDRESS", group=OUTPUT)] = "127.0.0.1"
    """Where the page is served (default: 127.0.0.1, this machine alone)."""
    port: Annotated[int, Parameter(metavar="N", group=OUTPUT)] = 8080
    """Its port (default: 8080); another is taken if it is busy."""


ArmName = Annotated[
    str,
    Parameter(
        name="ARM",
        group=LOG,
        help="fri or fri:PORT (KUKA LWR 4+ that sends to this machine), franka:ADDRESS, "
        "ur:ADDRESS, or sim:SCENARIO for a simulated LWR 4+. A franka is taken for a panda and a "
        "ur for a ur10e unless --robot or --urdf names another.",
    ),
]


@app.command(name="view")
def view_command(
    recording: Annotated[Path, Parameter(name="RECORDING", group=LOG)],
    /,
    *,
    options: ViewOptions = ViewOptions(),
    robot: RobotOptions = LWR,
) -> int:
    """Show a recording of joint signals in a 3-D scene: a page for the browser, until Ctrl-C.

    needleforce view insertion.csv --tare 13
    """
    from needleforce.cli.live_view import run

    return run(recording, options, robot)


@app.command(name="record")
def record_command(
    arm: ArmName,
    /,
    *,
    output: Annotated[
        Path, Parameter(name=("--output", "-o"), metavar="FILE", group=OUTPUT, help="Recording.")
    ],
    options: LiveOptions = LiveOptions(),
    robot: RobotOptions = LWR,
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
    watch: WatchOptions = WatchOptions(),
    robot: RobotOptions = LWR,
) -> int:
    """Watch an arm: force on the needle, tip force, depth, ruptures, warnings, until Ctrl-C.

    Move the needle in free air first: the tare is taken after --tare seconds of that.

    needleforce live sim:stack-glove-constant --view
    """
    from needleforce.cli.live import watch_arm

    return watch_arm(arm, options, watch, robot)


@app.command(name="demo")
def demo_command(
    kind: Annotated[
        Literal["guidance", "teleop", "autonomous", "rcm", "abdomen"],
        Parameter(name="KIND", group=LOG),
    ],
    /,
    *,
    report: Annotated[
        Path | None, Parameter(metavar="DIR", group=OUTPUT, help="Folder for a page.")
    ] = None,
    figure: Annotated[
        Path | None,
        Parameter(metavar="FILE", group=OUTPUT, help="Its first picture: .png, .svg or .pdf."),
    ] = None,
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
        from needleforce.cli import demo_abdomen_page

        return demo_abdomen_page.run(report, figure, data, seed)
    from needleforce.cli.demo import run

    return run(kind, report, figure)
