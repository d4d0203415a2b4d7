"""Units of a file: what they are in SI, and how laboratories and machines write it."""

import re
from collections.abc import Iterable, Mapping
from math import pi

Units = Mapping[str, float]
"""Units that may stand in a file, with their factors to SI; the first is SI."""

GRAVITY_M_S2 = 9.80665
"""Standard gravity, which defines the force of a gram and of a kilogram [m/s2]."""

POUND_N = 4.4482216152605
"""A pound-force [N]."""

INCH_M = 0.0254
"""An inch [m]."""

TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0}
ANGLE = {"rad": 1.0, "deg": pi / 180.0}
ANGULAR_SPEED = {"rad/s": 1.0, "deg/s": pi / 180.0, "rpm": pi / 30.0}
TORQUE = {
    "Nm": 1.0,
    "mNm": 1e-3,
    "Ncm": 1e-2,
    "Nmm": 1e-3,
    "kNm": 1e3,
    "in-lbf": INCH_M * POUND_N,
    "ft-lbf": 12.0 * INCH_M * POUND_N,
}
LENGTH = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "inch": INCH_M}
SPEED = {
    "m/s": 1.0,
    "cm/s": 1e-2,
    "mm/s": 1e-3,
    "um/s": 1e-6,
    "m/min": 1.0 / 60.0,
    "mm/min": 1e-3 / 60.0,
    "inch/s": INCH_M,
    "inch/min": INCH_M / 60.0,
}
FORCE = {
    "N": 1.0,
    "mN": 1e-3,
    "cN": 1e-2,
    "kN": 1e3,
    "gf": 1e-3 * GRAVITY_M_S2,
    "kgf": GRAVITY_M_S2,
    "lbf": POUND_N,
    "ozf": POUND_N / 16.0,
}
CODE = {"1": 1.0}
"""Of a column that holds numbers of states."""

_QUANTITIES = (TIME, ANGLE, ANGULAR_SPEED, TORQUE, LENGTH, SPEED, FORCE)

_CHARACTERS = str.maketrans(
    {"µ": "u", "μ": "u", "°": "deg", "º": "deg", "_": "/", '"': "in", "″": "in"}
)
"""Micro sign and Greek letter; degree sign and the ordinal that is taken for it."""

_PRODUCT_SIGNS = re.compile(r"[·∙⋅•.*\-\s]")
"""What may stand between the factors of a unit, as in `N·m`."""

_WORDS = {
    "sec": "s",
    "secs": "s",
    "second": "s",
    "seconds": "s",
    "sek": "s",
    "sekunde": "s",
    "sekunden": "s",
    "msec": "ms",
    "millisecond": "ms",
    "milliseconds": "ms",
    "usec": "us",
    "microsecond": "us",
    "microseconds": "us",
    "nsec": "ns",
    "nanosecond": "ns",
    "nanoseconds": "ns",
    "minute": "min",
    "minutes": "min",
    "radian": "rad",
    "radians": "rad",
    "degs": "deg",
    "degree": "deg",
    "degrees": "deg",
    "1/min": "rpm",
    "min1": "rpm",
    "min^1": "rpm",
    "r/min": "rpm",
    "rev/min": "rpm",
    "revs/min": "rpm",
    "u/min": "rpm",
    "newton": "N",
    "newtons": "N",
    "kilonewton": "kN",
    "millinewton": "mN",
    "g": "gf",
    "gram": "gf",
    "grams": "gf",
    "gramm": "gf",
    "kg": "kgf",
    "kp": "kgf",
    "kilogram": "kgf",
    "lb": "lbf",
    "lbs": "lbf",
    "pound": "lbf",
    "pounds": "lbf",
    "oz": "ozf",
    "newtonmeter": "Nm",
    "newtonmeters": "Nm",
    "in/lbf": "in-lbf",
    "ft/lbf": "ft-lbf",
    "inlb": "in-lbf",
    "inlbs": "in-lbf",
    "lbin": "in-lbf",
    "lbfin": "in-lbf",
    "ftlb": "ft-lbf",
    "ftlbs": "ft-lbf",
    "lbft": "ft-lbf",
    "lbfft": "ft-lbf",
    "in": "inch",
    "inches": "inch",
    "millimeter": "mm",
    "millimeters": "mm",
    "millimetre": "mm",
    "millimetres": "mm",
    "centimeter": "cm",
    "micron": "um",
    "microns": "um",
    "micrometer": "um",
    "meter": "m",
    "meters": "m",
    "metre": "m",
    "metres": "m",
}
"""Other spellings in lower case, without the signs of a product."""

