"""The gate: what a stranger sees of this toolkit, beside what it was.

Columns of `headline.csv`: `metric` is a name of `metrics.csv`, whose best value says
which way is worse; `sources` are the forces it is measured on; `statistic` of the
insertions makes one figure; the larger of `tolerance`, in the metric's unit, and
`relative_tolerance`, a fraction of the distance from the best value, is what rounding
and other versions of libraries may change on the same seeds.
"""

import math
import statistics
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from ctypes import CDLL
from importlib.metadata import version
from pathlib import Path
from typing import Literal, NamedTuple

import msgspec
import numpy as np

from benchmarks import ResultsError
from benchmarks.catalogue import Plan, Request, make_plan
from benchmarks.insertion.signals import JointSignals
from benchmarks.jobs import Progress, progress_part
from benchmarks.performance import control_speed, kdl_peer, speed
from benchmarks.performance.speed import Update, cost_ratio
from benchmarks.report.tables import ResultTable, show_value
from benchmarks.results import (
    SIGNIFICANT_DIGITS,
    Row,
    find_commit,
    metric,
    table_lines,
)
from benchmarks.targets import FAILURES, Change
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
LIBRARIES = ("numpy", "pin", "numba")
"""Whose versions change rounding or time."""
TIME_TOLERANCE = 0.15
PASSES = 3
"""Of the same updates, of which the fastest counts: other processes only add time."""
OF_PINOCCHIO = "x Pinocchio"
OF_KDL = "x KDL"
"""Units of a ratio of time."""


