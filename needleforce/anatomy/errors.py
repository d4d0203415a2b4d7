"""Errors of anatomy: one base; each of the others is also a standard exception."""


class AnatomyError(Exception):
    """Base of all errors of this package."""


class VolumeError(AnatomyError, ValueError):
    """A volume, a segmentation or a path that cannot be read or contradicts another."""


class RegistrationError(AnatomyError, ValueError):
    """A registration that is refused; the message says why and what would help."""


class PlanError(AnatomyError, ValueError):
    """A plan that cannot be matched with ruptures."""


MAX_DEVIATION_m = 0.1
"""A larger standard deviation is one in millimetres."""


def require_deviation(name: str, value_m: float, error: type[AnatomyError]) -> None:
    """Refuse a standard deviation that is none, or in millimetres."""
    if not 0.0 < value_m < MAX_DEVIATION_m:
        raise error(
            f"{name}={value_m!r}: expected a positive standard deviation in metres, "
            "below 0.1"
        )
