"""The needle moved in closed loop: every part of the study over seeds, one table,
misses first.

A part is a module ``benchmarks.control.<part>`` with `CASES`, names of its cases, and
``measure(case, plant, seed)``, which yields the figures of one run of some seconds. A
row of the table is the worst of all seeds, or the quantile that the figure names.
Targets are judged on the plant ``clean``; ``fri`` stands beside it.
"""

import json
import math
from collections.abc import Iterable, Sequence
from importlib import import_module
from importlib.util import find_spec
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks import ResultsError, UnknownIdError
from benchmarks.campaign.workers import DIED, Workers, answers
from benchmarks.jobs import Progress
from benchmarks.report.tables import ResultTable, new_console

PREFIX = "control"
PARTS = ("priority", "constraints", "guidance", "teleoperation", "autonomous", "faults")
PLANTS = ("clean", "fri")
JUDGED = "clean"
FIRST_SEED = 1000
"""Controllers are tuned on seeds below."""


class Figure(NamedTuple):
    """One number of one run.

    Attributes:
        what: What was measured, in words; the same for every seed and plant.
        servo: ``S``: stiff; ``I``: joint impedance; empty where both are the same.
        target: The most it may be; None for a number that is shown for reference.
        at_least: Whether the target is the least it may be.
        quantile: Of the seeds, from the good end: 1 is the worst seed, 0.9 the worst of
            the best 90 %.
    """

    what: str
    servo: str
    value: float
    unit: str
    target: float | None = None
    at_least: bool = False
    quantile: float = 1.0


class ControlJob(NamedTuple):
    """One case on one plant with one seed."""

    part: str
    case: str
    plant: str
    seed: int


class ControlRow(NamedTuple):
    """One row of the table for one plant.

    Attributes:
        value: Over the seeds, see `Figure.quantile`; nan where any of them is.
    """

    part: str
    what: str
    servo: str
    plant: str
    value: float
    unit: str
    target: float | None
    at_least: bool
    seeds: int

    @property
    def badness(self) -> float:
        """The number over its target, above 1 for a miss; zero without a target."""
        if self.target is None:
            return 0.0
        if not math.isfinite(self.value):
            return math.inf
        worse = self.target - self.value if self.at_least else self.value - self.target
        return max(1.0 + worse / (abs(self.target) or 1e-12), 0.0)

    @property
    def is_met(self) -> bool:
        """Whether the target is met; so is none."""
        return self.badness <= 1.0


def control_jobs(
    ids: Iterable[str], plants: Sequence[str], first_seed: int | None, seeds: int
) -> list[ControlJob]:
    """All cases of the parts that are asked for: ``control`` for all,
    ``control-<part>`` for one.

    Args:
        ids: What is asked for.
        plants: `PLANTS` when empty.
        first_seed: `FIRST_SEED` when None.
        seeds: So many.

    Raises:
        UnknownIdError: There is no such part.
    """
    known = {PREFIX, *(f"{PREFIX}-{part}" for part in PARTS)}
    if unknown := set(ids) - known:
        raise UnknownIdError(
            f"no part {min(unknown)!r}; choose from: {', '.join(sorted(known))}"
        )
    asked = [part for part in PARTS if {PREFIX, f"{PREFIX}-{part}"} & set(ids)]
    asked = [part for part in asked if find_spec(f"benchmarks.control.{part}")]
    cases = [(part, case) for part in asked for case in _module(part).CASES]
    first = FIRST_SEED if first_seed is None else first_seed
    runs = product(cases, plants or PLANTS, range(first, first + seeds))
    return [ControlJob(*case, plant, seed) for case, plant, seed in runs]


def _module(part: str) -> Any:
    return import_module(f"benchmarks.control.{part}")


def measured(job: ControlJob) -> list[Figure]:
    """The figures of a job; of one that fails, a missed one that says why."""
    try:
        return list(_module(job.part).measure(job.case, job.plant, job.seed))
    except Exception as error:  # it must not take hours of others with it
        why = f"{job.case} failed: {type(error).__name__}: {error}"
        return [Figure(why, "", math.nan, "", 0.0)]


