"""The table of faults: for the terminal, and for docs/loop.md."""

import math
from collections.abc import Iterable

from rich.table import Table

from benchmarks.faults.fault import FaultResult

COLUMNS = ("fault", "worst error, N", "in σ", "recovered after", "what the caller is told", "")


def cells(result: FaultResult) -> tuple[str, ...]:
    """One row, in the order of `COLUMNS`."""
    told = ", ".join(result.told) or "–"
    note = result.note if result.is_finite else f"not finite; {result.note}"
    return (
        result.name,
        f"{result.worst_N:.2f}",
        f"{result.worst_sigma:.0f}",
        recovery(result.recovery_s),
        told,
        note,
    )


def recovery(seconds: float) -> str:
    """A time of recovery as it is printed."""
    if math.isinf(seconds):
        return "never"
    return "at once" if seconds == 0.0 else f"{1e3 * seconds:.0f} ms"


def fault_table(results: Iterable[FaultResult]) -> Table:
    """For the terminal."""
    table = Table(title="Faults in a running insertion")
    for name in COLUMNS:
        table.add_column(name, justify="right" if name in COLUMNS[1:4] else "left")
    for result in results:
        table.add_row(*cells(result))
    return table


def fault_lines(results: Iterable[FaultResult]) -> list[str]:
    """Lines of the same table in Markdown."""
    rule = "| --- | ---: | ---: | ---: | --- | --- |"
    rows = ["| " + " | ".join(cells(result)) + " |" for result in results]
    return ["| " + " | ".join(COLUMNS) + " |", rule, *rows]
