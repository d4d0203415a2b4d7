"""The tables of online identification: every simulated insertion, and Table I."""

import math
import statistics
from collections.abc import Iterable, Sequence

from rich.console import Console
from rich.table import Table

from benchmarks.metric_catalogue import (
    BOUNDS,
    IDENTIFICATION,
    OFFLINE,
    REAL_TISSUE,
    TABLE_I,
    metric,
)
from benchmarks.rows import Row
from benchmarks.targets import (
    GELS,
    PUBLISHED_RMSE_N,
    TARGETS,
    Target,
    Verdict,
    judged_value,
    verdicts,
)

# Several runs in one cell of a table.


NOTHING = "–"
BAD = "[red]not finite[/red]"


def summary(values: Sequence[float], form: str, best: float = 0.0) -> str:
    """One value as it is; of more the median, and in brackets the one farthest from the best.

    Args:
        values: Of the runs.
        form: Format of a number, such as ``.3f``.
        best: The value wished for.
    """
    if not values:
        return NOTHING
    if not all(map(math.isfinite, values)):
        return BAD
    middle = format(statistics.median(values), form)
    if len(values) == 1:
        return middle
    worst = max(values, key=lambda value: abs(value - best))
    return f"{middle} ({worst:{form}})"


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


# Where tables go, and how they say that a target is met.


LEAST_WIDTH = 140
"""Of a table that goes into a file or a pipe."""


def new_console() -> Console:
    """A console as wide as the terminal, or wide enough for every table where there is none."""
    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = max(console.width, LEAST_WIDTH)
    return console


def met_mark(is_met: bool) -> str:
    """A target's last cell."""
    return "[green]met[/green]" if is_met else "[red]missed[/red]"


# The table of axial forces: F/T sensor, the paper's method, ours, and the published figure.


CAPTION = (
    "From first contact to the end of withdrawal; several seeds: median (worst). 'real arm': RMSE "
    "of the paper's method on its LWR 4+, Figure 5; scenario and tissue are alike, not the same."
)


def force_table(rows: Iterable[Row]) -> Table | None:
    """One line per scenario and plant; None when there is no axial force among the rows."""
    rows = [row for row in rows if row.metric.startswith("wrench_")]
    if not rows:
        return None
    table = Table(title="Axial force against the true one", caption=CAPTION)
    table.add_column("scenario", no_wrap=True)
    table.add_column("arm", no_wrap=True)
    for name in ("F/T", "published", "default"):
        table.add_column(f"{name}\nRMSE, N", justify="right")
    for name in ("default\n/ paper", "real arm\nN", "bias\nmN", "lag\nms", "within\n2 sigma"):
        table.add_column(name, justify="right")
    table.add_column("target", no_wrap=True)
    for scenario, plant in dict.fromkeys((row.scenario, row.plant) for row in rows):
        here = [row for row in rows if (row.scenario, row.plant) == (scenario, plant)]
        table.add_row(scenario, plant, *_cells(here), _mark(here))
    return table


def _cells(rows: Sequence[Row]) -> list[str]:
    def values(metric: str, source: str = "virtual", method: str = "default") -> list[float]:
        wanted = (metric, source, method)
        return [row.value for row in rows if (row.metric, row.source, row.method) == wanted]

    published = PUBLISHED_RMSE_N.get(rows[0].scenario)
    rmse = "wrench_rmse_N"
    return [
        summary(values(rmse, source="ft"), ".3f"),
        summary(values(rmse, method="published"), ".3f"),
        summary(values(rmse), ".3f"),
        summary(_ratios(rows), ".2f"),
        NOTHING if published is None else f"{published:g}",
        summary([1e3 * value for value in values("wrench_bias_N")], ".0f"),
        summary(values("wrench_lag_ms"), ".0f"),
        summary(values("wrench_coverage_2sigma"), ".2f", best=0.95),
    ]


