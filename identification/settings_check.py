"""What a configuration may be set to: the one place where figures are refused."""

import math
import numbers

from identification.errors import InvalidConfigError


def check_finite(name: str, value: object) -> None:
    """Refuse a figure that is not a finite number.

    Raises:
        InvalidConfigError: With the name and what came.
    """
    if not _is_finite(value):
        raise InvalidConfigError(f"{name} must be a finite number, got {value!r}")


def check_positive(name: str, value: object) -> None:
    """Refuse a figure that is not a finite number above zero.

    Raises:
        InvalidConfigError: With the name and what came.
    """
    if not (_is_finite(value) and value > 0):  # type: ignore[operator]
        raise InvalidConfigError(f"{name} must be positive and finite, got {value!r}")


def check_kind(name: str, value: object, kind: type) -> None:
    """Refuse a part of a configuration that is something else.

    Raises:
        InvalidConfigError: With the name, what came and what was expected.
    """
    if not isinstance(value, kind) or isinstance(value, bool):
        raise InvalidConfigError(f"{name} must be of type {kind.__name__}, got {value!r}")


def _is_finite(value: object) -> bool:
    if not isinstance(value, numbers.Real) or isinstance(value, bool):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:
        return False
