"""Every metric a row may carry, from `metrics.csv`, and a measured number.

Columns of the file: `name` ends with the unit, see `UNITS`; `table` is the table of
`benchmarks.tables` that shows the metric (``none``: it stands in the results only); `best`,
`tolerance` and `relative_tolerance` say which change is one for the worse; `meaning` is one line.
A relative tolerance of 1 marks a number shown for reference, by which nothing is judged.
"""

import csv
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

from benchmarks import UnknownMetricError
from benchmarks.rows import Method, Row, Source

UNITS = {"_Ns_per_m": "Ns/m", "_Nm": "Nm", "_N": "N", "_mm": "mm", "_ms": "ms", "_pct": "%"}
"""By the end of a metric's name; a name that ends otherwise is that of a fraction or a count."""
UNDEFINED = frozenset({"rupture_precision"})
"""Metrics that may be nan by definition: without an alarm there is no precision."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Metric:
    """One kind of number."""

    name: str  # as in the results
    table: str  # the table that shows it
    meaning: str  # one line
    best: float  # the value wished for: 0 for an error, 1 for a recall, 0.95 for a coverage
    tolerance: float  # absolute worsening that is not called a regression, in the metric's unit
    # the same as a fraction of the old distance from ``best``; the larger of the two counts
    relative_tolerance: float

    @property
    def unit(self) -> str:
        """As in the results; ``1`` for none."""
        return next((unit for end, unit in UNITS.items() if self.name.endswith(end)), "1")

    @property
    def may_be_undefined(self) -> bool:
        """Whether nan is a result of it rather than a failure."""
        return self.name in UNDEFINED

    def is_regression(self, old: float, new: float) -> bool:
        """Whether the new value is worse beyond tolerance; a number that is not finite always."""
        if not (math.isfinite(old) and math.isfinite(new)):
            return not math.isfinite(new)
        allowed = max(self.tolerance, self.relative_tolerance * abs(old - self.best))
        return abs(new - self.best) - abs(old - self.best) > allowed


def table_lines(path: Path) -> Iterator[dict[str, str]]:
    """Lines of one of this package's data tables by column; ``#`` begins a comment line."""
    with path.open(encoding="utf-8", newline="") as lines:
        yield from csv.DictReader(line for line in lines if not line.startswith("#"))


METRICS: Mapping[str, Metric] = MappingProxyType(
    {
        line["name"]: Metric(
            name=line["name"],
            table=line["table"],
            meaning=line["meaning"],
            best=float(line["best"]),
            tolerance=float(line["tolerance"]),
            relative_tolerance=float(line["relative_tolerance"]),
        )
        for line in table_lines(Path(__file__).with_name("metrics.csv"))
    }
)
"""By name."""


def metric(name: str) -> Metric:
    """The metric of that name.

    Raises:
        UnknownMetricError: There is none.
    """
    try:
        return METRICS[name]
    except KeyError:
        raise UnknownMetricError(f"no metric {name!r}; known: {', '.join(METRICS)}") from None


class Measurement(NamedTuple):
    """One measured number, before it is known which job it belongs to; fields as in `Row`."""

    source: Source
    method: Method
    metric: str
    value: float

    def row(self, scenario: str, plant: str, seed: int) -> Row:
        """The row of a job's results.

        Raises:
            UnknownMetricError: `metrics.csv` does not list the metric.
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
