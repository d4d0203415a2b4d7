"""Snapshots in files: plain JSON with a format name and a version, see docs/loop.md."""

import hashlib
import json
import math
import os
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

from identification import MultilayerConfig, PublishedConfig
from identification import Snapshot as IdentifierSnapshot
from identification.multilayer_state import MultilayerState
from identification.published_identifier import PublishedState
from needleforce.session import SessionSnapshot, SnapshotFileError
from residual.snapshot import SensorState

# What snapshots consist of: these types and those that their annotations name.


# The annotations of an identifier's snapshot leave the method open: both are named here.
SNAPSHOT_TYPES = (
    SessionSnapshot,
    SensorState,
    IdentifierSnapshot,
    MultilayerState,
    MultilayerConfig,
    PublishedState,
    PublishedConfig,
)
"""Roots; everything else is reached from them."""


def is_state(kind: type) -> bool:
    """Whether a type is one that snapshots may name: an enumeration, or a class of fields."""
    return issubclass(kind, Enum) or is_dataclass(kind) or hasattr(kind, "_fields")


# Values of known types as plain JSON values, and back, bit for bit.
#
# Numbers that are not finite, arrays, enumerations, named tuples and data classes become objects of
# one or two members; everything else is itself. Only types reachable from `SNAPSHOT_TYPES` by their
# annotations are read: a file names them, and cannot name any other.


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


# Whether a value read from a file is what the annotation of its place says, and finite.


LARGEST = 1e30
"""No number of a snapshot comes near it; its square can still be calculated with."""
NOT_FINITE = {
    "AloneState.limit_s": math.inf,
    "MultilayerMemory.deepest_m": -math.inf,
    "MembraneFits.squares": math.inf,
    "PublishedMemory.force_N": math.nan,
    "PublishedMemory.force_before_N": math.nan,
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
        kinds = [one for one in get_args(hint) if one is not NoneType]
        hint = type(value) if type(value) in kinds else kinds[0]
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


SNAPSHOT_FORMAT = "needleforce-snapshot"
SNAPSHOT_VERSION = 4
"""Grows whenever a file of the version before could no longer be read, or would be misread."""

AnySnapshot = SessionSnapshot | SensorState | IdentifierSnapshot


def write_snapshot(snapshot: AnySnapshot, path: str | os.PathLike[str]) -> None:
    """Write the snapshot of a session, of a virtual sensor or of an identifier.

    The file appears whole or not at all.

    Args:
        snapshot: What ``snapshot()`` of one of them returned.
        path: Where to; an older file of that name is replaced.

    Raises:
        SnapshotFileError: For anything but such a snapshot.
        OSError: If the file cannot be written.
    """
    if not isinstance(snapshot, AnySnapshot):
        raise SnapshotFileError(
            f"expected a snapshot of a session, a sensor or an identifier, got a "
            f"{type(snapshot).__name__}"
        )
    plain = to_plain(snapshot)
    content = {
        "format": SNAPSHOT_FORMAT,
        "version": SNAPSHOT_VERSION,
        "sha256": _digest(plain),
        "snapshot": plain,
    }
    target = Path(path)
    partial = target.with_name(target.name + ".part")
    partial.write_text(json.dumps(content, allow_nan=False), encoding="utf-8")
    partial.replace(target)


def read_snapshot(path: str | os.PathLike[str]) -> AnySnapshot:
    """Read what `write_snapshot` wrote.

    Args:
        path: The file.

    Returns:
        The snapshot, for ``restore`` of its kind.

    Raises:
        SnapshotFileError: If it is no snapshot, damaged, or of another version.
        OSError: If the file cannot be read.
    """
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
        _check_header(content, path)
        snapshot = from_plain(content.get("snapshot"))
    except SnapshotFileError:
        raise
    except (ValueError, RecursionError) as error:
        raise SnapshotFileError(f"{path} is not JSON, or cut short: {error}") from error
    if not isinstance(snapshot, AnySnapshot):
        raise SnapshotFileError(f"{path} holds a {type(snapshot).__name__}, not a snapshot")
    check_value(snapshot, type(snapshot), "snapshot")
    return snapshot


def _digest(plain: Plain) -> str:
    """SHA-256 of the value as JSON with sorted names and without spaces."""
    text = json.dumps(plain, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def _check_header(content: Any, path: str | os.PathLike[str]) -> None:
    if not isinstance(content, dict) or content.get("format") != SNAPSHOT_FORMAT:
        raise SnapshotFileError(f"{path} is not a snapshot: it has no format {SNAPSHOT_FORMAT!r}")
    version = content.get("version")
    if version != SNAPSHOT_VERSION or isinstance(version, bool):
        raise SnapshotFileError(
            f"{path} is a snapshot of version {version}, this package reads version "
            f"{SNAPSHOT_VERSION}: resume it with the package that wrote it"
        )
    if content.get("sha256") != _digest(content.get("snapshot")):
        raise SnapshotFileError(
            f"{path} is damaged: its sha256 is not that of its snapshot; take an older one, or "
            "start and tare anew"
        )
