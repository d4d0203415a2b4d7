"""One number of the results, and files of them."""

import math
import subprocess
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from sys import intern
from typing import Literal, NamedTuple, SupportsFloat

import msgspec

from benchmarks import ResultsError

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

UNITS = {
    "_Ns_per_m": "Ns/m",
    "_mm_per_rad": "mm/rad",
    "_mm_per_s": "mm/s",
    "_rad_per_s": "rad/s",
    "_rad": "rad",
    "_mJ": "mJ",
    "_voxel": "voxel",
    "_GB": "GB",
    "_MB": "MB",
    "_kB": "kB",
    "_Hz": "Hz",
    "_Nm": "Nm",
    "_N": "N",
    "_mm": "mm",
    "_us": "us",
    "_ms": "ms",
    "_pct": "%",
    "_s": "s",
}
"""By the end of a metric's name; a name that ends otherwise is that of a fraction or
a count."""


def unit_of(metric: str) -> str:
    """Return the unit of a metric; ``1`` for none."""
    return next((unit for end, unit in UNITS.items() if metric.endswith(end)), "1")


class Row(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One measured number.

    Attributes:
        scenario: Name of the benchmark and, where it has several, of the case.
        plant: Plant model of a simulation, ``recording`` for real data, ``no-arm``
            where none plays a part.
        seed: Seed of a simulation, number of the recording for real data.
        source: See `Source`.
        method: See `Method`.
        metric: A name of `judged.toml`.
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
    def key(self) -> tuple[str | int, ...]:
        """All but value and unit: what makes rows of two runs comparable."""
        return tuple(getattr(self, name) for name in KEYS)


NAMES = Row.__struct_fields__
KEYS = NAMES[:6]


class Figure(NamedTuple):
    """One measured number, before it is known which job it belongs to.

    Attributes:
        metric: A name of `judged.toml`.
        value: The number; nan where it could not be determined.
        source: See `Source`.
        method: See `Method`.
    """

    metric: str
    value: SupportsFloat
    source: str = "virtual"
    method: Method = "ours"

    def row(self, scenario: str, plant: str, seed: int) -> Row:
        """Return the row of a job's results."""
        return Row(
            scenario=scenario,
            plant=plant,
            seed=seed,
            source=self.source,
            method=self.method,
            metric=self.metric,
            value=float(self.value),
            unit=unit_of(self.metric),
        )


def make_figures(
    values: Mapping[str, SupportsFloat],
    source: str = "virtual",
    method: Method = "ours",
) -> list[Figure]:
    """Return numbers by name as those of one source and method."""
    return [Figure(name, value, source, method) for name, value in values.items()]


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


def _line(row: Row) -> bytes:
    """Return a row as JSON, with six digits."""
    value = float(f"{row.value:.{SIGNIFICANT_DIGITS}g}")
    return msgspec.json.encode(msgspec.structs.replace(row, value=value))


def find_commit() -> str:
    """Return the commit of this project, empty where it is no clone.

    Of a clone in which files are changed it ends with ``-dirty``.
    """
    folder = str(Path(__file__).resolve().parents[1])
    describe = ["describe", "--always", "--dirty", "--abbrev=8"]
    command = ["git", "-C", folder, *describe]
    try:
        answer = subprocess.run(command, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return ""
    return answer.stdout.strip()


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


class ResultsFile(msgspec.Struct):
    """A file of results.

    Attributes:
        schema: Of the file.
        rows: Each as it stands there.
        runs: How many rows each run has given.
        commit: Of the code that gave them; empty if unknown.
    """

    schema: Literal[1]
    rows: list[msgspec.Raw]
    runs: dict[str, int] = {}
    commit: str = ""


_decode_line = msgspec.json.Decoder(_Line).decode


def read_file(path: str | Path) -> tuple[list[Row], ResultsFile]:
    """Read rows from a file, and what stands beside them; null becomes nan.

    Raises:
        ResultsError: The file cannot be read, is not JSON of this schema, lacks a
            field, or has two rows with one key.
    """
    try:
        file = msgspec.json.decode(Path(path).read_bytes(), type=ResultsFile)
        rows = [_row(_decode_line(line)) for line in file.rows]
    except OSError as error:
        raise ResultsError(f"cannot read {path}: {error.strerror}") from error
    except msgspec.ValidationError as error:
        raise ResultsError(f"{path} is not a file of results: {error}") from error
    except (msgspec.DecodeError, ValueError) as error:
        raise ResultsError(f"{path} is not JSON: {error}") from error
    keys = set()
    for row in rows:
        if row.key in keys:
            named = " ".join(map(str, row.key))
            raise ResultsError(f"{path} has more than one row for: {named}")
        keys.add(row.key)
    return rows, file


def _row(line: _Line) -> Row:
    """Return the row of a line; each text is kept once: a campaign has millions."""
    texts = {
        name: intern(getattr(line, name)) for name in (*KEYS, "unit") if name != "seed"
    }
    return Row(
        seed=line.seed, value=math.nan if line.value is None else line.value, **texts
    )


def read_results(path: str | Path) -> list[Row]:
    """Read rows from a file, see `read_file`."""
    return read_file(path)[0]


def read_merged(paths: Sequence[str | Path]) -> list[Row]:
    """Read several files; a later one replaces the same scenario and plant."""
    by_scenario: dict[tuple[str, str], list[Row]] = {}
    for path in paths:
        rows = read_results(path)
        by_scenario |= {(row.scenario, row.plant): [] for row in rows}
        for row in rows:
            by_scenario[row.scenario, row.plant].append(row)
    return [row for rows in by_scenario.values() for row in rows]
