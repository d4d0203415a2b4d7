"""config_files."""

import sys
from collections.abc import Collection, Mapping
from dataclasses import MISSING, fields
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import numpy as np

from residual.errors import ResidualError


class CommandError(ResidualError, ValueError):
    """An option, a file named by one, or a log that does not fit the robot."""


T = TypeVar("T")


NOTHING = "none"
"""How a file says None, for which TOML has no word."""


def dataclass_values(
    kind: type[Any], table: Mapping[str, Any], where: str, *, leave_out: Collection[str] = ()
) -> dict[str, Any]:
    """Return a table's entries as arguments of a dataclass.

    Understands fields of numbers, text, choices, booleans, arrays, tuples, other dataclasses (as
    tables) and any of these or None.

    Args:
        kind: The dataclass.
        table: The entries.
        where: File and table, for messages.
        leave_out: Fields that the file may not set.

    Raises:
        CommandError: An unknown key, or a value of the wrong type.
    """
    known = [item.name for item in fields(kind) if item.init and item.name not in leave_out]
    for name in table:
        if name not in known:
            raise CommandError(f"{where}: unknown key {name!r}; known are: {', '.join(known)}")
    hints = get_type_hints(kind)
    return {name: _value(table[name], hints[name], f"{where}: {name}") for name in table}


def build(kind: type[T], values: Mapping[str, Any], where: str) -> T:
    """Build a dataclass whose own validation may refuse the values.

    Raises:
        CommandError: A value is missing or refused; the message starts with ``where``.
    """
    missing = [
        item.name
        for item in fields(kind)  # type: ignore[arg-type]
        if item.init and item.name not in values and item.default is item.default_factory is MISSING
    ]
    if missing:
        raise CommandError(f"{where}: {', '.join(missing)} missing")
    try:
        return kind(**values)
    except (ValueError, TypeError) as error:
        raise CommandError(f"{where}: {error}") from error


def _value(value: Any, hint: Any, what: str) -> Any:
    options = get_args(hint) if get_origin(hint) is UnionType else (hint,)
    if NoneType in options and value == NOTHING:
        return None
    for option in options:
        if isinstance(option, type) and hasattr(option, "__dataclass_fields__"):
            return _nested(value, option, what)
        found = _matched(value, option)
        if found is not None:
            return found
    raise CommandError(f"{what} = {value!r}, expected {' or '.join(map(_describe, options))}")


def _nested(value: Any, kind: type[Any], what: str) -> Any:
    if not isinstance(value, dict):
        raise CommandError(f"{what} = {value!r}, expected a table")
    return build(kind, dataclass_values(kind, value, what), what)


def _matched(value: Any, option: Any) -> Any:
    """Return the value as this type, or None if it is not of it."""
    origin = get_origin(option)
    if option is float:
        return float(value) if _is_number(value) else None
    if origin is np.ndarray:
        return _array(value)
    if origin is tuple:
        fits = isinstance(value, list) and len(value) == len(get_args(option))
        return tuple(map(float, value)) if fits and all(map(_is_number, value)) else None
    if origin is Literal:
        return value if value in get_args(option) else None
    return value if option in (bool, str) and isinstance(value, option) else None


def _array(value: Any) -> np.ndarray | None:
    try:
        array = np.array(value)
    except ValueError:
        return None
    is_numbers = isinstance(value, list) and array.dtype.kind in "if" and np.isfinite(array).all()
    return array.astype(np.float64) if is_numbers else None


def _is_number(value: Any) -> bool:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return is_number and abs(value) <= sys.float_info.max


def _describe(option: Any) -> str:
    origin = get_origin(option)
    if origin is Literal:
        return " or ".join(map(repr, get_args(option)))
    if origin is np.ndarray:
        return "a list of numbers"
    if origin is tuple:
        return f"a list of {len(get_args(option))} numbers"
    names = {float: "a number", bool: "true or false", str: "text", NoneType: repr(NOTHING)}
    return names.get(option, str(option))
