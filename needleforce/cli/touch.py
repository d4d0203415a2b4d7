"""The command `needleforce touch`."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from needleforce.cli.application import LIVE_OUTPUT, PATIENT, app
from needleforce.cli.patient.options import TouchOptions
from needleforce.cli.shared_options import ArmName, ArmOptions, RobotOptions


@app.command(name="touch", group=PATIENT)
def touch_command(
    arm: ArmName,
    /,
    *,
    output: Annotated[
        Path,
        Parameter(
            name=("--output", "-o"),
            metavar="FILE",
            group=LIVE_OUTPUT,
            help="What was touched (default: touches.json).",
        ),
    ] = Path("touches.json"),
    touch: TouchOptions = TouchOptions(),
    options: ArmOptions = ArmOptions(),
    robot: RobotOptions = RobotOptions(),
) -> int:
    """Record what the needle's tip touches: landmarks, then the skin.

    Rest in contact for a second, or press Enter; u and Enter undoes the last one, q and
    Enter ends. sim:PLAN.json is a simulated arm that touches the patient of a plan.

    needleforce touch fri --landmarks landmarks.mrk.json -o touches.json
    """
    from needleforce.cli.patient.touch_run import record_touches

    return record_touches(arm, output, touch, options, robot)
