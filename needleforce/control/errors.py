"""Errors of `needleforce.control`, and checks of settings that raise them.

What passes a check is finite, and of the expected sign and size.
"""

import math
from collections.abc import Container, Mapping

import numpy as np
from numpy.typing import ArrayLike

from foundation.arrays import Array
from foundation.errors import NeedleforceError
from residual.checks.input import as_float


class ControlError(NeedleforceError):
    """Base of the errors of this package; those of the estimators pass through."""


class SettingError(ControlError, ValueError):
    """A setting that cannot work: the message names it, what came and what is valid."""


def require_positive(
    settings: Mapping[str, object], or_zero: Container[str] = ()
) -> None:
    """Refuse settings that are not finite and positive.

    Args:
        settings: Their values by name.
        or_zero: Names of those that may be zero.

    Raises:
        SettingError: The first one that is refused.
    """
    for name, value in settings.items():
        number = as_float(value)
        if not (0.0 < number < math.inf or (number == 0.0 and name in or_zero)):
            raise SettingError(f"{name} is {value!r}, expected a positive number")


def as_vector(value: ArrayLike, size: int, name: str) -> Array:
    """Return numbers in an array of their own, shape (size,).

    Raises:
        SettingError: There are more or fewer numbers, or one is not finite.
    """
    try:
        numbers = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        numbers = np.zeros(0)
    if numbers.shape != (size,) or not np.isfinite(numbers).all():
        raise SettingError(f"{name} is {value!r}, expected {size} finite numbers")
    return numbers
