"""Errors of anatomy: one base; each of the others is also a standard exception."""

from foundation.errors import NeedleforceError

ONE_SERIES = "Put all slices of one series, and nothing else, into a folder of its own."
EXPORT_VOLUME = (
    "Export the volume again, as .nii.gz or .nrrd, in millimetres and unsheared."
)
COPY_AGAIN = "Copy or export it again."
EXPORT_LABELS = "Correct the segmentation and export it as .seg.nrrd or .nii.gz."
LABELS_OF_SCAN = (
    "Give the labels of this scan, with their origin, spacing and directions."
)
SAVE_MARKUPS = "Save one list of points, or one line, from 3D Slicer as .mrk.json."
SAVE_TRANSFORM = "Save a rigid transform, in millimetres, as .h5 or .tfm."
TWO_POINTS = "Give two different points inside the volume, in metres."
OTHER_PATH = (
    "Plan another path; name an obstacle that the needle is meant to touch among "
    "the plan's accepted obstacles."
)
TOUCH_LANDMARKS = (
    "Touch three or more landmarks that are not on one line, in the order of the "
    "model, in metres."
)
TOUCH_MORE = "Touch more of the surface, spread over it, and give metres."


class AnatomyError(NeedleforceError):
    """Base of all errors of this package."""

    usual_advice = (
        "Export it again, as .nii, .nii.gz, .nrrd or .seg.nrrd, or give the "
        "folder of a DICOM series."
    )


class VolumeError(AnatomyError, ValueError):
    """A volume, a segmentation or a path that cannot be read or contradicts another."""


class RegistrationError(AnatomyError, ValueError):
    """A registration that is refused; the message says why and what would help."""

    usual_advice = TOUCH_LANDMARKS


class PlanError(AnatomyError, ValueError):
    """A plan that cannot be matched with ruptures."""

    usual_advice = "Give two or more layers, and finite depths that grow, in metres."


def require_deviation(name: str, value_m: float, error: type[AnatomyError]) -> None:
    """Refuse a standard deviation that is none, or in millimetres."""
    max_deviation_m = 0.1  # a larger standard deviation is one in millimetres
    if not 0.0 < value_m < max_deviation_m:
        raise error(
            f"{name}={value_m!r}: expected a positive standard deviation in metres, "
            "below 0.1",
        )
