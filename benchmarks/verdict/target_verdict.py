"""Whether targets are met."""

import math
import statistics
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from benchmarks.row import Row, RowKey
from benchmarks.verdict.identification_targets import IDENTIFICATION_TARGETS
from benchmarks.verdict.targets import TARGETS, Target

ALL_TARGETS = (*TARGETS, *IDENTIFICATION_TARGETS)


class Verdict(NamedTuple):
    """How one target stands.

    Attributes:
        target: The target.
        value: What is judged: the worst, mean or median of the runs; nan if one of them is not
            finite.
        runs: Number of runs.
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


def verdicts(rows: Iterable[Row], targets: Sequence[Target] = ALL_TARGETS) -> list[Verdict]:
    """Judge every target that any of the rows belongs to."""
    by_key = {row.key: row for row in rows}
    found = []
    for target in targets:
        judged = [row for row in by_key.values() if _is_judged(target, row, by_key)]
        if judged:
            found.append(_judge(target, judged, by_key))
    return found


def judged_value(target: Target, row: Row, by_key: Mapping[RowKey, Row]) -> float:
    """What a target looks at in one row: its value, or its ratio to the paper's."""
    if not target.of_paper:
        return row.value
    paper = by_key.get(row.key._replace(method="paper"))
    return row.value / paper.value if paper is not None and paper.value != 0.0 else math.nan


def _is_judged(target: Target, row: Row, by_key: Mapping[RowKey, Row]) -> bool:
    """Whether a target looks at a row."""
    if not target.applies_to(row):
        return False
    return not target.where_paper_tells or row.key._replace(method="paper") in by_key


def _judge(target: Target, rows: Sequence[Row], by_key: Mapping[RowKey, Row]) -> Verdict:
    values = [judged_value(target, row, by_key) for row in rows]
    excess = [_excess(target, value) for value in values]
    worst = max(range(len(rows)), key=excess.__getitem__)
    if not all(map(math.isfinite, values)):
        value = math.nan
    elif target.statistic == "worst":
        value = values[worst]
    else:
        value = {"mean": statistics.fmean, "median": statistics.median}[target.statistic](values)
    return Verdict(target, value, len(rows), rows[worst].key)


def _excess(target: Target, value: float) -> float:
    """How far a value is beyond the nearer limit, negative inside."""
    if not math.isfinite(value):
        return math.inf
    return max(value - target.at_most, target.at_least - value)
