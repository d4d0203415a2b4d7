"""The commands `record`, `live`, `view` and `demo`."""

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from needleforce.cli.live_options import (
    OUTPUT,
    DemoOptions,
    LiveOptions,
    ViewOptions,
    WatchOptions,
)
from needleforce.cli.options import LOG, RobotOptions, app

LWR = RobotOptions()  # The arm unless another is named


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
    """Show a recording of joint signals in a 3-D scene: a page for the browser, until
    Ctrl-C.

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
        Path,
        Parameter(
            name=("--output", "-o"), metavar="FILE", group=OUTPUT, help="Recording."
        ),
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
    """Watch an arm: force on the needle, tip force, depth, ruptures, warnings, until
    Ctrl-C.

    Move the needle in free air first: the tare is taken after --tare seconds.

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
    options: DemoOptions = DemoOptions(),
) -> int:
    """Show the needle moved in closed loop on the simulated arm, or planned on a CT
    (abdomen).

    Prints a table and writes a page into DIR; --figure writes its first figure alone.
    Simulation only: not a medical device.

    needleforce demo teleop --report demo
    """
    if kind == "abdomen":
        from needleforce.cli import demo_abdomen_page

        return demo_abdomen_page.run(options)
    from needleforce.cli.demo import run

    return run(kind, options)
