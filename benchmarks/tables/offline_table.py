"""The table of offline reconstruction: the multi-layer model against Kelvin-Voigt."""

from collections.abc import Iterable

from rich.table import Table

from benchmarks.metrics.identification_catalogue import OFFLINE
from benchmarks.row import Row
from benchmarks.tables.summary import summary

CAPTION = (
    "Equation (6) on the F/T reading, true layers and ruptures given; RMSE from first contact to "
    "the deepest point. Several seeds: median (worst)."
)


def offline_table(rows: Iterable[Row]) -> Table | None:
    """One line per scenario and plant, as in Figures 2 and 3; None without such rows."""
    names = [item.name for item in OFFLINE]
    groups: dict[tuple[str, str], dict[str, list[float]]] = {}
    for row in rows:
        if row.metric in names:
            by_name = groups.setdefault((row.scenario, row.plant), {name: [] for name in names})
            by_name[row.metric].append(row.value)
    if not groups:
        return None
    table = Table(title="Offline reconstruction: RMSE, N", caption=CAPTION)
    for name in ("scenario", "arm"):
        table.add_column(name, no_wrap=True)
    for head in ("multi-layer", "Kelvin-Voigt"):
        table.add_column(head, justify="right")
    for key, by_name in groups.items():
        table.add_row(*key, *(summary(by_name[name], ".3f") for name in names))
    return table
