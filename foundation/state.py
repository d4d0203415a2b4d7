"""States of estimators: checked, written and read back bit for bit.

A state is a tree of records: named tuples and frozen data classes whose fields are
records, enumerations, numbers, texts, tuples and arrays of float64. What a state may be
is said by its types:

- Every value is of the type that its field is annotated with.
- Every number is finite and at most `MAX_NUMBER`; numbers of fields that the record
  names in a class attribute ``MAY_BE_INFINITE`` may also be infinite.
- Every array has the shape of the same array in a reference state, usually that of a
  new estimator. The number of rows is free in fields that the record names in a class
  attribute ``GROWING``.
- A record with more to say has a method ``find_damage`` that returns what is wrong with
  it, or an empty text.

A file holds one state as MessagePack inside an envelope: a format name, a version, what
the state is of, and the SHA-256 of its bytes. The types of the reader decide what is
read: a file cannot name a type, and nothing in it is executed.
"""

import hashlib
import math
import os
from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import msgspec
import numpy as np

from foundation.arrays import Array
from foundation.errors import NeedleforceError

STATE_FORMAT = "needleforce-state"
"""Name of the file format."""

STATE_VERSION = 12
"""Grows whenever a file of the version before cannot be read, or is misread."""

MAX_NUMBER = 1e30
"""No number of a state is larger; its square can still be calculated with."""

OWN_SNAPSHOT = "Give a file that `write_snapshot` wrote."
SAME_KIND = "Restore it with an object of the class whose `snapshot` was taken."
SAME_SETTINGS = (
    "Build the object with the robot and the settings of the snapshot, then `restore` "
    "it."
)

MAX_FILE_BYTES = 64 << 20
"""A state has one or two megabytes; a wrong file is not read to its end."""


class StateError(NeedleforceError, ValueError):
    """A state that is damaged, or a file that holds none; the message says where."""

    usual_advice = "Take an older snapshot, or start and tare anew."


class Envelope(msgspec.Struct, forbid_unknown_fields=True):
    """What stands around the bytes of a state in a file.

    Attributes:
        format: Always `STATE_FORMAT`.
        version: `STATE_VERSION` of the writer.
        kind: What the state is of; the reader chooses the type by it.
        sha256: Hash of ``data``, hexadecimal.
        data: The state, as `encode_state` wrote it.
    """

    format: str
    version: int
    kind: str
    sha256: str
    data: bytes


def check_state(state: Any, reference: Any = None, place: str = "state") -> None:
    """Refuse a damaged state, before compiled code reads beyond its arrays.

    Args:
        state: The record to check, with all that it holds.
        reference: A sound state of the same kind, whose arrays have the right shapes;
            None to check types and numbers only.
        place: Name of the state in messages.

    Raises:
        StateError: The first value that cannot be, and where it stands.
    """
    if isinstance(state, np.ndarray):
        _check_array(state, reference, place)
    elif isinstance(state, float):
        _check_numbers(np.asarray(state), place)
    elif _is_record(state) or _is_record(reference):
        _check_record(state, reference, place)
    elif isinstance(state, tuple):
        parts = reference if _is_alike(state, reference) else [None] * len(state)
        for number, (part, like) in enumerate(zip(state, parts, strict=True)):
            check_state(part, like, f"{place}[{number}]")


def _is_alike(state: Sequence[Any], reference: Any) -> bool:
    return isinstance(reference, tuple) and len(reference) == len(state)


def _check_record(record: Any, reference: Any, place: str) -> None:
    """Check every field of a record, then the record as a whole."""
    if reference is not None and type(reference) is not type(record):
        expected = type(reference).__name__
        raise StateError(f"{place} is a {type(record).__name__}, expected a {expected}")
    hints = _field_hints(type(record))
    unlimited = getattr(record, "MAY_BE_INFINITE", ())
    growing = getattr(record, "GROWING", ())
    for name in hints:
        value = getattr(record, name)
        where = f"{place}.{name}"
        _check_type(value, hints[name], where)
        if value is None:  # the type allows it, whatever the reference has
            continue
        like = getattr(reference, name, None)
        if name in unlimited and isinstance(value, float | np.ndarray):
            value = np.where(value == math.inf, 0.0, value)
        if isinstance(value, np.ndarray):
            _check_array(value, like, where, rows_are_free=name in growing)
        else:
            check_state(value, like, where)
    damage = record.find_damage() if hasattr(record, "find_damage") else ""
    if damage:
        raise StateError(f"{place}: {damage}")


