"""One number of the results, files of them, and every metric a row may carry.

Columns of `metrics.csv`: `name` ends with the unit, see `UNITS`; `table` is the table
of `benchmarks.report.tables` that shows the metric (``none``: it stands in the results
only);
`best`, `tolerance` and `relative_tolerance` say which change is one for the worse;
`meaning` is one line. A relative tolerance of 1 marks a number shown for reference, by
which nothing is judged.
"""

import csv
import math
import subprocess
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from sys import intern
from typing import Literal, NamedTuple, SupportsFloat

import msgspec

from benchmarks import ResultsError, UnknownMetricError

Source = Literal["ft", "virtual"]
"""Which force: read by the F/T sensor, or estimated from joint signals. Studies without
a force name here what was measured, such as a scan or a fault."""
Method = Literal[
    "published-one-setting",
    "published-as-authors-ran",
    "published-best-gain",
    "published",
    "rule-of-thumb",
    "ours",
]
"""Whose method. What does not depend on it stands under ``ours``.

``published-one-setting`` is the method of Ferro et al. with one setting and the
measured speed, as ours; ``published-as-authors-ran`` has commanded speed and σ₁ chosen
for each recording; ``published-best-gain`` is that with the gain of the observer that
suits the recording best, where theirs is 5/s. ``published`` is a published method of
control. ``rule-of-thumb`` is what an identification worth having must beat."""

METHOD_NAMES: Mapping[str, str] = {
    "published-one-setting": "published, one setting",
    "published-as-authors-ran": "published, as its authors ran it",
    "published-best-gain": "published, best gain",
    "published": "published",
    "rule-of-thumb": "rule of thumb (0.7 of the force)",
    "ours": "needleforce",
}
"""Methods as people read them."""


class RowKey(NamedTuple):
    """What makes two rows of two runs comparable.

    Attributes:
        scenario: As in `Row`.
        plant: As in `Row`.
        seed: As in `Row`.
        source: As in `Row`.
        method: As in `Row`.
        metric: As in `Row`.
    """

    scenario: str
    plant: str
    seed: int
    source: str
    method: str
    metric: str

    def __str__(self) -> str:
        """One line for people."""
        return " ".join(map(str, self))