def run_control(
    jobs: Sequence[ControlJob], workers: Workers, progress: Progress
) -> list[ControlRow]:
    """Let workers do all jobs, and join their seeds."""
    found: dict[int, list[Figure]] = {}
    for index, figures in answers(measured, jobs, workers):
        died = Figure(f"{jobs[index].case} failed: {DIED}", "", math.nan, "", 0.0)
        found[index] = [died] if figures is None else figures
        progress(len(found) / len(jobs))
    return _rows((job, found[index]) for index, job in enumerate(jobs))


def _rows(found: Iterable[tuple[ControlJob, list[Figure]]]) -> list[ControlRow]:
    groups: dict[tuple[Any, ...], list[Figure]] = {}
    seeds: dict[tuple[Any, ...], set[int]] = {}  # one may have several such figures
    for job, figures in found:
        for figure in figures:
            key = (job.part, figure.what, figure.servo, job.plant, figure.unit)
            groups.setdefault(key, []).append(figure)
            seeds.setdefault(key, set()).add(job.seed)
    rows = []
    for key, figures in groups.items():
        part, what, servo, plant, unit = key
        first = figures[0]
        values = sorted((float(item.value) for item in figures), reverse=first.at_least)
        value = values[math.ceil(first.quantile * len(values) - 1e-9) - 1]
        if not all(map(math.isfinite, values)):
            value = math.nan
        rows.append(
            ControlRow(
                part,
                what,
                servo,
                plant,
                value,
                unit,
                first.target,
                first.at_least,
                len(seeds[key]),
            )
        )
    return rows


def control_table(rows: Iterable[ControlRow]) -> ResultTable:
    """All rows, plants side by side, those that miss their target most at the top."""
    lines: dict[tuple[str, ...], dict[str, ControlRow]] = {}
    for row in rows:
        lines.setdefault((row.part, row.what, row.servo, row.unit), {})[row.plant] = row
    plants = list(dict.fromkeys(row.plant for row in rows))

    def badness(found: dict[str, ControlRow]) -> float:
        return found[JUDGED].badness if JUDGED in found else 0.0

    ordered = sorted(lines.items(), key=lambda item: -badness(item[1]))
    return ResultTable(
        title="The needle in closed loop",
        heads=("part", "what", "servo", *plants, "target", "unit", ""),
        align="Lll" + "r" * len(plants) + "rlL",
        lines=tuple(
            (
                *key[:3],
                *(
                    f"{found[plant].value:.3g}" if plant in found else ""
                    for plant in plants
                ),
                _target(next(iter(found.values()))),
                key[3],
                _evaluation(found.get(JUDGED)),
            )
            for key, found in ordered
        ),
        caption=f"worst of {max((row.seeds for row in rows), default=0)} seeds unless said; targets"
        f" judged on {JUDGED}. Simulation only: not a medical device.",
    )


def _target(row: ControlRow) -> str:
    return (
        "" if row.target is None else f"{'≥' if row.at_least else '≤'} {row.target:g}"
    )


def _evaluation(row: ControlRow | None) -> str:
    if row is None or row.target is None:
        return ""
    return "met" if row.is_met else "missed"


def show_control(rows: Sequence[ControlRow], to: Path | None) -> list[ControlRow]:
    """Print the table, write rows to a file if one is named, and return those that
    are judged.
    """
    new_console().print(control_table(rows).rich())
    if to is not None:
        write_control(to, rows)
    return [row for row in rows if row.plant == JUDGED]


def write_control(path: Path, rows: Iterable[ControlRow]) -> None:
    """Write rows as JSON; what is not finite becomes null. `ResultsError` where it
    cannot.
    """
    lines = []
    for row in rows:
        value = float(f"{row.value:.6g}") if math.isfinite(row.value) else None
        met = None if row.target is None else row.is_met
        lines.append(json.dumps(row._asdict() | {"value": value, "met": met}))
    try:
        path.write_text(
            '{"rows": [\n  ' + ",\n  ".join(lines) + "\n]}\n", encoding="utf-8"
        )
    except OSError as error:
        raise ResultsError(f"cannot write {path}: {error.strerror}") from error