def _check_type(value: Any, hint: Any, place: str) -> None:
    """Refuse a value that is of another type than its field."""
    alternatives = get_args(hint) if get_origin(hint) in (UnionType, Union) else (hint,)
    types = [get_origin(alternative) or alternative for alternative in alternatives]
    if Any in types or Literal in types:
        return
    if not isinstance(value, tuple(kind for kind in types if isinstance(kind, type))):
        raise StateError(f"{place} is a {type(value).__name__}, expected {hint}")


def _check_array(
    array: Array, reference: Any, place: str, *, rows_are_free: bool = False
) -> None:
    """Refuse an array of other numbers or another shape than its reference."""
    if array.dtype != np.float64:
        raise StateError(f"{place} is an array of {array.dtype}, expected float64")
    _check_numbers(array, place)
    if not isinstance(reference, np.ndarray):
        return
    first = 1 if rows_are_free else 0
    expected = reference.shape
    if array.ndim != len(expected) or array.shape[first:] != expected[first:]:
        raise StateError(f"{place} has shape {array.shape}, expected {expected}")


def _check_numbers(numbers: Array, place: str) -> None:
    if not np.all(np.abs(numbers) <= MAX_NUMBER):
        raise StateError(f"{place} cannot be {str(numbers)[:80]}")


def _is_record(value: Any) -> bool:
    return _is_record_type(type(value))


def _is_record_type(kind: Any) -> bool:
    return is_dataclass(kind) or hasattr(kind, "_fields")


@cache
def _field_hints(kind: Any) -> dict[str, Any]:
    """Return the types of the fields of a named tuple or a data class, in order."""
    names = kind._fields if hasattr(kind, "_fields") else [f.name for f in fields(kind)]
    hints = get_type_hints(kind)
    return {name: hints[name] for name in names}


def encode_state(state: Any) -> bytes:
    """Return a state as MessagePack.

    Raises:
        StateError: The tree holds something else than records, numbers, texts and
            arrays of float64.
    """
    return msgspec.msgpack.encode(state, enc_hook=_encode_array)


def decode_state(data: bytes, kind: Any) -> Any:
    """Return the state that `encode_state` was given, typed to its leaves.

    Args:
        data: What `encode_state` returned.
        kind: Type of the state. Where a field may hold one of several data classes, the
            names of the fields that came tell which.

    Raises:
        StateError: The bytes do not hold a state of this kind.
    """
    try:
        return _typed(msgspec.msgpack.decode(data), kind)
    except (msgspec.MsgspecError, RecursionError, ValueError, TypeError) as error:
        raise StateError(str(error)) from error


def _typed(plain: Any, hint: Any) -> Any:
    """Return what MessagePack holds of a value as a value of its type."""
    alternatives = get_args(hint) if get_origin(hint) in (UnionType, Union) else ()
    if alternatives:
        if plain is None and NoneType in alternatives:
            return None
        hint = next((kind for kind in alternatives if _fits(plain, kind)), hint)
    if _is_record_type(hint):
        return _typed_record(plain, hint)
    if get_origin(hint) is tuple and isinstance(plain, list):
        kinds = get_args(hint)
        if kinds[-1] is Ellipsis:
            kinds = kinds[:1] * len(plain)
        if len(kinds) != len(plain):
            raise ValueError(f"expected {len(kinds)} values, got {len(plain)}")
        return tuple(map(_typed, plain, kinds))
    return msgspec.convert(plain, hint, dec_hook=_decode_array)


def _typed_record(plain: Any, kind: Any) -> Any:
    """Return a record: of a data class came a map, of a named tuple a list."""
    if not _fits(plain, kind):
        raise ValueError(f"expected the fields of a {kind.__name__}")
    hints = _field_hints(kind)
    named = plain if isinstance(plain, dict) else dict(zip(hints, plain, strict=True))
    return kind(**{name: _typed(named[name], hint) for name, hint in hints.items()})


