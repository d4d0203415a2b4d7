"""Errors of `needleforce.control`: one base; each of the others is also a standard
exception.
"""

import math
from collections.abc import Container, Mapping

from residual.checks.input import as_float


class ControlError(Exception):
    """Base of the errors of this package; those of the estimators pass through."""


class SettingError(ControlError, ValueError):
    """A setting that cannot work: the message names it, what came and what is valid."""


def require_positive(
    settings: Mapping[str, object], or_zero: Container[str] = ()
) -> None:
    """Refuse what is not a finite, positive number."""
    for name, value in settings.items():
        number = as_float(value)
        if not (0.0 < number < math.inf or (number == 0.0 and name in or_zero)):
            raise SettingError(f"{name} is {value!r}, expected a positive number")
