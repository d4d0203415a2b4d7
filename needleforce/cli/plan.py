"""The command `needleforce plan`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Group, Parameter

from needleforce.cli.application import LIVE_OUTPUT, PATIENT, app

CT = Group("Patient", sort_key=1)
LIMITS = Group("Limits of the path", sort_key=3)


@Parameter(name="*", group=CT)
@dataclass(frozen=True, kw_only=True)
class CaseOptions:
    """The patient, and where the needle shall go.

    Attributes:
        ct: CT: folder with one DICOM series, .nii.gz or .nrrd.
        labels: Segmentation of that CT: .nii.gz, .nrrd, .seg.nrrd, or DICOM SEG.
        target: Name of a structure, whose innermost point is the target; or points or a
            line of 3D Slicer (.mrk.json): the first point is the target, a line is the
            path.
        structures: What structures are that the segmentation does not name:
            label_5=liver,Segment_2=rib; or a JSON file ({"5": "liver"}).
        situs_inversus: Liver and spleen of this patient are exchanged.
    """

    ct: Annotated[Path, Parameter(metavar="DIR|FILE")]
    labels: Annotated[Path, Parameter(metavar="DIR|FILE")]
    target: Annotated[str, Parameter(metavar="STRUCTURE|FILE")]
    structures: Annotated[str | None, Parameter(metavar="NAME=KIND,...|FILE")] = None
    situs_inversus: Annotated[bool, Parameter(negative="")] = False


@Parameter(name="*", group=LIMITS)
@dataclass(frozen=True, kw_only=True)
class LimitOptions:
    """What a path may be.

    Attributes:
        avoid: Structures that must stay clear of the path, beside bone, cartilage,
            lungs, vessels, bowel and others at risk by their names.
        passable: Structures that the needle may pass: at risk by their names, or with
            names that say nothing; dense_as_bone for what is dense in the CT and not
            labelled. No bone.
        radius: Radius of the needle in millimetres (default: 0.8, of 18 G with its
            sheath).
        margin: Distance in millimetres that stays free around the needle (default: 5).
        max_length: Longest path in millimetres (default: 120).
        cone: Largest angle in degrees between the path and the skin's normal (default:
            35).
        choose: Number of the path, in the table, that becomes the plan (default: 1).
    """

    avoid: Annotated[
        tuple[str, ...], Parameter(metavar="STRUCTURE", consume_multiple=True)
    ] = ()
    passable: Annotated[
        tuple[str, ...], Parameter(metavar="STRUCTURE", consume_multiple=True)
    ] = ()
    radius: Annotated[float, Parameter(metavar="MM")] = 0.8
    margin: Annotated[float, Parameter(metavar="MM")] = 5.0
    max_length: Annotated[float, Parameter(metavar="MM")] = 120.0
    cone: Annotated[float, Parameter(metavar="DEG")] = 35.0
    choose: Annotated[int, Parameter(metavar="N")] = 1


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
    from needleforce.cli.patient.case_files import CaseFiles
    from needleforce.cli.patient.plan_run import plan_paths
    from needleforce.cli.patient.structure_names import parse_structures

    files = CaseFiles(
        case.ct, case.labels, parse_structures(case.structures), case.situs_inversus
    )
    return plan_paths(files, case.target, limits, output)
