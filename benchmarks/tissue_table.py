"""The table of identification on recordings of real tissue."""

from collections.abc import Iterable

from rich.table import Table

from benchmarks.identification_catalogue import REAL_TISSUE
from benchmarks.row import Row
from benchmarks.summary import BAD, NOTHING

METHODS = ("guess", "paper", "default")


def tissue_table(rows: Iterable[Row]) -> Table | None:
    """One line per recording and metric, one column per method; None without such rows."""
    kinds = {item.name: item for item in REAL_TISSUE}
    values: dict[tuple[str, str], dict[str, float]] = {}
    for row in rows:
        if row.metric in kinds:
            values.setdefault((row.scenario, row.metric), {})[row.method] = row.value
    if not values:
        return None
    table = Table(title="Real tissue")
    for name in ("recording", "what"):
        table.add_column(name)
    for method in METHODS:
        table.add_column(method, justify="right", no_wrap=True)
    table.add_column("unit")
    for (scenario, name), by_method in values.items():
        cells = [_cell(by_method.get(method)) for method in METHODS]
        table.add_row(scenario, kinds[name].meaning, *cells, kinds[name].unit)
    return table


def _cell(value: float | None) -> str:
    if value is None:
        return NOTHING
    return BAD if value != value else f"{value:.3g}"
