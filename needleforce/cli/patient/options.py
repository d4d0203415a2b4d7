"""Options of the commands on a patient; see `needleforce.cli.shared_options`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Group, Parameter

CT = Group("Patient", sort_key=1)
LIMITS = Group("Limits of the path", sort_key=3)
REGISTRATION = Group("Registration", sort_key=2)
TOUCHES = Group("Touches", sort_key=2)


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
