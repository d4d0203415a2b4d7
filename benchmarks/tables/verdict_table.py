"""The table of targets: met or missed."""

import math
from collections.abc import Sequence

from rich.table import Table

from benchmarks.metrics.metric_catalogue import metric
from benchmarks.tables.screen import met_mark
from benchmarks.verdict.target_verdict import Verdict
from benchmarks.verdict.targets import Target


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
    unit = "x paper" if target.of_paper else metric(target.metric).unit
    unit = "" if unit == "1" else f" {unit}"
    statistic = "" if target.statistic == "worst" else f" ({target.statistic})"
    if not math.isfinite(target.at_least):
        return f"≤ {target.at_most:g}{unit}{statistic}"
    if not math.isfinite(target.at_most):
        return f"≥ {target.at_least:g}{unit}{statistic}"
    return f"{target.at_least:g} … {target.at_most:g}{unit}{statistic}"
