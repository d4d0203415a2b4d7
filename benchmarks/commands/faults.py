"""``python -m benchmarks faults``."""

import argparse
import math

from benchmarks.commands.arguments import FAILURE
from benchmarks.commands.progress_bar import progress_bar
from benchmarks.faults import FaultStudy, fault_lines, fault_table
from benchmarks.tables import new_console


def execute(arguments: argparse.Namespace) -> int:
    """Inject, print, and with --strict hold to recovery and finite numbers."""
    with progress_bar(1) as tell:
        study = FaultStudy(lambda share: tell(0, 0.2 * share), with_velocity=not arguments.blind)
        results = []
        for result in study.results():
            results.append(result)
            tell(0, min(0.2 + 0.03 * len(results), 1.0))
    console = new_console()
    if arguments.markdown:
        console.print("\n".join(fault_lines(results)), soft_wrap=True, markup=False)
    else:
        console.print(fault_table(results))
    bad = any(not r.is_finite or math.isinf(r.recovery_s) for r in results)
    return FAILURE if arguments.strict and bad else 0
