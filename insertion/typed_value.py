"""Whether a value read from a file is what the annotation of its place says, and finite."""

import math
from enum import Enum
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

from insertion.errors import SnapshotFileError
from insertion.snapshot_types import is_state

LARGEST = 1e30
"""No number of a snapshot comes near it; its square can still be calculated with."""
NOT_FINITE = {
    "AloneState.limit_s": math.inf,
    "DefaultTick.deepest_m": -math.inf,
    "LayerEnding.release_m": math.nan,
    "MembraneFits.squares": math.inf,
    "PaperTick.force_N": math.nan,
    "PaperTick.force_before_N": math.nan,
}
"""The only places where a number may be other than finite, and which it then is."""


def check_value(value: Any, hint: Any, place: str) -> None:
    """Refuse a value that cannot stand in its place.

    Args:
        value: What was read.
        hint: Annotation of the place.
        place: Name of class and field, for the message.

    Raises:
        SnapshotFileError: For another type, or a number that is not finite or beyond `LARGEST`.
    """
    origin = get_origin(hint)
    if origin in (Union, UnionType):
        if value is None and NoneType in get_args(hint):
            return
        hint = next(one for one in get_args(hint) if one is not NoneType)
        origin = get_origin(hint)
    if hint in (Any, object):
        hint = type(value) if is_state(type(value)) else None
    if origin is tuple:
        _check_tuple(value, get_args(hint), place)
    elif isinstance(hint, type) and is_state(hint):
        _check_state(value, hint, place)
    else:
        _check_plain(value, hint, place)


def _check_tuple(value: Any, hints: tuple[Any, ...], place: str) -> None:
    _expect(isinstance(value, tuple), value, place)
    if hints[1:] == (...,):
        hints = hints[:1] * len(value)
    _expect(len(value) == len(hints), value, place)
    for item, hint in zip(value, hints, strict=True):
        check_value(item, hint, place)


def _check_state(value: Any, kind: type, place: str) -> None:
    _expect(type(value) is kind, value, place)
    # Settings are compared as a whole with those of whoever restores them.
    if issubclass(kind, Enum) or kind.__name__.endswith("Config"):
        return
    for name, hint in get_type_hints(kind).items():
        check_value(getattr(value, name), hint, f"{kind.__name__}.{name}")


def _check_plain(value: Any, hint: Any, place: str) -> None:
    origin, kind = get_origin(hint), type(value)
    if hint is float:
        _expect(kind in (float, int), value, place)
        # Almost every one; arrays of one number are costly.
        if abs(value) <= LARGEST:
            return
    elif origin is np.ndarray:
        _expect(kind is np.ndarray, value, place)
    elif origin is Literal:
        _expect(value in get_args(hint), value, place)
        return
    else:
        _expect(kind is hint, value, place)
        return
    numbers = np.asarray(value, dtype=np.float64)
    odd = numbers[~(np.abs(numbers) <= LARGEST)]
    allowed = NOT_FINITE.get(place, 0.0)
    _expect(np.array_equal(odd, np.full(odd.shape, allowed), equal_nan=True), value, place)


def _expect(is_sound: bool, value: Any, place: str) -> None:
    if not is_sound:
        raise SnapshotFileError(f"the snapshot is damaged: {place} cannot be {str(value)[:80]!r}")
