"""Records: states with named fields that compiled functions read and write.

The type of a state is a dataclass whose fields are ``float``, ``int``, ``bool``, or a
state of another type, or a tuple of a fixed number of states of one other type. A
compiled function that Python calls takes ``list[State]`` and works on ``states[0]``;
one that only compiled functions call takes ``State``. Compiled, the list is a
structured array of one element; where compiling is disabled (see `foundation.jit`) it
is a list.
"""

from copy import deepcopy
from dataclasses import is_dataclass
from typing import Any, TypeVar, cast, get_args

import numpy as np
from numpy.typing import NDArray

from foundation.jit import COMPILER, SCALARS, record_dtype, state_fields

State = TypeVar("State")


def as_record(state: State) -> list[State]:
    """Return a copy of a state in the form that compiled functions write into."""
    if not COMPILER:
        return [deepcopy(state)]
    record = np.zeros(1, record_dtype(type(state)))
    _write(record[0], state)
    return cast(list[State], record)


def from_record(kind: type[State], record: list[State]) -> State:
    """Return a copy of what compiled functions have written, as a state of a type."""
    return _build(kind, record[0]) if COMPILER else deepcopy(record[0])


def record_array(kind: type[State], size: int) -> list[State]:
    """Return an array of so many states, all of them zero.

    It is a structured array, whose elements compiled functions read and write by name;
    Python reads one with `read_element` and a field of all with `read_column`.
    """
    return cast(list[State], np.zeros(size, array_dtype(kind)))


def array_dtype(kind: type) -> np.dtype[Any]:
    """Return the type of the elements of `record_array`."""
    dtype = record_dtype(kind)
    # Elements of records have attributes in plain Python too, but cost a microsecond.
    return dtype if COMPILER else np.dtype((np.record, dtype))


def read_element(kind: type[State], array: list[State], index: int) -> State:
    """Return a copy of one state of a `record_array` whose fields are numbers."""
    return kind(*cast(Any, array[index]).item())


def read_column(array: list[Any], name: str) -> NDArray[Any]:
    """Return the values of one field of a `record_array`, a view of shape (n,)."""
    return cast(Any, array)[name]


def read_field(record: list[Any], name: str) -> Any:
    """Return the present value of one field of a record."""
    return record[0][name] if COMPILER else getattr(record[0], name)


def _build(kind: Any, value: Any) -> Any:
    """Return the value of a field as its type: a number, a state, a tuple of states."""
    if kind in SCALARS:
        return kind(value)
    if get_args(kind):
        return tuple(map(_build, get_args(kind), value))
    return kind(*map(_build, state_fields(kind).values(), value))


def _write(record: Any, state: Any) -> None:
    """Write the fields of a state, and of those in it, into a record."""
    for name, hint in state_fields(type(state)).items():
        value = getattr(state, name)
        if is_dataclass(hint):
            _write(record[name], value)
        elif hint in SCALARS:
            record[name] = value
        else:
            for place, inner in zip(record[name], value, strict=True):
                _write(place, inner)
