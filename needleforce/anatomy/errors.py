"""Errors of anatomy: one base; each of the others is also a standard exception.
Arrays.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class AnatomyError(Exception):
    """Base of all errors of this package."""


class VolumeError(AnatomyError, ValueError):
    """A volume, a segmentation or a path that cannot be read, or contradicts itself
    or another.
    """


class RegistrationError(AnatomyError, ValueError):
    """A registration that is refused; the message says why and what would help."""


class PlanError(AnatomyError, ValueError):
    """A plan that cannot be matched with ruptures."""


def require_deviation(name: str, value_m: float, error: type[AnatomyError]) -> None:
    """Refuse a standard deviation that is none, or in millimetres."""
    if not 0.0 < value_m < 0.1:
        raise error(
            f"{name}={value_m!r}: expected a positive standard deviation in metres, below 0.1"
        )
