"""The command `needleforce register`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Group, Parameter

from needleforce.cli.application import LIVE_OUTPUT, LOG, PATIENT, app

REGISTRATION = Group("Registration", sort_key=2)


@Parameter(name="*", group=REGISTRATION)
@dataclass(frozen=True, kw_only=True)
class RegisterOptions:
    """What the registration rests on.

    Attributes:
        landmarks: Points of the CT (.mrk.json), with the names of those touched.
        touches: What `needleforce touch` recorded.
        transform: In place of landmarks: a rigid transform from the CT to the robot's
            base (.h5, .tfm), which touches of the skin check.
        transform_from: Who wrote it: slicer, or itk (TransformPoint carries points of
            the CT to the base).
        transform_std: Its standard deviation at the patient along each axis, in
            millimetres.
        landmark_std: Standard deviation of a landmark along each axis in millimetres,
            localisation in the CT included (default: 1.5).
        touch_std: Standard deviation of a touch of the skin, likewise (default: 0.5).
        softness: By up to so many millimetres touches press the skin in (default: 3);
            how far they do is estimated.
        motion: Standard deviation of what organs move against the skin, in millimetres
            (default: 3).
        landmarks_only: Leave the touches of the skin out.
        negate_xy: Negate x and y of the landmarks: their file says LPS and holds RAS,
            or the reverse.
    """

    landmarks: Annotated[Path | None, Parameter(metavar="FILE")] = None
    touches: Annotated[Path | None, Parameter(metavar="FILE")] = None
    transform: Annotated[Path | None, Parameter(metavar="FILE")] = None
    transform_from: Annotated[Literal["slicer", "itk"] | None, Parameter()] = None
    transform_std: Annotated[float | None, Parameter(metavar="MM")] = None
    landmark_std: Annotated[float, Parameter(metavar="MM")] = 1.5
    touch_std: Annotated[float, Parameter(metavar="MM")] = 0.5
    softness: Annotated[float, Parameter(metavar="MM")] = 3.0
    motion: Annotated[float, Parameter(metavar="MM")] = 3.0
    landmarks_only: Annotated[bool, Parameter(negative="")] = False
    negate_xy: Annotated[bool, Parameter(negative="")] = False


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
