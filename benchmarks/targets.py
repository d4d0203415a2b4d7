"""Every limit this toolkit has set itself, and how runs are judged by them.

And the published numbers. Columns of `targets.csv`: `metric`, `plant` and `source` as
in the results, where the source ``any`` stands for all; `scenarios` are names, patterns
of names or groups (`GROUPS`), none for all; `at_least` and `at_most` are limits in the
metric's unit; `statistic` of all runs must keep them; `relative_to` says that they hold
for the ratio to the published method in the same run (``published where reported``: a
run in which that method has no such number is left out); `what` is one line for people.
All targets are for the method ``ours``.
"""

import math
import statistics
from collections.abc import Iterable, Mapping, Sequence
from enum import StrEnum
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Literal, NamedTuple

import msgspec

from benchmarks.results import METRICS, Row, RowKey, metric, table_lines
from groundtruth import SCENARIOS
from groundtruth.scenarios import RANDOM_STACK

TISSUE = tuple(item.id for item in SCENARIOS.values() if item.layers)
GELS = tuple(name for name in TISSUE if name.startswith("gel-"))
"""Single gels, those of Table I."""
STACKS = tuple(name for name in TISSUE if name.startswith("stack-"))
GROUPS: Mapping[str, tuple[str, ...]] = {
    "tissue": TISSUE,
    "gels": GELS,
    "stacks": STACKS,
    "random": (RANDOM_STACK,),
}
"""Scenarios that are judged together, by name."""

Statistic = Literal["worst", "mean", "median", "p90"]
"""What of all runs must keep the limits; ``p90`` is the worst of the best 90 %."""
ANY = "any"
"""As the source of a target: every source."""
BEST_FRACTION = 0.9
"""Of the runs that ``p90`` judges."""