def _ratios(rows: Sequence[Row]) -> list[float]:
    """Our RMSE in terms of the paper's method, run by run."""
    rmse = {
        (row.seed, row.method): row.value
        for row in rows
        if (row.metric, row.source) == ("wrench_rmse_N", "virtual")
    }
    pairs = [
        (rmse[seed, "default"], rmse.get((seed, "published")))
        for seed, m in rmse
        if m != "published"
    ]
    return [ours / theirs for ours, theirs in pairs if theirs]


def _mark(rows: Sequence[Row]) -> str:
    """Whether every run keeps the limits on its RMSE."""
    by_key = {row.key: row for row in rows}
    kept = [
        target.is_met_by(judged_value(target, row, by_key))
        for target in TARGETS
        for row in rows
        if target.metric == "wrench_rmse_N" and target.applies_to(row)
    ]
    return met_mark(all(kept)) if kept else NOTHING


# The table of bounds: what the noise of a force allows, beside what was reached with it.


CAPTION_bound_table = (
    "Several seeds: median (worst). Bounds know the law, where every rupture is and how large, and "
    "the noise of the run; see docs/limits.md."
)
COLUMNS = (
    ("friction_bound_white_pct", "default", "friction, %\nif white", ".2f"),
    ("friction_bound_pct", "default", "least\n(bound)", ".2f"),
    ("friction_error_mean_pct", "default", "ours", ".2f"),
    ("rupture_delay_bound_ms", "default", "delay, ms\nleast (bound)", ".1f"),
    ("rupture_delay_ms", "default", "ours", ".1f"),
    ("rupture_delay_ms", "published", "published", ".1f"),
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
    table = Table(title="Bounds of identification", caption=CAPTION_bound_table)
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


# The table of targets: met or missed.


def verdict_table(found: Sequence[Verdict]) -> Table | None:
    """One line per target that could be judged; None without any."""
    if not found:
        return None
    table = Table(title="Targets")
    table.add_column("what")
    table.add_column("limits", justify="right", no_wrap=True)
    table.add_column("reached", justify="right", no_wrap=True)
    table.add_column("runs", justify="right")
    table.add_column("", no_wrap=True)
    table.add_column("farthest out")
    for verdict in found:
        reached = f"{verdict.value:.4g}" if math.isfinite(verdict.value) else "not finite"
        table.add_row(
            verdict.target.what,
            limits_text(verdict.target),
            reached,
            str(verdict.runs),
            met_mark(verdict.is_met),
            f"{verdict.worst.scenario}, seed {verdict.worst.seed}",
        )
    return table


def limits_text(target: Target) -> str:
    """The limits of a target for people."""
    unit = "x paper" if target.of_published else metric(target.metric).unit
    unit = "" if unit == "1" else f" {unit}"
    statistic = "" if target.statistic == "worst" else f" ({target.statistic})"
    if not math.isfinite(target.at_least):
        return f"≤ {target.at_most:g}{unit}{statistic}"
    if not math.isfinite(target.at_most):
        return f"≥ {target.at_least:g}{unit}{statistic}"
    return f"{target.at_least:g} … {target.at_most:g}{unit}{statistic}"


# The table of numbers that are not axial forces: residuals, weights, scales.


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


# The table of offline reconstruction: the multi-layer model against Kelvin-Voigt.


CAPTION_offline_table = (
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
    table = Table(title="Offline reconstruction: RMSE, N", caption=CAPTION_offline_table)
    for name in ("scenario", "arm"):
        table.add_column(name, no_wrap=True)
    for head in ("multi-layer", "Kelvin-Voigt"):
        table.add_column(head, justify="right")
    for key, by_name in groups.items():
        table.add_row(*key, *(summary(by_name[name], ".3f") for name in names))
    return table


# The table of identification on recordings of real tissue.


METHODS = ("guess", "published", "default")


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


# All tables of a run, in order. A new kind of number gets its table here.


def run_tables(rows: Sequence[Row]) -> list[Table]:
    """The tables that these rows have something for."""
    tables = (
        force_table(rows),
        rupture_table(rows),
        friction_table(rows),
        bound_table(rows),
        table_one_table(rows),
        offline_table(rows),
        tissue_table(rows),
        number_table(rows),
        verdict_table(verdicts(rows)),
    )
    return [table for table in tables if table is not None]
