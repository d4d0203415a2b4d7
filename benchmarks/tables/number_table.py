"""The table of numbers that are not axial forces: residuals, weights, scales."""

from collections.abc import Iterable

from rich.table import Table

from benchmarks.metrics.identification_catalogue import (
    BOUNDS,
    IDENTIFICATION,
    OFFLINE,
    REAL_TISSUE,
    TABLE_I,
)
from benchmarks.metrics.metric_catalogue import metric
from benchmarks.row import Row
from benchmarks.tables.summary import summary

ELSEWHERE = frozenset(
    item.name for item in (*IDENTIFICATION, *BOUNDS, *TABLE_I, *OFFLINE, *REAL_TISSUE)
)
"""Metrics with tables of their own."""


def number_table(rows: Iterable[Row]) -> Table | None:
    """One line per scenario, plant, method and metric; None when there are no such rows."""
    groups: dict[tuple[str, str, str, str], list[float]] = {}
    for row in rows:
        if row.metric not in ELSEWHERE and not row.metric.startswith("wrench_"):
            key = (row.scenario, row.plant, row.method, row.metric)
            groups.setdefault(key, []).append(row.value)
    if not groups:
        return None
    table = Table(title="Other numbers")
    for name in ("scenario", "arm", "method", "what"):
        table.add_column(name)
    table.add_column("value", justify="right")
    table.add_column("unit")
    for (scenario, plant, method, name), values in groups.items():
        kind = metric(name)
        text = summary(values, ".3g", kind.best)
        table.add_row(scenario, plant, method, kind.meaning, text, kind.unit)
    return table
