"""The gate: what a stranger sees of this toolkit, beside what it was.

`judged.toml` says which figures of insertions are kept; those of time are here.
"""

import math
from collections.abc import Callable, Collection, Iterable, Sequence
from ctypes import CDLL
from importlib.metadata import version
from pathlib import Path
from time import thread_time_ns
from typing import Any, Literal

import msgspec
import numpy as np

from benchmarks import ResultsError
from benchmarks.catalogue import Plan, Request, make_plan
from benchmarks.insertion.signals import JointSignals
from benchmarks.jobs import Progress, progress_part
from benchmarks.judging import (
    KEPT_FIGURES,
    Comparison,
    compare_number,
    metric,
    sum_up,
)
from benchmarks.performance import control, kdl, ticks
from benchmarks.performance.ticks import Update, cost_ratio
from benchmarks.report.tables import ResultTable, comparison_table
from benchmarks.results import SIGNIFICANT_DIGITS, Row, find_commit
from foundation.arrays import Array
from groundtruth import Run, simulate

HEADLINE_FILE = Path(__file__).with_name("headline.json")
SCENARIOS = (
    "gel-25-constant",
    "gel-50-constant",
    "gel-70-constant",
    "stack-constant",
)
PLANTS = ("clean", "fri")
SEED = 1000
PASSES = 3
"""Of the same updates, of which the fastest counts: other processes only add time."""
OF_PINOCCHIO = "x Pinocchio"
OF_KDL = "x KDL"
"""Units of a ratio of time."""


