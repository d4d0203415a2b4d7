"""Range checks shared by the frozen descriptions of tissue, motion and noise."""

import math

from groundtruth.errors import GroundTruthError


def require_positive(error: type[GroundTruthError], **values: float) -> None:
    """Check that every named value is finite and above zero.

    Args:
        error: The error class to raise.
        **values: Field name (with its unit) and value.

    Raises:
        GroundTruthError: Of class `error`, naming the field, its value and what was expected.
    """
    for name, value in values.items():
        if not (math.isfinite(value) and value > 0.0):
            raise error(f"{name} is {value!r}; give a finite number above zero")


def require_non_negative(error: type[GroundTruthError], **values: float) -> None:
    """Check that every named value is finite and not negative.

    Args:
        error: The error class to raise.
        **values: Field name (with its unit) and value.

    Raises:
        GroundTruthError: Of class `error`, naming the field, its value and what was expected.
    """
    for name, value in values.items():
        if not (math.isfinite(value) and value >= 0.0):
            raise error(f"{name} is {value!r}; give a finite number, zero or above")


def require_share(error: type[GroundTruthError], **values: float) -> None:
    """Check that every named value is a share from 0 to 1.

    Args:
        error: The error class to raise.
        **values: Field name and value.

    Raises:
        GroundTruthError: Of class `error`, naming the field, its value and what was expected.
    """
    for name, value in values.items():
        if not 0.0 <= value <= 1.0:
            raise error(f"{name} is {value!r}; give a share from 0 to 1")
