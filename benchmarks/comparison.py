"""What has changed between two runs, row by row."""

import math
from collections.abc import Iterable
from enum import StrEnum
from typing import NamedTuple

from benchmarks.metric_catalogue import METRICS
from benchmarks.rows import Row, RowKey


class Change(StrEnum):
    """What became of one row."""

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
    """Compare two runs; rows are matched by all but value and unit.

    A row that is missing or not finite in the new run is a failure, whatever it was before. A
    metric that the catalogue does not list must not change at all.

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
    if new is None:
        return Change.MISSING
    if not math.isfinite(new.value):
        return Change.NOT_FINITE
    if old is None:
        return Change.NEW
    if not math.isfinite(old.value):
        return Change.BETTER
    if new.value == old.value:
        return Change.SAME
    kind = METRICS.get(metric)
    if kind is None or kind.is_regression(old.value, new.value):
        return Change.WORSE
    # The same tolerance both ways: what would not count as worse does not count as better.
    return Change.BETTER if kind.is_regression(new.value, old.value) else Change.SAME
