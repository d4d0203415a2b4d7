"""Numbers as files write them: with decimal commas, or signs between thousands."""

import re
from collections.abc import Iterable
from enum import Enum

_GROUPS_THEN_POINT = re.compile(r"^[+-]?\d{1,3}(?:,\d{3})+\.\d*$")
_GROUPS_THEN_COMMA = re.compile(r"^[+-]?\d{1,3}(?:\.\d{3})+,\d*$")
_GROUPS = re.compile(r"^[+-]?\d{1,3}(?:,\d{3})+$")
_WITH_COMMA = re.compile(r"^[+-]?\d*,\d+(?:[eE][+-]?\d+)?$")


class Commas(Enum):
    """What commas in the numbers of a table mean."""

    DECIMAL = "decimal commas read as points"
    GROUPS = "commas between thousands left out"
    UNKNOWN = "1,234 may be 1.234 or 1234"


def read_number(cell: str) -> float | None:
    """Return the number in a cell with a point; None if it holds none."""
    try:
        return None if "_" in cell else float(cell)  # 1_0 is Python's way to write 10
    except ValueError:
        return None


def read_with_commas(cell: str, commas: Commas) -> float | None:
    """Return the number in a cell that has a comma; None if it holds none.

    A cell with commas and points says itself which are which.
    """
    if _GROUPS_THEN_POINT.match(cell):
        return read_number(cell.replace(",", ""))
    if _GROUPS_THEN_COMMA.match(cell):
        return read_number(cell.replace(".", "").replace(",", "."))
    if commas is Commas.DECIMAL and _WITH_COMMA.match(cell):
        return read_number(cell.replace(",", "."))
    if commas is Commas.GROUPS and _GROUPS.match(cell):
        return read_number(cell.replace(",", ""))

    return None


def is_number(cell: str) -> bool:
    """Return whether a cell holds a number, whatever its commas mean."""
    if read_number(cell) is not None:
        return True

    meanings = (Commas.DECIMAL, Commas.GROUPS)
    return any(read_with_commas(cell, commas) is not None for commas in meanings)


def meaning_of_commas(cells: Iterable[str]) -> Commas:
    """Return what the commas in the cells of a table mean.

    They are decimal if a number shows it, as 0,5 and 1.234,5 do; they stand between
    thousands if all could and others have points.
    """
    with_comma: list[str] = []
    has_point = False
    for cell in cells:
        text = cell.strip()
        has_point = has_point or ("." in text and read_number(text) is not None)
        if "," in text and is_number(text):
            with_comma.append(text)

    if any(map(_GROUPS_THEN_POINT.match, with_comma)):
        return Commas.GROUPS
    if not all(map(_GROUPS.match, with_comma)):
        return Commas.DECIMAL

    return Commas.GROUPS if has_point else Commas.UNKNOWN