class Target(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Limits for one metric over the runs it applies to.

    Attributes:
        what: One line for people.
        metric: A name of `metrics.csv`.
        plant: The plant model it applies to.
        scenarios: Names or patterns of the scenarios it applies to; none for all.
        source: See `Source`; ``any`` for all.
        method: See `Method`.
        at_least: Lower limit, in the metric's unit.
        at_most: Upper limit.
        statistic: See `Statistic`.
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
    method: str = "ours"
    at_least: float = -math.inf
    at_most: float = math.inf
    statistic: Statistic = "worst"
    of_published: bool = False
    where_reported: bool = False

    def applies_to(self, scenario: str) -> bool:
        """Whether a scenario is among those it is for."""
        patterns = self.scenarios
        return not patterns or any(
            fnmatchcase(scenario, pattern) for pattern in patterns
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
        unit = "x published" if self.of_published else metric(self.metric).unit
        unit = "" if unit == "1" else f" {unit}"
        statistic = "" if self.statistic == "worst" else f" ({self.statistic})"
        if not math.isfinite(self.at_least):
            return f"≤ {self.at_most:g}{unit}{statistic}"
        if not math.isfinite(self.at_most):
            return f"≥ {self.at_least:g}{unit}{statistic}"
        return f"{self.at_least:g} … {self.at_most:g}{unit}{statistic}"


def _target(line: dict[str, str]) -> Target:
    """Return the target of a line; what is empty there has its default."""
    filled = {name: text for name, text in line.items() if text}
    names = filled.pop("scenarios", "").split()
    relative_to = filled.pop("relative_to", "")
    scenarios = [scenario for name in names for scenario in GROUPS.get(name, (name,))]
    relative = {
        "of_published": bool(relative_to),
        "where_reported": relative_to == "published where reported",
    }
    return msgspec.convert(
        filled | relative | {"scenarios": scenarios}, Target, strict=False
    )


TARGETS = tuple(map(_target, table_lines(Path(__file__).with_name("targets.csv"))))

OBSERVER_COST_RATIOS = (2.0, 2.3)
SENSOR_COST_RATIOS = (2.5, 4.6)
CHAIN_COST_RATIOS = (4.3, 8.0)
PUBLISHED_CHAIN_COST_RATIOS = (3.7, 8.0)
"""Most that an update may cost, relative to the bare Pinocchio calls it needs: where
the arithmetic is compiled, and in plain Python."""
ESTIMATED_VELOCITY_COST_RATIO = 5.0
"""The same of a chain that must estimate the velocities, compiled."""
MEAN_TICK_RATIO = 2.0
"""Most that the mean update may cost, relative to the median: work is spread over
updates."""
MAX_TARE_TICK_MS = 0.5
"""Most by which the longest update may be longer while a tare is fitted beside it."""
SOAK_COST_RATIO = 1.1
"""Most an update may cost after a million, relative to one at the start."""
SOAK_GROWTH_KB = 100.0
"""Most that Python may hold more after a million updates: a tenth of a byte each. What
layers found meanwhile and caches that fill late need is below it."""

PUBLISHED_RMSE_N: Mapping[str, float] = {
    "gel-70-constant": 0.2444,
    "stack-glove-constant": 0.285,
}
"""Ferro et al., Figure 5: virtual against real F/T sensor on a real LWR 4+, by
scenario [N]."""


class PublishedFriction(NamedTuple):
    """A line of Table I: mean and spread over both speeds [Ns/m].

    Attributes:
        offline: Mean of what was identified offline.
        offline_spread: Its spread.
        online: Mean of what was identified online.
        online_spread: Its spread.
    """

    offline: int
    offline_spread: int
    online: int
    online_spread: int


TABLE_ONE_Ns_per_m: Mapping[int, PublishedFriction] = {
    25: PublishedFriction(113, 14, 84, 10),
    50: PublishedFriction(283, 21, 232, 16),
    70: PublishedFriction(534, 56, 481, 37),
}
"""Cumulative friction of single gels, by per cent of isinglass."""


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
    worst: RowKey

    @property
    def is_met(self) -> bool:
        """Whether the value keeps the target's limits."""
        return self.target.is_met_by(self.value)


RowsByKind = Mapping[tuple[str, ...], Mapping[RowKey, Row]]
"""Rows by metric, plant, source and method, and then by key."""


def group_by_kind(rows: Iterable[Row]) -> RowsByKind:
    """Return rows by what a target names: metric, plant, source (or any), method."""
    by_kind: dict[tuple[str, ...], dict[RowKey, Row]] = {}
    for row in rows:
        for source in (row.source, ANY):
            kind = (row.metric, row.plant, source, row.method)
            by_kind.setdefault(kind, {})[row.key] = row
    return by_kind


def evaluate(
    rows: Iterable[Row], targets: Sequence[Target] = TARGETS
) -> list[Evaluation]:
    """Judge every target that any of the rows belongs to."""
    by_kind = group_by_kind(rows)
    judged = ((target, judged_values(target, by_kind)) for target in targets)
    return [evaluate_target(target, values) for target, values in judged if values]


def judged_values(target: Target, by_kind: RowsByKind) -> dict[RowKey, float]:
    """Return what a target looks at, by row: values, or ratios to the published ones.

    A value that is undefined by its metric's definition does not count unless all are.
    """
    values: dict[RowKey, float] = {}
    kind = (target.metric, target.plant, target.source)
    published_rows = by_kind.get((*kind, "published-one-setting"), {})
    for key, row in by_kind.get((*kind, target.method), {}).items():
        if not target.applies_to(row.scenario):
            continue
        if not target.of_published:
            values[key] = row.value
            continue
        published = published_rows.get(key._replace(method="published-one-setting"))
        if published is not None and published.value != 0.0:
            values[key] = row.value / published.value
        elif published is not None or not target.where_reported:
            values[key] = math.nan
    defined = {key: value for key, value in values.items() if not math.isnan(value)}
    return defined if METRICS[target.metric].may_be_undefined and defined else values


def evaluate_target(target: Target, values: Mapping[RowKey, float]) -> Evaluation:
    """Judge one target by the values it looks at."""
    ordered = sorted(values, key=lambda key: target.excess(values[key]))
    return Evaluation(
        target=target,
        value=summarize(target, [values[key] for key in ordered]),
        runs=len(values),
        worst=max(values, key=lambda key: target.excess(values[key])),
    )


def summarize(target: Target, values: Sequence[float]) -> float:
    """Return the statistic of values, the best first; nan if one is not finite."""
    if not all(map(math.isfinite, values)):
        return math.nan
    if target.statistic == "mean":
        return statistics.fmean(values)
    if target.statistic == "median":
        return statistics.median(values)
    if target.statistic == "p90":
        # Of ten runs the ninth: rounding must not make it the tenth.
        return values[math.ceil(BEST_FRACTION * len(values) - 1e-9) - 1]
    return values[-1]


class Change(StrEnum):
    """What became of one row from an earlier run to a later one."""

    SAME = "same"
    BETTER = "better"
    WORSE = "worse"
    MISSING = "missing"
    NOT_FINITE = "not finite"
    NEW = "new"


FAILURES = frozenset({Change.WORSE, Change.MISSING, Change.NOT_FINITE})
"""What makes a comparison fail."""


class Comparison(NamedTuple):
    """One row of two runs.

    Attributes:
        key: Which row.
        unit: Of both values.
        old: Earlier value, nan where there was none.
        new: Later value, nan where there is none.
        change: What became of it.
    """

    key: RowKey
    unit: str
    old: float
    new: float
    change: Change

    @property
    def is_failure(self) -> bool:
        """Whether it makes the comparison fail."""
        return self.change in FAILURES


def compare_rows(old: Iterable[Row], new: Iterable[Row]) -> list[Comparison]:
    """Compare two runs; rows are matched by all but value and unit, the old ones first.

    A row that is missing or not finite in the new run is a failure, whatever it was
    before; only a value that its metric leaves undefined may stay so. A metric that
    `metrics.csv` does not list must not change at all.
    """
    old_rows = {row.key: row for row in old}
    new_rows = {row.key: row for row in new}
    comparisons = []
    for key in dict.fromkeys((*old_rows, *new_rows)):
        earlier = old_rows.get(key)
        later = new_rows.get(key)
        comparisons.append(
            Comparison(
                key=key,
                unit=(later or old_rows[key]).unit,
                old=math.nan if earlier is None else earlier.value,
                new=math.nan if later is None else later.value,
                change=_change(key.metric, earlier, later),
            )
        )
    return comparisons


def _change(metric: str, old: Row | None, new: Row | None) -> Change:
    """Return what became of one row."""
    kind = METRICS.get(metric)
    if new is None:
        return Change.MISSING
    if not math.isfinite(new.value):
        was_undefined = old is None or math.isnan(old.value)
        may_stay = kind is not None and kind.may_be_undefined and math.isnan(new.value)
        if not (may_stay and was_undefined):
            return Change.NOT_FINITE
        return Change.NEW if old is None else Change.SAME
    if old is None:
        return Change.NEW
    if not math.isfinite(old.value):
        return Change.BETTER
    if new.value == old.value:
        return Change.SAME
    if kind is None or kind.is_regression(old.value, new.value):
        return Change.WORSE
    # The same tolerance both ways: what would not count as worse does not count as
    # better.
    return Change.BETTER if kind.is_regression(new.value, old.value) else Change.SAME


class Headline(NamedTuple):
    """A line of the summary: one metric over a group of runs.

    Attributes:
        metric: A name of `metrics.csv`.
        form: Format of a number.
        what: For people, with the unit.
        source: See `Source`.
        plant: Plant model.
        scenarios: One of `GROUPS`, or a scenario.
    """

    metric: str
    form: str
    what: str
    source: str = "virtual"
    plant: str = "clean"
    scenarios: str = "tissue"


_FORCE = Headline("wrench_rmse_N", ".3f", "axial force, rms error, N")
_RECALL = Headline("rupture_recall", ".2f", "ruptures found, fraction")
_PULL_OUT = "pull-out force within 2 sigma, 78 mm, fraction"
HEADLINES = (
    _FORCE,
    _FORCE._replace(plant="fri"),
    _FORCE._replace(plant="degraded"),
    _RECALL._replace(plant="fri"),
    _RECALL._replace(plant="degraded"),
    Headline(
        "rupture_precision", ".2f", "alarms that are right, fraction", plant="fri"
    ),
    Headline(
        "friction_error_mean_pct",
        ".1f",
        "friction of a layer, mean error, %",
        plant="fri",
    ),
    Headline(
        "pullout_coverage_78mm", ".2f", _PULL_OUT, "ft", "recording", "liver-real"
    ),
)
"""At most eight: they fit on a screen."""
