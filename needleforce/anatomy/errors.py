"""Errors of anatomy: one base; each of the others is also a standard exception."""

from foundation.errors import NeedleforceError

OTHER_PATH = (
    "Plan another path; name an obstacle that the needle is meant to touch among "
    "the plan's accepted obstacles."
)


class AnatomyError(NeedleforceError):
    """Base of all errors of this package."""


class VolumeError(AnatomyError, ValueError):
    """A volume, a segmentation or a path that cannot be read or contradicts another."""

    usual_advice = (
        "Export it again, in millimetres, with its origin and directions, as .nii, "
        ".nii.gz, .nrrd, .mha or .seg.nrrd, or give the folder of one DICOM series."
    )


class RegistrationError(AnatomyError, ValueError):
    """A registration that is refused; the message says why."""

    usual_advice = (
        "Touch three or more landmarks that are not on one line, in the order of the "
        "model, then the surface, spread widely; hold the patient still; give metres."
    )


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
