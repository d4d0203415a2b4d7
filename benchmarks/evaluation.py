"""Judging numbers: against targets, and against those of an earlier run."""

import math
import statistics
from collections.abc import Iterable, Mapping, Sequence
from enum import StrEnum
from typing import NamedTuple

from benchmarks.metrics import METRICS
from benchmarks.rows import Row, RowKey
from benchmarks.targets import TARGETS, Target


class Evaluation(NamedTuple):
    """How one target stands."""

    target: Target  # the target
    value: float  # what is judged: the worst, mean or median of the runs; nan if one is not finite
    runs: int  # number of runs
    worst: RowKey  # the row that is farthest out

    @property
    def is_met(self) -> bool:
        """Whether the value keeps the target's limits."""
        return self.target.is_met_by(self.value)


def evaluate(rows: Iterable[Row], targets: Sequence[Target] = TARGETS) -> list[Evaluation]:
    """Judge every target that any of the rows belongs to."""
    by_key = {row.key: row for row in rows}
    found = (_evaluation(target, by_key) for target in targets)
    return [item for item in found if item is not None]


def judged_values(target: Target, by_key: Mapping[RowKey, Row]) -> dict[RowKey, float]:
    """What a target looks at, by row: values, or their ratios to the published method's.

    A value that is undefined by its metric's definition does not count unless all are.
    """
    values: dict[RowKey, float] = {}
    for key, row in by_key.items():
        if not target.applies_to(row):
            continue
        if not target.of_published:
            values[key] = row.value
            continue
        published = by_key.get(key._replace(method="published"))
        if published is not None and published.value != 0.0:
            values[key] = row.value / published.value
        elif published is not None or not target.where_reported:
            values[key] = math.nan
    defined = {key: value for key, value in values.items() if not math.isnan(value)}
    return defined if METRICS[target.metric].may_be_undefined and defined else values


def _evaluation(target: Target, by_key: Mapping[RowKey, Row]) -> Evaluation | None:
    values = judged_values(target, by_key)
    if not values:
        return None
    worst = max(values, key=lambda key: target.excess(values[key]))
    if not all(map(math.isfinite, values.values())):
        value = math.nan
    elif target.statistic == "worst":
        value = values[worst]
    else:
        middle = {"mean": statistics.fmean, "median": statistics.median}[target.statistic]
        value = middle(values.values())
    return Evaluation(target, value, len(values), worst)


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
    """One row of two runs."""

    key: RowKey  # which row
    unit: str  # of both values
    old: float  # earlier value, nan where there was none
    new: float  # later value, nan where there is none
    change: Change  # what became of it

    @property
    def is_failure(self) -> bool:
        """Whether it makes the comparison fail."""
        return self.change in FAILURES


def compare_rows(old: Iterable[Row], new: Iterable[Row]) -> list[Comparison]:
    """Compare two runs; rows are matched by all but value and unit.

    A row that is missing or not finite in the new run is a failure, whatever it was before; only
    a value that its metric leaves undefined may stay so. A metric that `metrics.csv` does not list
    must not change at all.

    Returns:
        One comparison per row of either run, in the order of the old, then the new ones.
    """
    before = {row.key: row for row in old}
    after = {row.key: row for row in new}
    found = []
    for key in dict.fromkeys((*before, *after)):
        earlier, later = before.get(key), after.get(key)
        found.append(
            Comparison(
                key=key,
                unit=(later or before[key]).unit,
                old=math.nan if earlier is None else earlier.value,
                new=math.nan if later is None else later.value,
                change=_change(key.metric, earlier, later),
            )
        )
    return found


def _change(metric: str, old: Row | None, new: Row | None) -> Change:
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
    # The same tolerance both ways: what would not count as worse does not count as better.
    return Change.BETTER if kind.is_regression(new.value, old.value) else Change.SAME