class HeadlineLine(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A line of `headline.csv`."""

    metric: str
    sources: str
    statistic: Literal["mean", "median", "max", "sum"]
    tolerance: float
    relative_tolerance: float
    what: str


STATISTICS: Mapping[str, Callable[[Sequence[float]], float]] = {
    "mean": statistics.fmean,
    "median": statistics.median,
    "max": max,
    "sum": math.fsum,
}
LINES = tuple(
    msgspec.convert(line, HeadlineLine, strict=False)
    for line in table_lines(Path(__file__).with_name("headline.csv"))
)


class Figure(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
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

    @property
    def allowed(self) -> float:
        """By how much another value may be worse, in the unit."""
        if self.value is None:
            return self.tolerance
        distance = abs(self.value - self.best)
        return max(self.tolerance, self.relative_tolerance * distance)


class HeadlineFile(msgspec.Struct, frozen=True, kw_only=True):
    """All figures of a commit.

    Attributes:
        commit: What was measured; it ends with ``-dirty`` where files had changes.
        versions: Of the `LIBRARIES`.
        figures: In the order of the table.
        schema: Of the file.
    """

    commit: str
    versions: dict[str, str]
    figures: tuple[Figure, ...]
    schema: Literal[1] = 1


def make_figure(
    name: str,
    value: float,
    unit: str,
    *,
    best: float,
    tolerance: float,
    relative_tolerance: float,
) -> Figure:
    """Return a figure as it stands in the file: rounded, and None for no number."""
    rounded = float(f"{value:.{SIGNIFICANT_DIGITS}g}")
    return Figure(
        name=name,
        value=rounded if math.isfinite(rounded) else None,
        unit=unit,
        best=best,
        tolerance=tolerance,
        relative_tolerance=relative_tolerance,
    )


def plan_insertions() -> Plan:
    """Return the insertions of the gate."""
    request = Request(ids=SCENARIOS, plants=PLANTS, seeds=1, first_seed=SEED)
    return make_plan(request)


def insertion_figures(rows: Iterable[Row]) -> list[Figure]:
    """Return the figures of `LINES` by plant and source.

    One that an insertion lacks, as the delay where no rupture was found, is no number.
    """
    values = {
        (row.plant, row.source, row.metric, row.scenario): row.value
        for row in rows
        if row.method == "ours" and row.seed == SEED
    }
    figures: list[Figure] = []
    for plant in PLANTS:
        for source in ("ft", "virtual"):
            for line in LINES:
                if source not in line.sources.split():
                    continue
                numbers = [
                    values.get((plant, source, line.metric, scenario), math.nan)
                    for scenario in SCENARIOS
                ]
                # The median of numbers with a nan among them is one of the others.
                is_known = all(map(math.isfinite, numbers))
                value = STATISTICS[line.statistic](numbers) if is_known else math.nan
                kind = metric(line.metric)
                figure = make_figure(
                    f"{plant}, {source}: {line.what}",
                    value,
                    kind.unit,
                    best=kind.best,
                    tolerance=line.tolerance,
                    relative_tolerance=line.relative_tolerance,
                )
                figures.append(figure)
    return figures


def measure_times(progress: Progress, kdl: CDLL | None) -> list[Figure]:
    """Time everything beside its yardstick, one after the other, in this process.

    Nothing else should run meanwhile. Without KDL there are no figures `OF_KDL`.
    """
    to_simulate = progress_part(progress, 0.0, 0.25)
    run = simulate(speed.SCENARIO, speed.PLANT, SEED, to_simulate)
    figures = _time_estimators(run)
    figures += _time_control(progress_part(progress, 0.6, 0.9))
    if kdl is not None:
        figures += _time_beside_kdl(run, kdl)
    progress(1.0)
    return figures


Times = dict[str, Array]
"""By subject [us]."""


def take_fastest(measure: Callable[[], Times]) -> Times:
    """Measure anew in every pass; return the least of each time."""
    passes = [measure() for _ in range(PASSES)]
    return {
        name: np.min([times[name] for times in passes], axis=0) for name in passes[0]
    }


def time_figure(name: str, ratio: float, unit: str) -> Figure:
    """Return a ratio of time as a figure."""
    return make_figure(
        f"time: {name}",
        ratio,
        unit,
        best=0.0,
        tolerance=0.0,
        relative_tolerance=TIME_TOLERANCE,
    )


def _time_estimators(run: Run) -> list[Figure]:
    """Return observer, sensor and chains relative to their bare calls."""
    signals = JointSignals.of_run(run)
    # The withdrawal would take as long again, and has no layers to identify.
    end = int(np.searchsorted(signals.t_s, run.scenario.motion.withdrawal_start_s))
    bounds = (speed.first_counted(run, signals), end)

    def subjects() -> dict[str, Update]:
        return {
            **speed.make_estimators(run, signals),
            **speed.make_chains(run, {"": signals}),
        }

    def chain() -> dict[str, Update]:
        return {speed.CHAIN: speed.make_chains(run, {"": signals})[speed.CHAIN]}

    ticks = take_fastest(lambda: speed.time_side_by_side(subjects(), *bounds))
    chain_us = take_fastest(lambda: speed.processor_times(chain(), *bounds))
    bare = speed.BARE_SENSOR
    mean_ratio = float(np.mean(chain_us[speed.CHAIN]) / np.mean(ticks[bare]))
    medians = [
        time_figure(f"{name}, median", cost_ratio(ticks[name], ticks[of]), OF_PINOCCHIO)
        for name, of in (
            (speed.OBSERVER, speed.BARE_OBSERVER),
            (speed.SENSOR, bare),
            (speed.CHAIN, bare),
            (speed.PUBLISHED_CHAIN, bare),
        )
    ]
    return [*medians, time_figure(f"{speed.CHAIN}, mean", mean_ratio, OF_PINOCCHIO)]


def _time_control(progress: Progress) -> list[Figure]:
    """Return ticks of control relative to Jacobian and placement."""
    recorded = control_speed.record_both(progress)
    bounds = (control_speed.WARM_TICKS, round(1e3 * control_speed.SECONDS))
    ticks = take_fastest(
        lambda: speed.time_side_by_side(control_speed.make_control(*recorded), *bounds)
    )
    return [
        time_figure(
            what, cost_ratio(ticks[name], ticks[control_speed.BARE]), OF_PINOCCHIO
        )
        for name, what in (
            (control_speed.CONTROL, "RCM tick"),
            (control_speed.FOLLOWING, "following tick, no RCM"),
            (control_speed.SATURATED, "RCM tick, limits bind"),
        )
    ]


def _time_beside_kdl(run: Run, kdl: CDLL) -> list[Figure]:
    """Return our estimators relative to KDL's."""
    ticks = kdl_peer.peer_times(run, kdl)
    return [
        time_figure(what, cost_ratio(ticks[name], ticks[kdl_peer.KDL]), OF_KDL)
        for name, what in (
            (kdl_peer.OURS, "observer and wrench"),
            (kdl_peer.SENSOR, "sensor"),
        )
    ]


def keep_lesser(first: Sequence[Figure], second: Sequence[Figure]) -> list[Figure]:
    """Return the lesser of each time that was measured twice.

    Other processes, and the processor's own clock, only add to a time. One that is no
    number, or was measured once, stays as it is.
    """
    again = {figure.name: figure for figure in second}
    kept: list[Figure] = []
    for figure in first:
        other = again.get(figure.name, figure)
        is_less = (
            figure.value is not None
            and other.value is not None
            and other.value < figure.value
        )
        kept.append(other if is_less else figure)
    return kept


class FigureChange(NamedTuple):
    """A figure in the file and as measured.

    Attributes:
        figure: With its tolerance: that of the file, if it has the figure.
        old: In the file; None for no number.
        new: Measured; None for no number.
        change: What became of it.
    """

    figure: Figure
    old: float | None
    new: float | None
    change: Change

    @property
    def is_failure(self) -> bool:
        """Whether it makes the gate fail."""
        return self.change in FAILURES

    def __str__(self) -> str:
        """One line for people."""
        old, new = map(_show, (self.old, self.new))
        return f"{self.change}: {self.figure.name}: {old} -> {new} {self.figure.unit}"


def compare_figures(
    old: Iterable[Figure], new: Iterable[Figure], absent: Collection[str] = ()
) -> list[FigureChange]:
    """Compare what was measured with the file, by name, the file's figures first.

    A number that is not to be had is worse, whatever the file says.

    Args:
        old: Of the file, with the tolerances that count.
        new: As measured.
        absent: Units of figures that cannot be measured here; they are left out.
    """
    earlier = {figure.name: figure for figure in old if figure.unit not in absent}
    later = {figure.name: figure for figure in new if figure.unit not in absent}
    return [
        FigureChange(
            earlier.get(name) or later[name],
            earlier[name].value if name in earlier else None,
            later[name].value if name in later else None,
            _change(earlier.get(name), later.get(name)),
        )
        for name in dict.fromkeys((*earlier, *later))
    ]


def _change(old: Figure | None, new: Figure | None) -> Change:
    """Return what became of one figure."""
    if new is None:
        return Change.MISSING
    if new.value is None:
        return Change.NOT_FINITE
    if old is None:
        return Change.NEW
    if old.value is None:
        return Change.BETTER
    worsening = abs(new.value - old.best) - abs(old.value - old.best)
    # 0.95 - 0.90 is larger than 0.05 by a rounding.
    excess = round(abs(worsening) - old.allowed, ROUNDING_DIGITS)
    if excess <= 0.0:
        return Change.SAME
    return Change.WORSE if worsening > 0.0 else Change.BETTER


ROUNDING_DIGITS = 9


def headline_table(changes: Sequence[FigureChange]) -> ResultTable:
    """Return all figures, before and now."""
    return ResultTable(
        title="Headline",
        heads=("figure", "in the file", "now", "unit", "may be worse by", ""),
        align="LrrLrL",
        lines=tuple(
            (
                item.figure.name,
                _show(item.old),
                _show(item.new),
                item.figure.unit,
                f"{item.figure.allowed:.2g}",
                str(item.change),
            )
            for item in changes
        ),
        caption=f"{', '.join(SCENARIOS)}, seed {SEED}; times: insertion of "
        f"{speed.SCENARIO}, {speed.PLANT}, the fastest of {PASSES} passes",
    )


def _show(value: float | None) -> str:
    return show_value(math.nan if value is None else value)


def describe_code(figures: Iterable[Figure]) -> HeadlineFile:
    """Return figures with the commit and the versions they were measured with."""
    return HeadlineFile(
        commit=find_commit() or "unknown",
        versions={name: version(name) for name in LIBRARIES},
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