class Row(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One measured number.

    Attributes:
        scenario: Name of the benchmark and, where it has several, of the case.
        plant: Plant model of a simulation, ``recording`` for real data, ``no-arm``
            where none plays a part.
        seed: Seed of a simulation, number of the recording for real data.
        source: See `Source`.
        method: See `Method`.
        metric: A name of `metrics.csv`.
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
        return RowKey(
            self.scenario, self.plant, self.seed, self.source, self.method, self.metric
        )


NAMES = Row.__struct_fields__
TEXTS = tuple(name for name in NAMES if name not in ("seed", "value"))
Runs = Mapping[str, int] | None  # how many rows each has given, where that is known
SIGNIFICANT_DIGITS = 6
"""More would only record rounding."""


def to_json(rows: Iterable[Row], runs: Runs = None, commit: str = "") -> bytes:
    """Return rows, how many each run has and their commit as JSON.

    Equal runs give equal bytes; what is not finite becomes null.
    """
    lines = b",\n  ".join(map(_line, rows))
    more = b"" if runs is None else b', "runs": %b' % msgspec.json.encode(runs)
    more += b', "commit": %b' % msgspec.json.encode(commit) if commit else b""
    return b'{"schema": 1, "rows": [\n  %b\n]%b}\n' % (lines, more)


def find_commit() -> str:
    """Return the commit of this project, empty where it is no clone.

    Of a clone in which files are changed it ends with ``-dirty``.
    """
    folder = Path(__file__).resolve().parents[1]
    command = [
        "git",
        "-C",
        str(folder),
        "describe",
        "--always",
        "--dirty",
        "--abbrev=8",
    ]
    try:
        answer = subprocess.run(command, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return ""
    return answer.stdout.strip()


def _line(row: Row) -> bytes:
    """Return a row as JSON, with six digits."""
    value = float(f"{row.value:.{SIGNIFICANT_DIGITS}g}")
    return msgspec.json.encode(msgspec.structs.replace(row, value=value))


def write_results(
    path: str | Path, rows: Iterable[Row], runs: Runs = None, commit: str = ""
) -> None:
    """Write rows to a file, whole or not at all.

    Raises `ResultsError` where that cannot be.
    """
    from needleforce.plots import FiguresError
    from needleforce.plots.drawing import write_file

    try:
        write_file(path, to_json(rows, runs, commit))
    except FiguresError as error:
        raise ResultsError(str(error)) from error


class _Line(Row, frozen=True, kw_only=True):
    """A row as it stands in a file: null for a number that is not finite."""

    value: float | None  # pyright: ignore[reportIncompatibleVariableOverride]


class _File(msgspec.Struct):
    """A file of results."""

    schema: Literal[1]
    rows: list[msgspec.Raw]
    commit: str = ""


_decode_line = msgspec.json.Decoder(_Line).decode


def read_results(path: str | Path) -> list[Row]:
    """Read rows from a file; null becomes nan.

    Raises:
        ResultsError: The file cannot be read, is not JSON of this schema, lacks a
            field, or has two rows with one key.
    """
    try:
        lines = msgspec.json.decode(Path(path).read_bytes(), type=_File).rows
        rows = [_row(_decode_line(line)) for line in lines]
    except OSError as error:
        raise ResultsError(f"cannot read {path}: {error.strerror}") from error
    except msgspec.ValidationError as error:
        raise ResultsError(f"{path} is not a file of results: {error}") from error
    except (msgspec.DecodeError, ValueError) as error:
        raise ResultsError(f"{path} is not JSON: {error}") from error
    keys: set[RowKey] = set()
    for row in rows:
        if row.key in keys:
            raise ResultsError(f"{path} has more than one row for: {row.key}")
        keys.add(row.key)
    return rows


def _row(line: _Line) -> Row:
    """Return the row of a line; each text is kept once: a campaign has millions."""
    texts = {name: intern(getattr(line, name)) for name in TEXTS}
    return Row(
        seed=line.seed, value=math.nan if line.value is None else line.value, **texts
    )


def read_commit(path: str | Path) -> str:
    """Return the commit of the code that gave a file of results; empty if unknown.

    Raises:
        ResultsError: The file cannot be read, or is not one of results.
    """
    try:
        return msgspec.json.decode(Path(path).read_bytes(), type=_File).commit
    except (OSError, msgspec.DecodeError) as error:
        raise ResultsError(f"cannot read {path}: {error}") from error


def read_merged(paths: Sequence[str | Path]) -> list[Row]:
    """Read several files; a later one replaces the same scenario and plant."""
    by_scenario: dict[tuple[str, str], list[Row]] = {}
    for path in paths:
        rows = read_results(path)
        by_scenario |= {(row.scenario, row.plant): [] for row in rows}
        for row in rows:
            by_scenario[row.scenario, row.plant].append(row)
    return [row for rows in by_scenario.values() for row in rows]


UNITS = {
    "_Ns_per_m": "Ns/m",
    "_mm_per_rad": "mm/rad",
    "_mm_per_s": "mm/s",
    "_rad_per_s": "rad/s",
    "_rad": "rad",
    "_mJ": "mJ",
    "_voxel": "voxel",
    "_GB": "GB",
    "_Nm": "Nm",
    "_N": "N",
    "_mm": "mm",
    "_ms": "ms",
    "_pct": "%",
    "_s": "s",
}
"""By the end of a metric's name; a name that ends otherwise is that of a fraction or
a count."""


class Metric(msgspec.Struct, frozen=True, kw_only=True):
    """One kind of number.

    Attributes:
        name: As in the results.
        table: The table that shows it.
        meaning: One line.
        best: The value wished for: 0 for an error, 1 for a recall, 0.95 for a coverage.
        tolerance: Absolute worsening that is not called a regression, in the metric's
            unit.
        relative_tolerance: The same as a fraction of the old distance from ``best``;
            the larger of the two counts.
    """

    name: str
    table: str
    meaning: str
    best: float
    tolerance: float
    relative_tolerance: float

    @property
    def unit(self) -> str:
        """As in the results; ``1`` for none."""
        return next(
            (unit for end, unit in UNITS.items() if self.name.endswith(end)), "1"
        )

    @property
    def may_be_undefined(self) -> bool:
        """Whether nan is a result: without an alarm there is no precision."""
        return self.name == "rupture_precision"

    def is_regression(self, old: float, new: float) -> bool:
        """Return whether the new value is worse beyond tolerance.

        A number that is not finite always is.
        """
        if not (math.isfinite(old) and math.isfinite(new)):
            return not math.isfinite(new)
        allowed = max(self.tolerance, self.relative_tolerance * abs(old - self.best))
        return abs(new - self.best) - abs(old - self.best) > allowed


def table_lines(path: Path) -> Iterator[dict[str, str]]:
    """Yield the lines of one of this package's data tables by column.

    ``#`` begins a comment line.
    """
    with path.open(encoding="utf-8", newline="") as lines:
        yield from csv.DictReader(line for line in lines if not line.startswith("#"))


METRICS: Mapping[str, Metric] = {
    line["name"]: msgspec.convert(line, Metric, strict=False)
    for line in table_lines(Path(__file__).with_name("metrics.csv"))
}
"""By name."""


def metric(name: str) -> Metric:
    """Return the metric of that name.

    Raises:
        UnknownMetricError: There is none.
    """
    try:
        return METRICS[name]
    except KeyError:
        raise UnknownMetricError(
            f"no metric {name!r}; known: {', '.join(METRICS)}"
        ) from None


class Measurement(NamedTuple):
    """One measured number, before it is known which job it belongs to.

    Attributes:
        source: See `Source`.
        method: See `Method`.
        metric: A name of `metrics.csv`.
        value: The number; nan where it could not be determined.
    """

    source: str
    method: Method
    metric: str
    value: float

    def row(self, scenario: str, plant: str, seed: int) -> Row:
        """Return the row of a job's results.

        Raises:
            UnknownMetricError: `metrics.csv` lacks the metric.
        """
        return Row(
            scenario=scenario,
            plant=plant,
            seed=seed,
            source=self.source,
            method=self.method,
            metric=self.metric,
            value=float(self.value),
            unit=metric(self.metric).unit,
        )


def our_measurement(
    metric: str, value: SupportsFloat, source: str = "virtual"
) -> Measurement:
    """Return a number of our method, by default on the virtual sensor's force."""
    return Measurement(source, "ours", metric, float(value))
