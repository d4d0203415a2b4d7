"""One number of the verdict, and the words that say where it comes from."""

import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Literal, NamedTuple

from benchmarks.errors import ResultsError

Source = Literal["ft", "virtual"]
"""Which force: read by the F/T sensor, or estimated from joint signals."""
Method = Literal["published", "default", "guess"]
"""Whose method: as published, or ours. What does not depend on it stands under ``default``;
``guess`` is a rule of thumb that an identification worth having must beat."""


class RowKey(NamedTuple):
    """What makes two rows of two runs comparable."""

    scenario: str
    plant: str
    seed: int
    source: str
    method: str
    metric: str

    def __str__(self) -> str:
        """One line for people."""
        return " ".join(map(str, self))


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One measured number.

    Attributes:
        scenario: Name of the benchmark.
        plant: Arm level of a simulation, ``recording`` for real data.
        seed: Seed of a simulation, number of the recording for real data.
        source: See `Source`.
        method: See `Method`.
        metric: A name of `benchmarks.metric_catalogue`.
        value: The number; nan where it could not be determined.
        unit: Its unit.
    """

    scenario: str
    plant: str
    seed: int
    source: str
    method: str
    metric: str
    value: float
    unit: str

    @property
    def key(self) -> RowKey:
        """All but value and unit."""
        return RowKey(self.scenario, self.plant, self.seed, self.source, self.method, self.metric)


# Results as JSON: rows and nothing else, so that equal runs give equal bytes.


SCHEMA = 1
SIGNIFICANT_DIGITS = 6
"""More would only record rounding."""

NAMES = tuple(field.name for field in fields(Row))
_KINDS: dict[str, tuple[Any, str]] = {
    "seed": (int, "a whole number"),
    "value": (int | float, "a number or null"),
}
"""What a field must be, where it is not text."""


def to_json(rows: Iterable[Row]) -> str:
    """Rows as text; a value that is not finite becomes null, which JSON can say."""
    lines = ",\n".join("  " + json.dumps(_plain(row), allow_nan=False) for row in rows)
    return f'{{"schema": {SCHEMA}, "rows": [\n{lines}\n]}}\n'


def write_results(path: str | Path, rows: Iterable[Row]) -> None:
    """Write rows to a file.

    Raises:
        ResultsError: The file cannot be written.
    """
    try:
        Path(path).write_text(to_json(rows), encoding="utf-8")
    except OSError as error:
        raise ResultsError(f"cannot write {path}: {error.strerror}") from error


def read_results(path: str | Path) -> list[Row]:
    """Read rows from a file; null becomes nan.

    Raises:
        ResultsError: The file cannot be read, is not JSON of this schema, lacks a field, or has
            two rows with one key.
    """
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise ResultsError(f"cannot read {path}: {error.strerror}") from error
    except ValueError as error:
        raise ResultsError(f"{path} is not JSON: {error}") from error
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise ResultsError(f'{path} is not a file of results: expected {{"schema": {SCHEMA}, ...}}')
    rows = content.get("rows")
    if not isinstance(rows, list):
        raise ResultsError(f'{path} has no list of "rows"')
    found = [_row(item, f"{path}, row {number}") for number, item in enumerate(rows, 1)]
    keys = [row.key for row in found]
    if len(set(keys)) != len(keys):
        twice = next(key for key in keys if keys.count(key) > 1)
        raise ResultsError(f"{path} has more than one row for: {twice}")
    return found


def read_merged(paths: Sequence[str | Path]) -> list[Row]:
    """Rows of several files; a later one replaces what was measured of the same scenario and plant.

    Raises:
        ResultsError: As `read_results`.
    """
    found: dict[tuple[str, str], list[Row]] = {}
    for path in paths:
        rows: dict[tuple[str, str], list[Row]] = {}
        for row in read_results(path):
            rows.setdefault((row.scenario, row.plant), []).append(row)
        found |= rows
    return [row for rows in found.values() for row in rows]


def _plain(row: Row) -> dict[str, Any]:
    value = float(f"{row.value:.{SIGNIFICANT_DIGITS}g}") if math.isfinite(row.value) else None
    return asdict(row) | {"value": value}


def _row(item: Any, where: str) -> Row:
    if not isinstance(item, dict) or set(item) != set(NAMES):
        raise ResultsError(f"{where}: expected the fields {', '.join(NAMES)}")
    values: dict[str, Any] = item | {"value": math.nan if item["value"] is None else item["value"]}
    for name, value in values.items():
        kind, wanted = _KINDS.get(name, (str, "text"))
        if isinstance(value, bool) or not isinstance(value, kind):
            raise ResultsError(f"{where}: {name} is {value!r}, expected {wanted}")
    return Row(**values)
