"""Units that may stand in a file, each with its factor to SI."""

from collections.abc import Mapping
from math import pi
from types import MappingProxyType

from recordings.errors import MappingError

Units = Mapping[str, float]

TIME: Units = MappingProxyType({"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9})
ANGLE: Units = MappingProxyType({"rad": 1.0, "deg": pi / 180.0})
ANGULAR_SPEED: Units = MappingProxyType({"rad/s": 1.0, "deg/s": pi / 180.0})
TORQUE: Units = MappingProxyType({"Nm": 1.0, "mNm": 1e-3})
LENGTH: Units = MappingProxyType({"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6})
SPEED: Units = MappingProxyType({"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3, "um/s": 1e-6})
FORCE: Units = MappingProxyType({"N": 1.0, "mN": 1e-3})
CODE: Units = MappingProxyType({"1": 1.0})
"""A whole number that stands for something."""

# How people write the same unit; applied in this order.
_SPELLINGS = (("µ", "u"), ("μ", "u"), ("°", "deg"), ("N·m", "Nm"), ("N.m", "Nm"), ("N*m", "Nm"))
_SLASHES = ("_per_", "_")


def find_unit(text: str, units: Units) -> str | None:
    """Return the unit that `text` spells, or None.

    Args:
        text: a unit as found in a header or a mapping, such as `mm/s`, `mm_s` or `µs`.
        units: the units of one quantity.

    Returns:
        The key of `units` meant.
    """
    unit = text.strip()
    for written, meant in _SPELLINGS:
        unit = unit.replace(written, meant)
    for slash in _SLASHES:
        unit = unit.replace(slash, "/")
    return unit if unit in units else None


def require_unit(text: str, units: Units, what: str) -> str:
    """Return the unit that `text` spells.

    Args:
        text: the unit as written.
        units: the units of one quantity.
        what: whose unit it is, for the error.

    Returns:
        The key of `units` meant.

    Raises:
        MappingError: `text` is not a unit of this quantity.
    """
    unit = find_unit(text, units)
    if unit is None:
        raise MappingError(f"unit {text!r} of {what} is not known; use one of: {', '.join(units)}")
    return unit