def _fits(plain: Any, hint: Any) -> bool:
    """Return whether a value may be a record of a type, by its fields alone."""
    if hasattr(hint, "_fields"):
        return isinstance(plain, list) and len(plain) == len(hint._fields)
    is_record = isinstance(plain, dict) and _is_record_type(hint)
    return is_record and plain.keys() == _field_hints(hint).keys()


def _encode_array(value: Any) -> Any:
    """Return an array as its shape, its order in memory and its bytes.

    The order of numbers in memory decides the order of sums, and that their last bit.
    """
    if isinstance(value, np.floating | np.integer | np.bool_):
        return value.item()
    if not isinstance(value, np.ndarray):
        raise StateError(f"a state cannot hold a {type(value).__name__}")
    if value.dtype != np.float64:
        raise StateError(f"a state cannot hold an array of {value.dtype}")
    order = "F" if value.flags.f_contiguous and not value.flags.c_contiguous else "C"
    return list(value.shape), order, value.tobytes(order)


def _decode_array(kind: Any, encoded: Any) -> Array:
    """Return the array that `_encode_array` was given, read-only."""
    parts = tuple[tuple[int, ...], Literal["C", "F"], bytes]
    shape, order, data = msgspec.convert(encoded, parts)
    flat = np.frombuffer(data, dtype=np.float64)
    array = np.array(flat.reshape(shape, order=order), order=order)
    array.setflags(write=False)
    return array


def seal_state(state: Any, kind: str) -> bytes:
    """Return the content of a file that holds a state.

    Args:
        state: The state.
        kind: What it is of: a name by which the reader chooses a type.
    """
    data = encode_state(state)
    digest = hashlib.sha256(data).hexdigest()
    envelope = Envelope(STATE_FORMAT, STATE_VERSION, kind, digest, data)
    return msgspec.msgpack.encode(envelope)


def read_sealed_state(path: str | os.PathLike[str], kinds: dict[str, Any]) -> Any:
    """Read a file with the content that `seal_state` returned.

    Args:
        path: The file.
        kinds: Type of the state for each kind that may be read.

    Returns:
        The state, its types and numbers checked.

    Raises:
        StateError: The file is no state, is damaged, or is of another version or kind.
        OSError: The file cannot be read.
    """
    with Path(path).open("rb") as file:
        content = file.read(MAX_FILE_BYTES + 1)
    if len(content) > MAX_FILE_BYTES:
        size = f"more than {MAX_FILE_BYTES >> 20} MB, a state has one or two"
        raise StateError(f"{path} holds no state: it has {size}", OWN_SNAPSHOT)
    try:
        envelope = msgspec.msgpack.decode(content, type=Envelope)
    except (msgspec.MsgspecError, RecursionError, UnicodeDecodeError) as error:
        raise StateError(
            f"{path} holds no state, or is cut short: {error}", OWN_SNAPSHOT
        ) from error
    _check_envelope(envelope, path, kinds)
    try:
        state = decode_state(envelope.data, kinds[envelope.kind])
        check_state(state)
    except StateError as error:
        raise StateError(f"{path} is damaged: {error}") from error
    return state


def _check_envelope(
    envelope: Envelope, path: str | os.PathLike[str], kinds: dict[str, Any]
) -> None:
    """Refuse a file of another format, version or kind, or with changed bytes."""
    if envelope.format != STATE_FORMAT:
        raise StateError(
            f"{path} holds no state: its format is {envelope.format!r}, expected "
            f"{STATE_FORMAT!r}",
            OWN_SNAPSHOT,
        )
    if envelope.version != STATE_VERSION:
        raise StateError(
            f"{path} has version {envelope.version}, this package reads version "
            f"{STATE_VERSION}",
            "Resume it with the package that wrote it.",
        )
    if envelope.sha256 != hashlib.sha256(envelope.data).hexdigest():
        raise StateError(f"{path} is damaged: its bytes do not have its sha256")
    if envelope.kind not in kinds:
        known = ", ".join(kinds)
        raise StateError(
            f"{path} holds the state of a {envelope.kind!r}, expected one of {known}",
            SAME_KIND,
        )
