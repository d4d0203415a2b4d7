"""The command `needleforce lag`."""

from typing import Annotated

from cyclopts import Parameter

from needleforce.cli.application import ARMS, LIVE_OUTPUT, app
from needleforce.cli.loop_threads import limit_library_threads
from needleforce.cli.shared_options import MovedArmName, RobotOptions


@app.command(name="lag", group=ARMS)
def lag_command(
    arm: MovedArmName,
    /,
    *,
    yes: Annotated[
        bool, Parameter(group=LIVE_OUTPUT, help="Move the arm without asking.")
    ] = False,
    json: Annotated[bool, Parameter(group=LIVE_OUTPUT, help="Print JSON.")] = False,
    robot: RobotOptions = RobotOptions(),
) -> int:
    """Measure the delay from command to motion, and print the largest safe gain.

    All joints move for 4 s by a chirp of 1 to 6 Hz, the tip by at most 5 mm either way:
    keep the needle in free air. A gain K is stable while K (T + h/2) < pi/2, with T the
    delay and h the cycle; the safe one keeps a phase margin of 55 degrees.

    needleforce lag sim --yes
    """
    limit_library_threads()
    from needleforce.cli.arms.arm_lag import measure_arm

    return measure_arm(arm, robot, is_confirmed=yes, as_json=json)
