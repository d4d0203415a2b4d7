"""The command `needleforce plan`."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from needleforce.cli.application import LIVE_OUTPUT, PATIENT, app
from needleforce.cli.patient.options import CaseOptions, LimitOptions


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
