"""Range checks shared by the frozen descriptions of tissue, motion and noise."""

import math
from collections.abc import Callable, Mapping

from groundtruth.errors import GroundTruthError


def require_positive(error: type[GroundTruthError], **values: float) -> None:
    """Check that every named value is finite and above zero.

    Args:
        error: The error class to raise.
        **values: Field name (with its unit) and value.

    Raises:
        GroundTruthError: Of class `error`, naming the field, its value and what was expected.
    """
    _require(error, values, lambda v: math.isfinite(v) and v > 0.0, "a finite number above zero")


def require_non_negative(error: type[GroundTruthError], **values: float) -> None:
    """Check that every named value is finite and not negative; else as `require_positive`."""
    _require(
        error, values, lambda v: math.isfinite(v) and v >= 0.0, "a finite number, zero or above"
    )


def require_share(error: type[GroundTruthError], **values: float) -> None:
    """Check that every named value is a share from 0 to 1; else as `require_positive`."""
    _require(error, values, lambda v: 0.0 <= v <= 1.0, "a share from 0 to 1")


def _require(
    error: type[GroundTruthError],
    values: Mapping[str, float],
    is_valid: Callable[[float], bool],
    wanted: str,
) -> None:
    for name, value in values.items():
        if not is_valid(value):
            raise error(f"{name} is {value!r}; give {wanted}")
