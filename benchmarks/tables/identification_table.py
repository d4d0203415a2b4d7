"""The tables of online identification: every simulated insertion, and Table I."""

import math
import statistics
from collections.abc import Iterable, Sequence

from rich.table import Table

from benchmarks.metrics.identification_catalogue import IDENTIFICATION, TABLE_I
from benchmarks.row import Row
from benchmarks.tables.summary import NOTHING, summary
from benchmarks.verdict.scenario_groups import GELS

FORCE_CAPTION = (
    "Several seeds: median (worst), of shares mean (least). Residue: |enhanced force| beyond the "
    "last layer over the force there. RMSE: from the first compensation to the deepest point."
)
RUPTURE_CAPTION = (
    "Several seeds: median (worst), of shares mean (least). Ruptures drop the force by more than "
    "five times the source's noise in free air; an alarm belongs to one within 0.2 s before to "
    "1.5 s after its onset; precision is 1 without an alarm."
)
Key = tuple[str, str, str, str]
"""Scenario, plant, source, method."""
Columns = tuple[tuple[str, str, str], ...]
FORCES: Columns = (
    ("friction_error_online_worst_pct", "friction, %\nworst layer", ".1f"),
    ("friction_coverage_online_2sigma", "within\n2 sigma", ".2f"),
    ("friction_error_worst_pct", "at the end\n%", ".1f"),
    ("exit_residue_pct", "residue\n%", ".1f"),
    ("enhanced_rmse_N", "enhanced\nRMSE, N", ".3f"),
    ("tip_rmse_N", "tip\nRMSE, N", ".3f"),
)
"""Metric, head, format."""
RUPTURES: Columns = (
    ("rupture_recall", "recall", ".2f"),
    ("rupture_precision", "precision", ".2f"),
    ("soft_transition_recall", "recall,\nsoft ones", ".2f"),
    ("rupture_delay_ms", "delay\nms", ".0f"),
    ("rupture_dating_error_ms", "dating\nms", ".0f"),
    ("rupture_overshoot_mm", "overshoot\nmm", ".2f"),
)
PUBLISHED_PCT = {"25": -26, "50": -18, "70": -10}
"""Error of the paper's online identification against its offline one, Table I."""


def friction_table(rows: Iterable[Row]) -> Table | None:
    """Friction and forces, one line per scenario, plant, source and method; None without."""
    return _table("Online identification: friction and forces", FORCE_CAPTION, FORCES, rows)


def rupture_table(rows: Iterable[Row]) -> Table | None:
    """Ruptures, one line per scenario, plant, source and method; None without."""
    return _table("Online identification: ruptures", RUPTURE_CAPTION, RUPTURES, rows)


def _table(title: str, caption: str, columns: Columns, rows: Iterable[Row]) -> Table | None:
    best = {item.name: item.best for item in IDENTIFICATION}
    groups = _groups(row for row in rows if row.metric in {name for name, _, _ in columns})
    if not groups:
        return None
    table = Table(title=title, caption=caption)
    for name in ("scenario", "arm", "force, method"):
        table.add_column(name, no_wrap=True)
    for _, head, _ in columns:
        table.add_column(head, justify="right", no_wrap=True)
    for key, found in groups.items():
        cells = [_cell(_values(found, name), form, best[name]) for name, _, form in columns]
        table.add_row(*_head(key), *cells)
    return table


def table_one_table(rows: Iterable[Row]) -> Table | None:
    """Table I side by side; None without single gels."""
    names = {item.name for item in TABLE_I}
    groups = _groups(row for row in rows if row.metric in names and row.scenario in GELS)
    if not groups:
        return None
    caption = "Of several seeds the median and, in brackets, the largest."
    table = Table(title="Table I: cumulative friction of single gels, Ns/m", caption=caption)
    for name in ("scenario", "arm", "force, method"):
        table.add_column(name, no_wrap=True)
    for head in ("true", "offline", "online", "online to\noffline, %", "published\n%"):
        table.add_column(head, justify="right")
    for key, found in groups.items():
        columns = [_values(found, item.name) for item in TABLE_I]
        errors = _online_errors_pct(found)
        published = PUBLISHED_PCT.get(key[0].split("-")[1], NOTHING)
        cells = [summary(values, ".0f") for values in columns]
        table.add_row(*_head(key), *cells, summary(errors, "+.0f"), str(published))
    return table


def _online_errors_pct(rows: Sequence[Row]) -> list[float]:
    """Online against offline, seed by seed."""
    _, offline, online = ({r.seed: r.value for r in rows if r.metric == t.name} for t in TABLE_I)
    both = [(online[seed], offline[seed]) for seed in online if offline.get(seed)]
    return [100.0 * (told / known - 1.0) for told, known in both]


def _head(key: Key) -> tuple[str, str, str]:
    scenario, plant, source, method = key
    return scenario, plant, f"{source} {method}"


def _cell(values: Sequence[float], form: str, best: float) -> str:
    """Errors as in every table; of shares, which are wished to be large, the mean and the least."""
    if best == 0.0 or len(values) < 2 or not all(map(math.isfinite, values)):
        return summary(values, form, best)
    return f"{statistics.fmean(values):{form}} ({min(values):{form}})"


def _groups(rows: Iterable[Row]) -> dict[Key, list[Row]]:
    found: dict[Key, list[Row]] = {}
    for row in rows:
        found.setdefault((row.scenario, row.plant, row.source, row.method), []).append(row)
    return found


def _values(rows: Sequence[Row], name: str) -> list[float]:
    return [row.value for row in rows if row.metric == name]
