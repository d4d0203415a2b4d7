"""Numbers, times and lists as texts write them."""

import re
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from foundation.arrays import Array
from needleforce.recordings.time_stamps import NS_PER_S

_GROUPS_THEN_POINT = re.compile(r"^[+-]?\d{1,3}(?:,\d{3})+\.\d*$")
_GROUPS_THEN_COMMA = re.compile(r"^[+-]?\d{1,3}(?:\.\d{3})+,\d*$")
_GROUPS = re.compile(r"^[+-]?\d{1,3}(?:,\d{3})+$")
_WITH_COMMA = re.compile(r"^[+-]?\d*,\d+(?:[eE][+-]?\d+)?$")
_CLOCK = re.compile(
    r"(?:(\d{4})[-/](\d\d?)[-/](\d\d?)[T ])?(\d{1,2}):(\d\d):(\d\d)(?:[.,](\d*))?"
    r"\s*(?:Z|([+-])(\d\d):?(\d\d))?"
)
_LIST = re.compile(r"[\[(][-+0-9.eE,;\s]*[\])]")
_NUMPY_NUMBER = re.compile(r"(?:np|numpy)\.float\d+\(([^)]*)\)")

UNKNOWN_NS = np.iinfo(np.int64).min
"""Stands for a time that a cell does not hold."""


class Commas(Enum):
    """What commas in the numbers of a table mean."""

    DECIMAL = "decimal commas read as points"
    GROUPS = "commas between thousands left out"
    UNKNOWN = "1,234 may be 1.234 or 1234"


def read_number(cell: str, commas: Commas = Commas.UNKNOWN) -> float | None:
    """Return the number in a cell; None if it holds none.

    A number with commas and points says itself which are which.
    """
    text = cell.strip()
    if "," in text:
        if _GROUPS_THEN_POINT.match(text) or (
            commas is Commas.GROUPS and _GROUPS.match(text)
        ):
            text = text.replace(",", "")
        elif _GROUPS_THEN_COMMA.match(text):
            text = text.replace(".", "").replace(",", ".")
        elif commas is Commas.DECIMAL and _WITH_COMMA.match(text):
            text = text.replace(",", ".")

    try:
        return None if "_" in text else float(text)  # 1_0 is Python's way to write 10
    except ValueError:
        return None


def is_number(cell: str) -> bool:
    """Return whether a cell holds a number, whatever its commas mean."""
    meanings = (Commas.DECIMAL, Commas.GROUPS) if "," in cell else (Commas.UNKNOWN,)
    return any(read_number(cell, commas) is not None for commas in meanings)


def meaning_of_commas(cells: Iterable[str]) -> Commas:
    """Return what the commas in the cells of a table mean.

    They are decimal if a number shows it, as 0,5 and 1.234,5 do; they stand between
    thousands if all could and others have points.
    """
    with_comma: list[str] = []
    has_point = False
    for cell in cells:
        text = cell.strip()
        if "," not in text:
            has_point = has_point or ("." in text and is_number(text))
        elif is_number(text):
            with_comma.append(text)

    if any(map(_GROUPS_THEN_POINT.match, with_comma)):
        return Commas.GROUPS
    if not all(map(_GROUPS.match, with_comma)):
        return Commas.DECIMAL

    return Commas.GROUPS if has_point else Commas.UNKNOWN


def read_clock_ns(cell: str) -> int | None:
    """Return the time in a cell; None if it holds none.

    Returns:
        Nanoseconds since 1970 of `2024-05-03 10:00:00.040`, since midnight of
        `10:00:00.040`. What has no zone is taken as UTC.
    """
    match = _CLOCK.fullmatch(cell.strip())
    if match is None:
        return None

    year, month, day, hours, minutes, seconds, part, sign, *zone = match.groups()
    total_s = (int(hours) * 60 + int(minutes)) * 60 + int(seconds)
    if sign:
        zone_s = (int(zone[0]) * 60 + int(zone[1])) * 60
        total_s -= zone_s if sign == "+" else -zone_s
    if year:
        try:
            date = datetime(int(year), int(month), int(day), tzinfo=UTC)
        except ValueError:
            return None
        total_s += int(date.timestamp())

    return total_s * NS_PER_S + int(f"{part or '':0<9.9}")


def read_clocks_ns(
    cells: Sequence[str], before_ns: int | None = None
) -> NDArray[np.int64]:
    """Return the times in a column, shape (n,), `UNKNOWN_NS` where there is none.

    Times without a date go on over midnight.

    Args:
        cells: Of the column.
        before_ns: The time before the first; None if that is the first of all.
    """
    day_ns = 86_400 * NS_PER_S
    known = [read_clock_ns(cell) for cell in cells]
    stamps_ns = np.array([UNKNOWN_NS if ns is None else ns for ns in known], np.int64)
    is_known = stamps_ns != UNKNOWN_NS
    clock_ns = stamps_ns[is_known]
    if clock_ns.size and clock_ns.max() < day_ns:
        first_ns = clock_ns[:1] if before_ns is None else np.array([before_ns])
        steps_ns = np.diff(clock_ns, prepend=first_ns)
        days = np.cumsum(np.round(-steps_ns / day_ns).astype(np.int64))
        stamps_ns[is_known] = clock_ns + days * day_ns

    return stamps_ns


def is_list(cell: str) -> bool:
    """Return whether a cell holds a list of numbers, as `[0.1, 0.2]`."""
    if len(cell) > 4096:  # 64 numbers, the most that a signal has, take 2000 characters
        return False

    return _LIST.fullmatch(_NUMPY_NUMBER.sub(r"\1", cell).strip()) is not None


def read_lists(cells: Sequence[str], width: int) -> Array:
    """Return the lists in a column, shape (n, width); those of another width as NaN."""
    values = np.full((len(cells), width), np.nan)
    for row, cell in enumerate(cells):
        numbers = list_numbers(cell)
        if len(numbers) == width:
            values[row] = numbers

    return values


def list_numbers(cell: str) -> list[float]:
    """Return the numbers in a list; none if it is no list."""
    texts = re.split(r"[,;\s]+", _NUMPY_NUMBER.sub(r"\1", cell).strip("[]() \t"))
    try:
        return [float(text) for text in texts if text]
    except ValueError:
        return []
