"""The commands on a patient: `needleforce plan`, `touch`, `register`."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from needleforce.cli.application import LIVE_OUTPUT, LOG, PATIENT, app
from needleforce.cli.patient.options import (
    CaseOptions,
    LimitOptions,
    RegisterOptions,
    TouchOptions,
)
from needleforce.cli.shared_options import ArmName, ArmOptions, RobotOptions


@app.command(name="plan", group=PATIENT)
def plan_command(
    *,
    case: CaseOptions,
    limits: LimitOptions = LimitOptions(),
    output: Annotated[
        Path,
        Parameter(
            name=("--output", "-o"),
            metavar="DIR",
            group=LIVE_OUTPUT,
            help="Folder for plan.json, path.mrk.json for 3D Slicer and a page "
            "(default: plan).",
        ),
    ] = Path("plan"),
) -> int:
    """Find straight paths from the skin to a target in a CT, ranked.

    The table has length, angle to the skin, clearance of structures at risk, and the
    layers crossed. Not a medical device.

    needleforce plan --ct ct/ --labels segmentation.nii.gz --target lesion -o plan
    """
    from needleforce.cli.patient.plan_run import plan_paths

    return plan_paths(case, limits, output)


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


@app.command(name="register", group=PATIENT)
def register_command(
    *,
    plan: Annotated[
        Path,
        Parameter(
            metavar="FILE", group=LOG, help="Plan that `needleforce plan` wrote."
        ),
    ],
    output: Annotated[
        Path,
        Parameter(
            name=("--output", "-o"),
            metavar="FILE",
            group=LIVE_OUTPUT,
            help="The plan with its registration; the same file is replaced.",
        ),
    ],
    options: RegisterOptions = RegisterOptions(),
) -> int:
    """Find where the patient of a plan lies in the robot's base.

    By landmarks and touches of the skin together. What does not fit is refused, with
    the reason: a patient who moved, too. Not a medical device.

    needleforce register --plan plan/plan.json --landmarks landmarks.mrk.json --touches
    touches.json -o plan/plan.json
    """
    from needleforce.cli.patient.register_run import register_plan

    return register_plan(plan, options, output)
