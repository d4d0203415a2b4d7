"""Errors of anatomy: one base; each of the others is also a standard exception."""

from foundation.errors import ErrorCode, NeedleforceError


class AnatomyCode(ErrorCode):
    """Kinds of errors of volumes, registrations and plans."""

    VOLUME = (
        "NF-ANATOMY-VOLUME",
        "A file holds no volume that can be read.",
        "Export it again, as .nii, .nii.gz, .nrrd or .seg.nrrd, or give the folder of "
        "a DICOM series.",
    )
    SERIES = (
        "NF-ANATOMY-SERIES",
        "The slices in a folder are not those of one complete DICOM series.",
        "Put all slices of one series, and nothing else, into a folder of its own.",
    )
    GEOMETRY = (
        "NF-ANATOMY-GEOMETRY",
        "The file does not say, or contradicts itself on, how the volume lies.",
        "Export the volume again, as .nii.gz or .nrrd, in millimetres and unsheared.",
    )
    DAMAGED = (
        "NF-ANATOMY-DAMAGED",
        "The file ends early or is damaged.",
        "Copy or export it again.",
    )
    SIZE = (
        "NF-ANATOMY-SIZE",
        "The volume takes more memory than it may.",
        "Crop or resample it, or store it in a smaller type.",
    )
    LABELS = (
        "NF-ANATOMY-LABELS",
        "The segmentation has no structures, or its labels or names contradict each "
        "other.",
        "Correct the segmentation and export it as .seg.nrrd or .nii.gz.",
    )
    STRUCTURE = (
        "NF-ANATOMY-STRUCTURE",
        "The segmentation has no structure of that name.",
        "Give one of the names that the message lists.",
    )
    OTHER_SCAN = (
        "NF-ANATOMY-OTHER-SCAN",
        "The labels do not lie where the scan lies.",
        "Give the labels of this scan, with their origin, spacing and directions.",
    )
    ORDER = (
        "NF-ANATOMY-ORDER",
        "Structures lie the wrong way round in the body.",
        "Export labels and scan again with their directions; where the patient's "
        "organs are exchanged, state the situs inversus.",
    )
    MARKUPS = (
        "NF-ANATOMY-MARKUPS",
        "The file of points or of a line cannot be read, or says too little.",
        "Save one list of points, or one line, from 3D Slicer as .mrk.json.",
    )
    TRANSFORM = (
        "NF-ANATOMY-TRANSFORM",
        "The file holds no rigid motion from the CT to the robot's base.",
        "Save a rigid transform, in millimetres, as .h5 or .tfm.",
    )
    MISFITTING_TRANSFORM = (
        "NF-ANATOMY-TRANSFORM-MISFIT",
        "Touches of the skin contradict the transform.",
        "Name the other source if the transform may be the inverse; check that it "
        "belongs to this CT and that the patient has not moved, or register by "
        "landmarks.",
    )
    NO_PATH = (
        "NF-ANATOMY-NO-PATH",
        "No straight path leads from the skin to the target within the limits.",
        "Allow a longer or a flatter path or a smaller margin, avoid less, or choose "
        "another target.",
    )
    SCAN = (
        "NF-ANATOMY-SCAN",
        "The scan shows no body in air.",
        "Give a CT in Hounsfield units that holds air around the patient.",
    )
    PATH = (
        "NF-ANATOMY-PATH",
        "Entry and target make no path through the volume.",
        "Give two different points inside the volume, in metres.",
    )
    OBSTACLE = (
        "NF-ANATOMY-OBSTACLE",
        "The path comes too near to bone or cartilage.",
        "Plan another path; name an obstacle that the needle is meant to touch among "
        "the plan's accepted obstacles.",
    )
    DEVIATION = (
        "NF-ANATOMY-DEVIATION",
        "A standard deviation is not positive, or is in millimetres.",
        "Give it in metres, above zero and below 0.1.",
    )
    LANDMARKS = (
        "NF-ANATOMY-LANDMARKS",
        "The landmarks cannot register the patient.",
        "Touch three or more landmarks that are not on one line, in the order of the "
        "model, in metres.",
    )
    MISFITTING_LANDMARKS = (
        "NF-ANATOMY-LANDMARKS-MISFIT",
        "The touched landmarks do not fit those of the model.",
        "Check the order and the place of the landmarks, touch them again, or give the "
        "`std_m` of a touch.",
    )
    TOUCHES = (
        "NF-ANATOMY-TOUCHES",
        "The touches are too few, too close together or not in metres.",
        "Touch more of the surface, spread over it, and give metres.",
    )
    MISFITTING_SURFACE = (
        "NF-ANATOMY-SURFACE-MISFIT",
        "The touches do not lie on the surface.",
        "Check that it is this organ and that the patient has not moved; register by "
        "landmarks again.",
    )
    AMBIGUOUS_SURFACE = (
        "NF-ANATOMY-SURFACE-AMBIGUOUS",
        "Another placement of the surface fits the touches as well.",
        "Touch a part with edges or another shape, or register by landmarks again.",
    )
    MOVED = (
        "NF-ANATOMY-MOVED",
        "Touches contradict the landmarks, or later touches earlier ones.",
        "Hold the patient still, and touch landmarks and skin again.",
    )
    PLAN = (
        "NF-ANATOMY-PLAN",
        "The plan, or a depth given to it, cannot be matched with ruptures.",
        "Give two or more layers, and finite depths that grow, in metres.",
    )


class AnatomyError(NeedleforceError):
    """Base of all errors of this package."""

    usual_code = AnatomyCode.VOLUME


class VolumeError(AnatomyError, ValueError):
    """A volume, a segmentation or a path that cannot be read or contradicts another."""


class RegistrationError(AnatomyError, ValueError):
    """A registration that is refused; the message says why and what would help."""

    usual_code = AnatomyCode.LANDMARKS


class PlanError(AnatomyError, ValueError):
    """A plan that cannot be matched with ruptures."""

    usual_code = AnatomyCode.PLAN


def require_deviation(name: str, value_m: float, error: type[AnatomyError]) -> None:
    """Refuse a standard deviation that is none, or in millimetres."""
    max_deviation_m = 0.1  # a larger standard deviation is one in millimetres
    if not 0.0 < value_m < max_deviation_m:
        raise error(
            f"{name}={value_m!r}: expected a positive standard deviation in metres, "
            "below 0.1",
            AnatomyCode.DEVIATION,
        )
