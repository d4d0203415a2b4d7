"""Column mappings written by hand as a small TOML file."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from recordings.columns.mapping import ColumnMapping
from recordings.columns.spec import ColumnSpec
from recordings.errors import FormatError, MappingError
from recordings.toml_file import read_toml

_KEYS = ("columns", "unit", "scale")


def load_mapping(path: str | Path) -> ColumnMapping:
    """Read a column mapping from a TOML file.

    Each channel is a table with `columns` and, if needed, `unit` and `scale`, or just the columns
    (`depth = "z"`). At the top may stand `rate_hz`, `joints`, `clock` and `payload`, see
    `ColumnMapping`.

    Args:
        path: the TOML file.

    Returns:
        The mapping.

    Raises:
        FileAccessError: the file cannot be read.
        MappingError: it is not TOML, or a channel, key, unit or value in it is not valid.
    """
    try:
        content = read_toml(path, "mapping")
    except FormatError as error:
        raise MappingError(str(error)) from error
    try:
        return _mapping(content)
    except MappingError as error:
        raise MappingError(f"{path}: {error}") from error


def _mapping(content: Mapping[str, Any]) -> ColumnMapping:
    entries = dict(content)
    rate_hz = entries.pop("rate_hz", None)
    if rate_hz is not None and not _is_number(rate_hz):
        raise MappingError(f"rate_hz = {rate_hz!r} must be a number")
    joints, clock = entries.pop("joints", []), entries.pop("clock", None)
    if not (isinstance(joints, list) and all(isinstance(name, str) for name in joints)):
        raise MappingError(f"joints = {joints!r} must be a list of names")
    if not (clock is None or isinstance(clock, str)):
        raise MappingError(f"clock = {clock!r} must be the name of a topic")
    payload = entries.pop("payload", None)
    return ColumnMapping(
        channels={name: _spec(name, entry) for name, entry in entries.items()},
        rate_hz=rate_hz,
        joints=tuple(joints),
        clock=clock,
        payload=payload,
    )


def _spec(name: str, entry: Any) -> ColumnSpec:
    if not isinstance(entry, dict):
        entry = {"columns": entry}
    unknown = [key for key in entry if key not in _KEYS]
    if unknown or "columns" not in entry:
        raise MappingError(
            f"[{name}] has the keys {', '.join(entry) or 'none'}; "
            "it needs columns, and may have unit and scale"
        )
    unit = entry.get("unit")
    if not (unit is None or isinstance(unit, str)):
        raise MappingError(f"[{name}] unit = {unit!r} must be text")
    return ColumnSpec(
        columns=_columns(name, entry["columns"]), unit=unit, scale=_scale(name, entry)
    )


def _columns(name: str, value: Any) -> str | tuple[str, ...]:
    if isinstance(value, str):
        return value
    if isinstance(value, list) and all(isinstance(item, str) for item in value):
        return tuple(value)
    raise MappingError(f"[{name}] columns = {value!r} must be a name or a list of names")


def _scale(name: str, entry: Mapping[str, Any]) -> float | tuple[float, ...]:
    value = entry.get("scale", 1.0)
    if _is_number(value):
        return float(value)
    if isinstance(value, list) and all(map(_is_number, value)):
        return tuple(map(float, value))
    raise MappingError(f"[{name}] scale = {value!r} must be a number or a list of numbers")


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
