"""``python -m benchmarks list``."""

import argparse

from rich.table import Table

from benchmarks.catalogue import BENCHMARKS
from benchmarks.runner import PLANTS
from benchmarks.tables import new_console


def execute(arguments: argparse.Namespace) -> int:
    """Print every benchmark and plant."""
    table = Table(
        caption="* runs when nothing is named; 'tissue' names the scenarios with tissue, 'all' all"
    )
    for name in ("ID", "", "what", "needs"):
        table.add_column(name)
    for item in BENCHMARKS.values():
        needs = "recordings" if item.is_recorded else "simulation"
        table.add_row(item.id, "*" if item.is_default else "", item.title, needs)
    console = new_console()
    console.print(table)
    console.print(f"Plants of a simulation: {', '.join(PLANTS)}")
    return 0
