"""Validated dataclasses from tables of TOML files, with errors that name the key."""

from collections.abc import Mapping
from dataclasses import asdict, fields, is_dataclass
from difflib import get_close_matches
from typing import Any, TypeVar, get_args, get_type_hints

import msgspec
import numpy as np

from needleforce.cli.terminal import CommandError

# A validated dataclass from a table of a TOML file, with errors that name the key.

T = TypeVar("T")


NOTHING = "none"  # how a file says None, for which TOML has no word


def decoded(kind: type[T], table: Any, where: str, preset: Any = None) -> T:
    """Return a dataclass with the values of a table as TOML gives it.

    The dataclass has numbers, text, choices, arrays and further dataclasses; ``where``
    names file and table in messages; a preset has the values that the table does not
    give.
    """
    if not isinstance(table, dict):
        raise CommandError(f"{where} is {type(table).__name__}, expected a table")
    _require_known(kind, table, where)
    values = {} if preset is None else asdict(preset)
    for name, value in table.items():
        is_inner = isinstance(value, dict) and isinstance(values.get(name), dict)
        values[name] = (
            values[name] | value if is_inner else None if value == NOTHING else value
        )
    # msgspec asks for fields that are no arguments, too; __post_init__ replaces these
    # values.
    declared: Any = kind
    values |= {item.name: [0.0] for item in fields(declared) if not item.init}
    try:
        return msgspec.convert(values, kind, dec_hook=_array)
    except (msgspec.ValidationError, OverflowError) as error:
        what, _, key = str(error).replace("`", "").partition(" - at $.")
        if what.startswith("Invalid enum value"):
            what += f", expected {' or '.join(map(repr, get_args(get_type_hints(kind)[key])))}"
        what = what.replace("null", repr(NOTHING)).replace("object", "table")
        raise CommandError(f"{where}: {key}{': ' if key else ''}{what}") from error


def _require_known(kind: Any, table: Mapping[str, Any], where: str) -> None:
    hints = get_type_hints(kind)
    known = [item.name for item in fields(kind) if item.init]
    for name, value in table.items():
        if name not in known:
            near = get_close_matches(name, known, n=1)
            hint = f"did you mean {near[0]}? " if near else ""
            listed = ", ".join(known)
            raise CommandError(
                f"{where}: unknown key {name!r}; {hint}known are: {listed}"
            )
        if is_dataclass(hints[name]) and isinstance(value, dict):
            _require_known(hints[name], value, f"{where}: {name}")


def _array(_kind: Any, value: Any) -> np.ndarray:
    try:
        array = np.array(value, dtype=np.float64)
    except (ValueError, TypeError, OverflowError):
        array = np.array(np.nan)
    if not (array.ndim and np.isfinite(array).all()):
        raise ValueError("Expected a list of finite numbers")
    return array
