"""The command `needleforce register`."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from needleforce.cli.application import LIVE_OUTPUT, LOG, PATIENT, app
from needleforce.cli.patient.options import RegisterOptions


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
    report: Annotated[
        Path | None,
        Parameter(metavar="DIR", group=LIVE_OUTPUT, help="Folder for a page."),
    ] = None,
) -> int:
    """Find where the patient of a plan lies in the robot's base.

    By landmarks and touches of the skin together. What does not fit is refused, with
    the reason: a patient who moved, too. Not a medical device.

    needleforce register --plan plan/plan.json --landmarks landmarks.mrk.json --touches
    touches.json -o plan/plan.json
    """
    from needleforce.cli.patient.register_run import register_plan

    return register_plan(plan, options, output, report)
