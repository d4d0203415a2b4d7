"""What is measured, how it is judged, and what has become worse.

All of it is data, in `judged.toml`.
"""

import math
import statistics
from collections.abc import Callable, Iterable, Mapping, Sequence
from enum import StrEnum
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, Literal, NamedTuple

import msgspec

from benchmarks import UnknownMetricError
from benchmarks.results import KEYS, Row, unit_of
from groundtruth import SCENARIOS
from groundtruth.scenarios import RANDOM_STACK

TISSUE = tuple(item.id for item in SCENARIOS.values() if item.layers)
GELS = tuple(name for name in TISSUE if name.startswith("gel-"))
"""Single gels, those of Table I."""
GROUPS: Mapping[str, tuple[str, ...]] = {
    "tissue": TISSUE,
    "gels": GELS,
    "stacks": tuple(name for name in TISSUE if name.startswith("stack-")),
    "random": (RANDOM_STACK,),
}
"""Scenarios that are judged together, by name."""


def expand_groups(names: Iterable[str]) -> tuple[str, ...]:
    """Return scenarios and patterns of scenarios, groups written out."""
    return tuple(item for name in names for item in GROUPS.get(name, (name,)))


class Metric(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One kind of number.

    Attributes:
        meaning: One line.
        name: As in the results; it ends with the unit.
        table: The table of `report/tables.toml` that shows it; ``none`` for none.
        best: The value wished for: 0 for an error, 1 for a recall, 0.95 for a coverage.
        tolerance: Absolute worsening that is not called a regression, in the metric's
            unit.
        relative_tolerance: The same as a fraction of the old distance from ``best``;
            the larger of the two counts. 1 marks a number shown for reference, by
            which nothing is judged.
    """

    meaning: str
    name: str = ""
    table: str = ""
    best: float = 0.0
    tolerance: float = 0.0
    relative_tolerance: float = 0.0

    @property
    def unit(self) -> str:
        """As in the results; ``1`` for none."""
        return unit_of(self.name)

    @property
    def may_be_undefined(self) -> bool:
        """Whether nan is a result: without an alarm there is no precision."""
        return self.name == "rupture_precision"


Statistic = Literal["worst", "mean", "median", "p90", "max", "sum", "deviation"]
"""What is said of all runs; ``p90`` is the worst of the best 90 %, ``deviation`` the
standard deviation."""


def sum_up(
    values: Sequence[float], statistic: Statistic, badness: Callable[[float], float]
) -> float:
    """Return a statistic of values; nan if one is not finite.

    Args:
        values: One per run.
        statistic: Which.
        badness: Is larger for a worse value.
    """
    if not all(map(math.isfinite, values)):
        return math.nan
    if statistic in ("worst", "p90"):
        ordered = sorted(values, key=badness)
        # Of ten runs the ninth: rounding must not make it the tenth.
        fraction = 0.9 if statistic == "p90" else 1.0
        return ordered[math.ceil(fraction * len(values) - 1e-9) - 1]
    if statistic == "deviation":
        return statistics.stdev(values) if len(values) > 1 else math.nan
    simple: Mapping[str, Callable[[Sequence[float]], float]] = {
        "mean": statistics.fmean,
        "median": statistics.median,
        "max": max,
        "sum": math.fsum,
    }
    return simple[statistic](values)


class Target(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Limits for one metric over the runs it applies to; all are for ours.

    Attributes:
        what: One line for people.
        metric: Its name.
        plant: The plant model it applies to.
        scenarios: Names, patterns of names or groups of scenarios; none for all.
        source: See `benchmarks.results.Source`; ``any`` for all.
        at_least: Lower limit, in the metric's unit.
        at_most: Upper limit.
        statistic: What of all runs must keep the limits.
        of_published: Whether the limits are for the ratio to ``published`` in the same
            run.
        where_reported: Whether runs in which ``published`` has no such number are left
            out.
    """

    what: str
    metric: str
    plant: str
    scenarios: tuple[str, ...] = ()
    source: str = "virtual"
    at_least: float = -math.inf
    at_most: float = math.inf
    statistic: Statistic = "worst"
    of_published: bool = False
    where_reported: bool = False

    def __post_init__(self) -> None:
        """Write the groups out."""
        msgspec.structs.force_setattr(self, "scenarios", expand_groups(self.scenarios))

    def applies_to(self, row: Row) -> bool:
        """Whether a row is one of those that it looks at."""
        return (
            (row.metric, row.plant, row.method) == (self.metric, self.plant, "ours")
            and self.source in (row.source, ANY)
            and (
                not self.scenarios
                or any(fnmatchcase(row.scenario, name) for name in self.scenarios)
            )
        )

    def is_met_by(self, value: float) -> bool:
        """Whether a value keeps the limits; one that is not finite does not."""
        return math.isfinite(value) and self.at_least <= value <= self.at_most

    def excess(self, value: float) -> float:
        """Return how far a value is beyond the nearer limit, negative inside."""
        if not math.isfinite(value):
            return math.inf
        return max(value - self.at_most, self.at_least - value)

    @property
    def limits(self) -> str:
        """The limits for people, with unit and statistic."""
        unit = "x published" if self.of_published else unit_of(self.metric)
        unit = "" if unit == "1" else f" {unit}"
        statistic = "" if self.statistic == "worst" else f" ({self.statistic})"
        if not math.isfinite(self.at_least):
            return f"≤ {self.at_most:g}{unit}{statistic}"
        if not math.isfinite(self.at_most):
            return f"≥ {self.at_least:g}{unit}{statistic}"
        return f"{self.at_least:g} … {self.at_most:g}{unit}{statistic}"


ANY = "any"
"""As the source of a target: every source."""


class KeptFigure(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A figure that `benchmarks.headline` keeps.

    Attributes:
        metric: Its name; the best value says which way is worse.
        sources: The forces it is measured on.
        statistic: What of the insertions makes one figure.
        what: For people.
        tolerance: What rounding and other versions of libraries may change on the same
            seeds, in the metric's unit.
        relative_tolerance: The same as a fraction of the distance from the best value.
    """

    metric: str
    sources: tuple[str, ...]
    statistic: Statistic
    what: str
    tolerance: float = 0.0
    relative_tolerance: float = 0.0


class _Judged(msgspec.Struct, forbid_unknown_fields=True):
    """What `judged.toml` holds."""

    headline: tuple[KeptFigure, ...]
    metrics: dict[str, dict[str, Metric]]
    targets: dict[str, list[Target]]


_JUDGED = msgspec.toml.decode(
    Path(__file__).with_name("judged.toml").read_bytes(), type=_Judged
)
METRICS: Mapping[str, Metric] = {
    name: msgspec.structs.replace(item, name=name, table=table)
    for table, items in _JUDGED.metrics.items()
    for name, item in items.items()
}
"""By name."""
TARGETS = tuple(target for family in _JUDGED.targets.values() for target in family)
KEPT_FIGURES = _JUDGED.headline


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


class Evaluation(NamedTuple):
    """How one target stands.

    Attributes:
        target: The target.
        value: What is judged: the worst, mean or median of the runs; nan if one is not
            finite.
        runs: How many.
        worst: The row that is farthest out.
    """

    target: Target
    value: float
    runs: int
    worst: Row

    @property
    def is_met(self) -> bool:
        """Whether the value keeps the target's limits."""
        return self.target.is_met_by(self.value)


def evaluate(
    rows: Iterable[Row], targets: Sequence[Target] | None = None
) -> list[Evaluation]:
    """Judge every target that any of the rows belongs to."""
    by_metric: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        by_metric.setdefault((row.metric, row.plant), []).append(row)
    evaluations = []
    for target in TARGETS if targets is None else targets:
        same = by_metric.get((target.metric, target.plant), [])
        judged = judged_values(target, same)
        if judged:
            values = [value for value, _ in judged]
            worst = max(judged, key=lambda pair: target.excess(pair[0]))[1]
            value = sum_up(values, target.statistic, target.excess)
            evaluations.append(Evaluation(target, value, len(judged), worst))
    return evaluations


def judged_values(target: Target, rows: Sequence[Row]) -> list[tuple[float, Row]]:
    """Return what a target looks at, with its row: values, or ratios to published ones.

    A value that is undefined by its metric's definition does not count unless all are.
    """
    mine = [row for row in rows if target.applies_to(row)]
    judged = [(row.value, row) for row in mine]
    if target.of_published:
        # All keys but the method and the metric, which are the same.
        published = {
            row.key[:4]: row.value
            for row in rows
            if row.method == "published-one-setting"
        }
        judged = []
        for row in mine:
            theirs = published.get(row.key[:4])
            if theirs is None and target.where_reported:
                continue
            judged.append((row.value / theirs if theirs else math.nan, row))
    defined = [pair for pair in judged if not math.isnan(pair[0])]
    return defined if metric(target.metric).may_be_undefined and defined else judged


class Change(StrEnum):
    """What became of a number from an earlier measurement to a later one."""

    SAME = "same"
    BETTER = "better"
    WORSE = "worse"
    MISSING = "missing"
    NOT_FINITE = "not finite"
    NEW = "new"


class Comparison(NamedTuple):
    """One number in two measurements.

    Attributes:
        name: Which number.
        unit: Of both values.
        old: Earlier value, nan where there was none.
        new: Later value, nan where there is none.
        allowed: By how much it may be worse.
        change: What became of it.
    """

    name: str
    unit: str
    old: float
    new: float
    allowed: float
    change: Change

    @property
    def is_failure(self) -> bool:
        """Whether it makes the comparison fail."""
        return self.change in (Change.WORSE, Change.MISSING, Change.NOT_FINITE)


def compare_number(
    name: str, unit: str, old: float | None, new: float | None, kind: Any
) -> Comparison:
    """Compare two measurements of a number; None where there is none.

    What is missing or not finite later is a failure, whatever it was before; only a
    value that its metric leaves undefined may stay so.

    Args:
        name: Which number.
        unit: Of both.
        old: Earlier value.
        new: Later value.
        kind: Has `best`, `tolerance`, `relative_tolerance` and perhaps
            `may_be_undefined`; None for what must not change at all.
    """
    before = math.nan if old is None else old
    after = math.nan if new is None else new
    allowed = 0.0
    if kind is not None:
        allowed = kind.tolerance
        if math.isfinite(before):
            allowed = max(allowed, kind.relative_tolerance * abs(before - kind.best))
    if new is None:
        change = Change.MISSING
    elif not math.isfinite(after):
        may_stay = math.isnan(before) and getattr(kind, "may_be_undefined", False)
        change = Change.NEW if old is None else Change.SAME
        change = change if may_stay and math.isnan(after) else Change.NOT_FINITE
    elif old is None:
        change = Change.NEW
    else:
        change = _judge_change(before, after, allowed, kind)
    return Comparison(name, unit, before, after, allowed, change)


def _judge_change(before: float, after: float, allowed: float, kind: Any) -> Change:
    """Return what became of a number that is finite now."""
    if not math.isfinite(before):
        return Change.BETTER
    if kind is None:
        return Change.SAME if before == after else Change.WORSE
    worsening = abs(after - kind.best) - abs(before - kind.best)
    # 0.95 - 0.90 is larger than 0.05 by a rounding.
    rounding = 1e-9 * (abs(before) + abs(after) + abs(kind.best))
    if abs(worsening) <= allowed + rounding:
        return Change.SAME
    return Change.WORSE if worsening > 0.0 else Change.BETTER


def compare_rows(old: Iterable[Row], new: Iterable[Row]) -> list[Comparison]:
    """Compare two runs; rows are matched by all but value and unit, the old ones first.

    A metric that `judged.toml` does not list must not change at all.
    """
    old_rows = {row.key: row for row in old}
    new_rows = {row.key: row for row in new}
    comparisons = []
    for key in dict.fromkeys((*old_rows, *new_rows)):
        earlier = old_rows.get(key)
        later = new_rows.get(key)
        row = later or old_rows[key]
        comparisons.append(
            compare_number(
                " ".join(str(getattr(row, name)) for name in KEYS),
                row.unit,
                None if earlier is None else earlier.value,
                None if later is None else later.value,
                METRICS.get(row.metric),
            )
        )
    return comparisons
