"""Values of known types as plain JSON values, and back, bit for bit.

Numbers that are not finite, arrays, enumerations, named tuples and data classes become objects of
one or two members; everything else is itself. Only types reachable from `SNAPSHOT_TYPES` by their
annotations are read: a file names them, and cannot name any other.
"""

import math
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache
from types import NoneType
from typing import Any, get_args, get_type_hints

import numpy as np

from insertion.errors import SnapshotFileError
from insertion.snapshot_types import SNAPSHOT_TYPES, is_state

Plain = None | bool | int | float | str | list["Plain"] | dict[str, "Plain"]


def to_plain(value: Any) -> Plain:
    """A value as JSON can hold it.

    Raises:
        SnapshotFileError: For a type that snapshots do not consist of.
    """
    kind = type(value)
    if kind in (NoneType, bool, int, str):
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else {"float": str(float(value))}
    if isinstance(value, np.ndarray):
        return _plain_array(value)
    if kind.__name__ in _known_types() and _known_types()[kind.__name__] is kind:
        if isinstance(value, Enum):
            return {"type": kind.__name__, "value": to_plain(value.value)}
        members = {name: to_plain(getattr(value, name)) for name in _names(kind)}
        return {"type": kind.__name__, "fields": members}
    if kind in (tuple, list):
        return [to_plain(item) for item in value]
    raise SnapshotFileError(f"a snapshot cannot hold a {kind.__module__}.{kind.__name__}")


def from_plain(plain: Plain) -> Any:
    """The value that `to_plain` was given; sequences come back as tuples, arrays read-only.

    Raises:
        SnapshotFileError: For what is none of its forms, or names an unknown type or field.
    """
    if isinstance(plain, list):
        return tuple(from_plain(item) for item in plain)
    if not isinstance(plain, dict):
        return plain
    try:
        if "float" in plain:
            return float(str(plain["float"]))
        if "array" in plain:
            return _array(plain)
        kind = _known_types()[str(plain["type"])]
        if issubclass(kind, Enum):
            return kind(plain["value"])
        members = plain["fields"]
        assert isinstance(members, dict)
        return kind(**{name: from_plain(item) for name, item in members.items()})
    except SnapshotFileError:
        raise
    except (KeyError, TypeError, ValueError, OverflowError, AssertionError) as error:
        shown = str(plain)[:80]
        raise SnapshotFileError(f"cannot read {shown!r} of a snapshot: {error!r}") from error


def _plain_array(array: np.ndarray[Any, Any]) -> Plain:
    if array.dtype != np.float64:
        raise SnapshotFileError(f"a snapshot cannot hold an array of {array.dtype}")
    # The order of numbers in memory decides the order of sums, and that their last bit.
    order = "F" if array.flags.f_contiguous and not array.flags.c_contiguous else "C"
    numbers = [to_plain(number) for number in array.ravel(order=order).tolist()]
    return {"array": numbers, "shape": list(array.shape), "order": order}


def _array(plain: dict[str, Plain]) -> np.ndarray[Any, Any]:
    numbers, shape = from_plain(plain["array"]), from_plain(plain["shape"])
    order = "F" if plain["order"] == "F" else "C"
    array = np.array(numbers, dtype=np.float64).reshape(shape, order=order)
    array = np.array(array, order=order)
    array.setflags(write=False)
    return array


@cache
def _known_types() -> dict[str, type]:
    """Every type a snapshot may consist of, by name."""
    found: dict[str, type] = {}
    waiting: list[Any] = list(SNAPSHOT_TYPES)
    while waiting:
        hint = waiting.pop()
        waiting.extend(get_args(hint))
        if isinstance(hint, type) and hint not in found.values() and is_state(hint):
            if hint.__name__ in found:
                raise SnapshotFileError(f"two types of a snapshot are called {hint.__name__}")
            found[hint.__name__] = hint
            waiting.extend(get_type_hints(hint).values())
    return found


def _names(kind: type) -> Iterator[str]:
    if is_dataclass(kind):
        return (field.name for field in fields(kind) if field.init)
    return iter(kind._fields)  # type: ignore[attr-defined]
