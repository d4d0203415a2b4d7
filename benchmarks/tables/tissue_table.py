"""The table of identification on recordings of real tissue."""

from collections.abc import Iterable

from rich.table import Table

from benchmarks.metrics.identification_catalogue import REAL_TISSUE
from benchmarks.row import Row
from benchmarks.tables.summary import summary

METHODS = ("guess", "paper", "default")


def tissue_table(rows: Iterable[Row]) -> Table | None:
    """One line per recording, force and metric, one column per method; None without such rows."""
    kinds = {item.name: item for item in REAL_TISSUE}
    values: dict[tuple[str, str, str], dict[str, list[float]]] = {}
    for row in rows:
        if row.metric in kinds:
            by_method = values.setdefault((row.scenario, row.source, row.metric), {})
            by_method.setdefault(row.method, []).append(row.value)
    if not values:
        return None
    table = Table(title="Real tissue", caption="Several insertions: median (worst).")
    for name in ("recording", "force", "what"):
        table.add_column(name)
    for method in METHODS:
        table.add_column(method, justify="right", no_wrap=True)
    table.add_column("unit")
    for (scenario, source, name), by_method in values.items():
        kind = kinds[name]
        cells = [summary(by_method.get(method, ()), ".3g", kind.best) for method in METHODS]
        table.add_row(scenario, source, kind.meaning, *cells, kind.unit)
    return table
