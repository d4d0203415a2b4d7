"""The table of bounds: what the noise of a force allows, beside what was reached with it."""

from collections.abc import Iterable

from rich.table import Table

from benchmarks.metrics.identification_catalogue import BOUNDS
from benchmarks.row import Row
from benchmarks.tables.summary import summary

CAPTION = (
    "Several seeds: median (worst). Bounds know the law, where every rupture is and how large, and "
    "the noise of the run; see docs/limits.md."
)
COLUMNS = (
    ("friction_bound_white_pct", "default", "friction, %\nif white", ".2f"),
    ("friction_bound_pct", "default", "least\n(bound)", ".2f"),
    ("friction_error_mean_pct", "default", "ours", ".2f"),
    ("rupture_delay_bound_ms", "default", "delay, ms\nleast (bound)", ".1f"),
    ("rupture_delay_ms", "default", "ours", ".1f"),
    ("rupture_delay_ms", "paper", "paper", ".1f"),
)
"""Metric, method, head, format."""


def bound_table(rows: Iterable[Row]) -> Table | None:
    """One line per scenario, plant and source; None without bounds."""
    rows = list(rows)
    names = {item.name for item in BOUNDS}
    keys = dict.fromkeys(
        (row.scenario, row.plant, row.source) for row in rows if row.metric in names
    )
    if not keys:
        return None
    table = Table(title="Bounds of identification", caption=CAPTION)
    for name in ("scenario", "arm", "force"):
        table.add_column(name, no_wrap=True)
    for _, _, head, _ in COLUMNS:
        table.add_column(head, justify="right", no_wrap=True)
    for key in keys:
        mine = [row for row in rows if (row.scenario, row.plant, row.source) == key]
        cells = [
            summary([r.value for r in mine if (r.metric, r.method) == (metric, method)], form)
            for metric, method, _, form in COLUMNS
        ]
        table.add_row(*key, *cells)
    return table
