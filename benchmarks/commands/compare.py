"""``python -m benchmarks compare OLD NEW``."""

import argparse
import math
from collections import Counter
from collections.abc import Iterable

from rich.table import Table

from benchmarks.commands.arguments import FAILURE
from benchmarks.comparison import Change, Comparison, compare_rows
from benchmarks.errors import ResultsError
from benchmarks.rows import read_results
from benchmarks.tables import new_console


def execute(arguments: argparse.Namespace) -> int:
    """Print what has changed; fail if something has become worse.

    Raises:
        ResultsError: A file cannot be read, or there is nothing to compare.
    """
    found = compare_rows(read_results(arguments.old), read_results(arguments.new))
    if not found:
        raise ResultsError(f"{arguments.old} and {arguments.new} have no rows: nothing to compare")
    console = new_console()
    changed = [item for item in found if item.change is not Change.SAME]
    if changed:
        console.print(comparison_table(changed))
    counts = Counter(item.change for item in found)
    console.print(", ".join(f"{counts[change]} {change}" for change in Change if counts[change]))
    return FAILURE if any(item.is_failure for item in found) else 0


def comparison_table(found: Iterable[Comparison]) -> Table:
    """One line per row of the results."""
    table = Table(title="Changes")
    for name in ("scenario", "arm", "seed", "source", "method", "metric"):
        table.add_column(name)
    for name in ("old", "new"):
        table.add_column(name, justify="right")
    table.add_column("unit")
    table.add_column("", no_wrap=True)
    for item in found:
        color = "red" if item.is_failure else "green"
        values = ["–" if math.isnan(value) else f"{value:.4g}" for value in (item.old, item.new)]
        table.add_row(*map(str, item.key), *values, item.unit, f"[{color}]{item.change}[/{color}]")
    return table
