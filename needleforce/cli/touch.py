"""The command `needleforce touch`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Group, Parameter

from needleforce.cli.application import LIVE_OUTPUT, PATIENT, app
from needleforce.cli.shared_options import ArmName, ArmOptions, RobotOptions

TOUCHES = Group("Touches", sort_key=2)


@Parameter(name="*", group=TOUCHES)
@dataclass(frozen=True, kw_only=True)
class TouchOptions:
    """What is touched.

    Attributes:
        landmarks: Points of the CT (.mrk.json): they are touched first, in the file's
            order; what is touched after them counts as skin.
        count: End after so many touches of the skin (default: 40).
        contact: Least force of a contact, in newtons, over that of the free needle
            (default: 0.5).
    """

    landmarks: Annotated[Path | None, Parameter(metavar="FILE")] = None
    count: Annotated[int, Parameter(metavar="N")] = 40
    contact: Annotated[float, Parameter(metavar="N")] = 0.5


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

    return record_touches(
        arm,
        output,
        options,
        robot,
        landmarks=touch.landmarks,
        count=touch.count,
        contact_N=touch.contact,
    )
