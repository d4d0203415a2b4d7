"""The table of axial forces: F/T sensor, the paper's method, ours, and the published figure."""

from collections.abc import Iterable, Sequence

from rich.table import Table

from benchmarks.row import Row
from benchmarks.tables.screen import met_mark
from benchmarks.tables.summary import NOTHING, summary
from benchmarks.verdict.published import PUBLISHED_RMSE_N
from benchmarks.verdict.target_verdict import judged_value
from benchmarks.verdict.targets import TARGETS

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
    for name in ("F/T", "paper", "default"):
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
        summary(values(rmse, method="paper"), ".3f"),
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
    pairs = [(rmse[seed, "default"], rmse.get((seed, "paper"))) for seed, m in rmse if m != "paper"]
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