_CASE_MATTERS = frozenset({"n", "mn", "mnm", "m"})
"""Units in lower case that capitals make others of, as mN and MN; `n` counts rows."""

_OTHER_TEXT = (
    "% percent pct mpa kpa pa gpa psi ksi bar n/mm n/mm2 n/mm² n/m n/m2 kn/mm "
    "mv uv v/v mv/v ma °c °f hz khz counts count cnt cts steps mj "
    "mm/mm mm2 mm² mm3 mm^2 strain ustrain - -- n/a none"
)

_OTHER_UNITS = frozenset(_OTHER_TEXT.split())
"""Units in lower case of which no channel is made."""

_OTHER_LETTERS = frozenset("AVCFKJW%")
"""Such units of one letter, which are not written in lower case."""

_BRACKETS = re.compile(r"^[(\[{<]\s*(?P<unit>[^()\[\]{}<>]*?)\s*[)\]}>]$")


def find_unit(text: str, units: Units) -> str | None:
    """Return the key of `units` that a text such as `mm/s`, `mm_s` or `µs` spells."""
    written = text.strip().translate(_CHARACTERS)
    written = written.replace("/per/", "/").replace(" per ", "/")
    unit = _PRODUCT_SIGNS.sub("", written)
    by_spelling = {_PRODUCT_SIGNS.sub("", key): key for key in units}
    if unit in by_spelling:
        return by_spelling[unit]

    lower = unit.lower()
    if lower in _CASE_MATTERS:
        return None

    by_lower_case = {key.lower(): name for key, name in by_spelling.items()}
    if lower in by_lower_case:
        return by_lower_case[lower]

    meant = _WORDS.get(lower) or _replace_parts(lower)
    return meant if meant in units else None


def _replace_parts(lower: str) -> str:
    """Return a quotient such as `degrees/second` with its parts as keys of units."""
    return "/".join(_WORDS.get(part, part) for part in lower.split("/"))


def is_unit(text: str) -> bool:
    """Return whether a text is a unit, of a channel or of anything else."""
    is_known = any(find_unit(text, units) is not None for units in _QUANTITIES)
    return is_known or is_other_unit(text)


def is_other_unit(text: str) -> bool:
    """Return whether a text is a unit of which no channel is made, such as `%`."""
    unit = text.strip()
    return unit in _OTHER_LETTERS or unit.lower() in _OTHER_UNITS


def unit_in_brackets(text: str) -> str | None:
    """Return what stands in brackets, if that is all of the text."""
    match = _BRACKETS.match(text.strip())
    return match["unit"] if match else None


def is_row_of_units(cells: Iterable[str]) -> bool:
    """Return whether a row below a header holds units: `(s),(mm),(kN)` or `s;mm;kN`.

    Every cell is empty, in brackets or a unit, and at least one is a known unit.
    """
    texts = [cell.strip() for cell in cells]
    filled = [text for text in texts if text]
    are_known = [is_unit(unit_in_brackets(text) or text) for text in filled]
    are_units = [
        is_known or unit_in_brackets(text) is not None
        for text, is_known in zip(filled, are_known, strict=True)
    ]
    return all(are_units) and any(are_known)
