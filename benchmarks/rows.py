"""One number of the results, and files of them."""

import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

from benchmarks import ResultsError

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
    """One measured number."""

    scenario: str  # name of the benchmark
    plant: str  # plant model of a simulation, ``recording`` for real data
    seed: int  # seed of a simulation, number of the recording for real data
    source: str  # see `Source`
    method: str  # see `Method`
    metric: str  # a name of `metrics.csv`
    value: float  # the number; nan where it could not be determined
    unit: str  # its unit

    @property
    def key(self) -> RowKey:
        """All but value and unit."""
        return RowKey(self.scenario, self.plant, self.seed, self.source, self.method, self.metric)


NAMES = tuple(field.name for field in fields(Row))
SCHEMA = 1
SIGNIFICANT_DIGITS = 6
"""More would only record rounding."""
_KINDS: dict[str, tuple[Any, str]] = {
    "seed": (int, "a whole number"),
    "value": (int | float, "a number or null"),
}
"""What a field must be, where it is not text."""
OLD_NAMES: dict[str, dict[str, str]] = {
    "plant": {"textbook": "ideal", "realistic": "clean", "hard": "degraded"},
    "method": {"paper": "published", "paper-kv": "published-kv"},
    "metric": {
        "exit_residue_pct": "remaining_force_pct",
        "rupture_dating_error_ms": "rupture_timing_error_ms",
        "rupture_overshoot_mm": "detection_depth_error_mm",
        "rupture_dated_depth_error_mm": "estimated_depth_error_mm",
        "falls_per_insertion": "drops_per_insertion",
        "fall_recall": "drop_recall",
        "ruptures_at_falls": "ruptures_at_drops",
        "ruptures_without_fall": "ruptures_without_drop",
        "pullout_above_insertion_share": "pullout_above_insertion_fraction",
        "pullout_left_out_told_median_pct": "pullout_left_out_friction_median_pct",
        "pullout_left_out_told_p90_pct": "pullout_left_out_friction_p90_pct",
    },
}
"""Names in files written before plants, methods and metrics got the field's words: a run of that
time must still be comparable with one of today."""


def to_json(rows: Iterable[Row]) -> str:
    """Rows and nothing else, so that equal runs give equal bytes; not finite becomes null."""
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
    """Read rows from a file; null becomes nan, `OLD_NAMES` become today's.

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
    found: dict[RowKey, Row] = {}
    for number, item in enumerate(rows, 1):
        row = _row(item, f"{path}, row {number}")
        if row.key in found:
            raise ResultsError(f"{path} has more than one row for: {row.key}")
        found[row.key] = row
    return list(_undefined_precision_as_nan(found).values())


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
    values = dict[str, Any](item)
    if values["value"] is None:
        values["value"] = math.nan
    for name, value in values.items():
        kind, wanted = _KINDS.get(name, (str, "text"))
        if isinstance(value, bool) or not isinstance(value, kind):
            raise ResultsError(f"{where}: {name} is {value!r}, expected {wanted}")
    for name, today in OLD_NAMES.items():
        values[name] = today.get(values[name], values[name])
    return Row(**values)


def _undefined_precision_as_nan(found: dict[RowKey, Row]) -> dict[RowKey, Row]:
    """Older files say precision 1 where nothing was detected; today it is undefined there.

    With an alarm, precision is 1 only if that alarm found a rupture or a soft transition. So a
    precision of 1 beside recalls of 0 was written without any alarm.
    """

    def was_silent(row: Row) -> bool:
        recalls = [
            found.get(row.key._replace(metric=name))
            for name in ("rupture_recall", "soft_transition_recall")
        ]
        known = [recall.value for recall in recalls if recall is not None]
        return row.value == 1.0 and bool(known) and not any(known)

    for key, row in found.items():
        if key.metric == "rupture_precision" and was_silent(row):
            found[key] = replace(row, value=math.nan)
    return found
