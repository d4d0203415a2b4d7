"""The command `needleforce record`."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from needleforce.cli.application import ARMS, LIVE_OUTPUT, app
from needleforce.cli.loop_threads import limit_library_threads
from needleforce.cli.shared_options import ArmName, ArmOptions, RobotOptions


@app.command(name="record", group=ARMS)
def record_command(
    arm: ArmName,
    /,
    *,
    output: Annotated[
        Path,
        Parameter(
            name=("--output", "-o"),
            metavar="FILE",
            group=LIVE_OUTPUT,
            help="Recording: .csv, .npz, .parquet, or .mcap, a ROS 2 bag.",
        ),
    ],
    overwrite: Annotated[
        bool,
        Parameter(negative="", group=LIVE_OUTPUT, help="Replace a file that is there."),
    ] = False,
    options: ArmOptions = ArmOptions(),
    robot: RobotOptions = RobotOptions(),
) -> int:
    """Write an arm's joint signals into a recording as they come, until Ctrl-C.

    needleforce record fri -o insertion.mcap
    """
    limit_library_threads()
    from needleforce.cli.arms.arm_recording import record_signals

    return record_signals(arm, output, options, robot, overwrites=overwrite)