class KeptNumber(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One number of the gate.

    Attributes:
        name: For people, and what two files are compared by.
        value: The number; None where it could not be determined.
        unit: Its unit.
        best: The value wished for: what is farther from it is worse.
        tolerance: What may change, in the unit.
        relative_tolerance: The same as a fraction of the distance from `best`.
    """

    name: str
    value: float | None
    unit: str
    best: float
    tolerance: float
    relative_tolerance: float


class HeadlineFile(msgspec.Struct, frozen=True, kw_only=True):
    """All figures of a commit.

    Attributes:
        commit: What was measured; it ends with ``-dirty`` where files had changes.
        versions: Of libraries that change rounding or time.
        figures: In the order of the table.
        schema: Of the file.
    """

    commit: str
    versions: dict[str, str]
    figures: tuple[KeptNumber, ...]
    schema: Literal[1] = 1


def keep_number(name: str, value: float, unit: str, **judged: float) -> KeptNumber:
    """Return a number as it stands in the file: rounded, and None for no number."""
    rounded = float(f"{value:.{SIGNIFICANT_DIGITS}g}")
    known = rounded if math.isfinite(rounded) else None
    numbers: dict[str, Any] = judged
    return KeptNumber(name=name, value=known, unit=unit, **numbers)


def plan_insertions() -> Plan:
    """Return the insertions of the gate."""
    request = Request(ids=SCENARIOS, plants=PLANTS, seeds=1, first_seed=SEED)
    return make_plan(request)


def insertion_figures(rows: Iterable[Row]) -> list[KeptNumber]:
    """Return the kept figures of insertions by plant and source.

    One that an insertion lacks, as the delay where no rupture was found, is no number.
    """
    values = {
        (row.plant, row.source, row.metric, row.scenario): row.value
        for row in rows
        if row.method == "ours" and row.seed == SEED
    }
    figures: list[KeptNumber] = []
    for plant in PLANTS:
        for source in ("ft", "virtual"):
            for item in KEPT_FIGURES:
                if source not in item.sources:
                    continue
                numbers = [
                    values.get((plant, source, item.metric, scenario), math.nan)
                    for scenario in SCENARIOS
                ]
                kind = metric(item.metric)
                figure = keep_number(
                    f"{plant}, {source}: {item.what}",
                    sum_up(numbers, item.statistic, abs),
                    kind.unit,
                    best=kind.best,
                    tolerance=item.tolerance,
                    relative_tolerance=item.relative_tolerance,
                )
                figures.append(figure)
    return figures


def measure_times(progress: Progress, library: CDLL | None) -> list[KeptNumber]:
    """Time everything beside its yardstick, one after the other, in this process.

    Nothing else should run meanwhile. Without KDL there are no figures `OF_KDL`.
    """
    to_simulate = progress_part(progress, 0.0, 0.25)
    run = simulate(ticks.SCENARIO, ticks.PLANT, SEED, to_simulate)
    figures = _time_estimators(run)
    figures += _time_control(progress_part(progress, 0.6, 0.9))
    if library is not None:
        taken = kdl.peer_times(run, library)
        figures += [
            keep_ratio(what, cost_ratio(taken[name], taken[kdl.KDL]), OF_KDL)
            for name, what in (
                (kdl.OURS, "observer and wrench"),
                (kdl.SENSOR, "sensor"),
            )
        ]
    progress(1.0)
    return figures


def take_fastest(measure: Callable[[], dict[str, Array]]) -> dict[str, Array]:
    """Measure times by subject anew in every pass; return the least of each."""
    passes = [measure() for _ in range(PASSES)]
    return {
        name: np.min([times[name] for times in passes], axis=0) for name in passes[0]
    }


def keep_ratio(name: str, ratio: float, unit: str = OF_PINOCCHIO) -> KeptNumber:
    """Return a ratio of time as a figure."""
    judged = {"best": 0.0, "tolerance": 0.0, "relative_tolerance": 0.15}
    return keep_number(f"time: {name}", ratio, unit, **judged)


def _time_estimators(run: Run) -> list[KeptNumber]:
    """Return observer, sensor and chains relative to their bare calls."""
    signals = JointSignals.of_run(run)
    # The withdrawal would take as long again, and has no layers to identify.
    end = int(np.searchsorted(signals.t_s, run.scenario.motion.withdrawal_start_s))
    bounds = (ticks.first_counted(run, signals), end)

    def subjects() -> dict[str, Update]:
        return {
            **ticks.make_estimators(run, signals),
            **ticks.make_chains(run, {"": signals}),
        }

    def chain() -> dict[str, Update]:
        return {ticks.CHAIN: ticks.make_chains(run, {"": signals})[ticks.CHAIN]}

    taken = take_fastest(lambda: ticks.time_side_by_side(subjects(), *bounds))
    chain_us = take_fastest(
        lambda: ticks.time_side_by_side(chain(), *bounds, thread_time_ns)
    )
    bare = ticks.BARE_SENSOR
    mean_ratio = float(np.mean(chain_us[ticks.CHAIN]) / np.mean(taken[bare]))
    medians = [
        keep_ratio(f"{name}, median", cost_ratio(taken[name], taken[of]))
        for name, of in (
            (ticks.OBSERVER, ticks.BARE_OBSERVER),
            (ticks.SENSOR, bare),
            (ticks.CHAIN, bare),
            (ticks.PUBLISHED_CHAIN, bare),
        )
    ]
    return [*medians, keep_ratio(f"{ticks.CHAIN}, mean", mean_ratio)]


def _time_control(progress: Progress) -> list[KeptNumber]:
    """Return ticks of control relative to Jacobian and placement."""
    recorded = control.record_both(progress)
    bounds = (control.WARM_TICKS, round(1e3 * control.SECONDS))
    taken = take_fastest(
        lambda: ticks.time_side_by_side(control.make_control(*recorded), *bounds)
    )
    return [
        keep_ratio(what, cost_ratio(taken[name], taken[control.BARE]))
        for name, what in (
            (control.CONTROL, "RCM tick"),
            (control.FOLLOWING, "following tick, no RCM"),
            (control.SATURATED, "RCM tick, limits bind"),
        )
    ]


def keep_lesser(
    first: Sequence[KeptNumber], second: Sequence[KeptNumber]
) -> list[KeptNumber]:
    """Return the lesser of each time that was measured twice.

    Other processes, and the processor's own clock, only add to a time. One that is no
    number, or was measured once, stays as it is.
    """
    again = {figure.name: figure for figure in second}
    kept: list[KeptNumber] = []
    for figure in first:
        other = again.get(figure.name, figure)
        value = figure.value
        is_less = value is not None and other.value is not None and other.value < value
        kept.append(other if is_less else figure)
    return kept


def compare_figures(
    old: Iterable[KeptNumber], new: Iterable[KeptNumber], absent: Collection[str] = ()
) -> list[Comparison]:
    """Compare what was measured with the file, by name, the file's figures first.

    A number that is not to be had is worse, whatever the file says.

    Args:
        old: Of the file, with the tolerances that count.
        new: As measured.
        absent: Units of figures that cannot be measured here; they are left out.
    """
    earlier = {figure.name: figure for figure in old if figure.unit not in absent}
    later = {figure.name: figure for figure in new if figure.unit not in absent}

    def value_in(figures: dict[str, KeptNumber], name: str) -> float | None:
        if name not in figures:
            return None
        value = figures[name].value
        return math.nan if value is None else value

    comparisons = []
    for name in dict.fromkeys((*earlier, *later)):
        kind = earlier.get(name) or later[name]
        values = (value_in(earlier, name), value_in(later, name))
        comparisons.append(compare_number(name, kind.unit, *values, kind))
    return comparisons


def headline_table(changes: Sequence[Comparison]) -> ResultTable:
    """Return all figures, before and now."""
    caption = (
        f"{', '.join(SCENARIOS)}, seed {SEED}; times: insertion of {ticks.SCENARIO}, "
        f"{ticks.PLANT}, the fastest of {PASSES} passes"
    )
    return comparison_table(changes, "Headline", caption)


def describe_code(figures: Iterable[KeptNumber]) -> HeadlineFile:
    """Return figures with the commit and the versions they were measured with."""
    return HeadlineFile(
        commit=find_commit() or "unknown",
        versions={name: version(name) for name in ("numpy", "pin", "numba")},
        figures=tuple(figures),
    )


def read_headline(path: Path) -> HeadlineFile:
    """Read a file of figures; raises `ResultsError` where it is none."""
    try:
        return msgspec.json.decode(path.read_bytes(), type=HeadlineFile)
    except OSError as error:
        raise ResultsError(
            f"cannot read {path}: {error.strerror}",
            "Write it anew: python -m benchmarks headline --write",
        ) from error
    except msgspec.DecodeError as error:
        raise ResultsError(
            f"{path} is not a file of figures: {error}",
            "Write it anew: python -m benchmarks headline --write",
        ) from error


def write_headline(path: Path, measured: HeadlineFile) -> None:
    """Write figures to a file, one a line, so that a change of one is seen."""
    head = {"commit": measured.commit, "versions": measured.versions}
    lines = b",\n  ".join(map(msgspec.json.encode, measured.figures))
    text = b'{"schema": 1, %b,\n "figures": [\n  %b\n]}\n' % (
        msgspec.json.encode(head)[1:-1],
        lines,
    )
    try:
        path.write_bytes(text)
    except OSError as error:
        raise ResultsError(f"cannot write {path}: {error.strerror}") from error
