"""``python -m benchmarks run``."""

import argparse
from pathlib import Path

from rich.console import Console

from benchmarks.commands.arguments import FAILURE
from benchmarks.commands.progress_bar import progress_bar
from benchmarks.report import write_report
from benchmarks.rows import write_results
from benchmarks.runner import Plan, Request, make_plan, run_jobs
from benchmarks.tables import new_console, run_tables
from benchmarks.targets import verdicts
from needleforce.plots.page import folder_if_filled


def execute(arguments: argparse.Namespace) -> int:
    """Run what was asked for, print the tables, write the files.

    Raises:
        BenchmarkError: Nothing can be run, or a file cannot be written.
        figures.FiguresError: The report cannot be drawn or written.
    """
    # Before minutes of work, not after.
    with folder_if_filled(arguments.report) as folder:
        return _run(arguments, folder)


def _run(arguments: argparse.Namespace, folder: Path | None) -> int:
    """The work itself; charts and page go into the folder, if there is one."""
    plants = [name for names in arguments.plant or [] for name in names]
    request = Request(
        ids=arguments.ids,
        plants=plants,
        seeds=arguments.seeds,
        data=arguments.data,
        drawings=folder,
    )
    plan = make_plan(request)
    # The bar goes to stderr, so that stdout can be piped.
    with progress_bar(len(plan.jobs)) as tell:
        outcomes = run_jobs(plan.jobs, arguments.jobs, tell)
    rows = [row for outcome in outcomes for row in outcome.rows]
    console = new_console()
    for table in run_tables(rows):
        console.print(table)
    failures = [f"{item.job}: {item.failure}" for item in outcomes if item.failure is not None]
    _tell_gaps(console, plan, failures)
    if arguments.json is not None:
        write_results(arguments.json, rows)
    if folder is not None:
        drawn = [drawing for item in outcomes for drawing in item.drawings]
        index = write_report(folder, rows, drawn)
        console.print(f"Report: {index}")
    missed = arguments.strict and not all(verdict.is_met for verdict in verdicts(rows))
    return FAILURE if failures or missed else 0


def _tell_gaps(console: Console, plan: Plan, failures: list[str]) -> None:
    for failure in failures:
        console.print(f"failed: {failure}", style="red", markup=False)
    if plan.skipped:
        names = ", ".join(plan.skipped)
        console.print(
            f"Skipped for want of recordings (--data DIR or NEEDLEFORCE_DATA): {names}",
            style="yellow",
        )
