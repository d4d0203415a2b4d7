"""A number before it is known which job it belongs to."""

from typing import NamedTuple

from benchmarks.metrics.metric_catalogue import metric
from benchmarks.row import Method, Row, Source


class Measurement(NamedTuple):
    """One measured number.

    Attributes:
        source: See `Source`.
        method: See `Method`.
        metric: A name of `benchmarks.metrics.metric_catalogue`.
        value: The number.
    """

    source: Source
    method: Method
    metric: str
    value: float

    def row(self, scenario: str, plant: str, seed: int) -> Row:
        """The row of a job's results.

        Raises:
            UnknownMetricError: The catalogue does not list the metric.
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
