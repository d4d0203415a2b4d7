"""Validated dataclasses from tables of TOML files, with errors that name the key."""

from collections.abc import Mapping
from dataclasses import asdict, fields, is_dataclass
from difflib import get_close_matches
from typing import Any, TypeVar, get_args, get_type_hints

import msgspec
import numpy as np

from foundation.arrays import Array
from needleforce.cli.terminal import CommandError

T = TypeVar("T")

NOTHING = "none"
"""How a file says None, for which TOML has no word."""


def convert_table(kind: type[T], table: Any, where: str, preset: Any = None) -> T:
    """Return a dataclass with the values of a table.

    Args:
        kind: A dataclass of numbers, text, choices, arrays and further dataclasses.
        table: What TOML gives.
        where: File and table, as messages name them.
        preset: Instance with the values that the table does not give.

    Raises:
        CommandError: A key is unknown, or its value does not fit.
    """
    if not isinstance(table, dict):
        raise CommandError(f"{where} is {type(table).__name__}, expected a table")
    _require_known_keys(kind, table, where)
    values = {} if preset is None else asdict(preset)
    for name, value in table.items():
        if value == NOTHING:
            values[name] = None
        elif isinstance(value, dict) and isinstance(values.get(name), dict):
            values[name] = values[name] | value
        else:
            values[name] = value
    # msgspec asks for fields that are no arguments, too; __post_init__ replaces these
    # values.
    declared: Any = kind
    values |= {item.name: [0.0] for item in fields(declared) if not item.init}
    try:
        return msgspec.convert(values, kind, dec_hook=_convert_array)
    except (msgspec.ValidationError, OverflowError) as error:
        problem, _, key = str(error).replace("`", "").partition(" - at $.")
        if problem.startswith("Invalid enum value"):
            choices = get_args(get_type_hints(kind)[key])
            problem += f", expected {' or '.join(map(repr, choices))}"
        problem = problem.replace("null", repr(NOTHING)).replace("object", "table")
        raise CommandError(f"{where}: {key}{': ' if key else ''}{problem}") from error


def _require_known_keys(kind: Any, table: Mapping[str, Any], where: str) -> None:
    """Refuse keys that are no fields of a dataclass, or of one inside it."""
    hints = get_type_hints(kind)
    known = [item.name for item in fields(kind) if item.init]
    for name, value in table.items():
        if name not in known:
            near = get_close_matches(name, known, n=1)
            hint = f"did you mean {near[0]}? " if near else ""
            raise CommandError(
                f"{where}: unknown key {name!r}; {hint}known are: {', '.join(known)}",
            )
        if is_dataclass(hints[name]) and isinstance(value, dict):
            _require_known_keys(hints[name], value, f"{where}: {name}")


def _convert_array(_kind: Any, value: Any) -> Array:
    """Return a list of numbers as an array; used by msgspec."""
    try:
        array = np.array(value, dtype=np.float64)
    except (ValueError, TypeError, OverflowError):
        array = np.array(np.nan)
    if not (array.ndim and np.isfinite(array).all()):
        raise ValueError("Expected a list of finite numbers")
    return array
