"""``python -m benchmarks stream``."""

import argparse
from collections.abc import Sequence
from functools import partial

from rich.table import Table

from benchmarks.commands.arguments import FAILURE
from benchmarks.commands.progress_bar import progress_bar
from benchmarks.errors import BenchmarkError
from benchmarks.soak import (
    COMMANDS,
    LEAST_SECONDS,
    LEAST_TIMES_REAL,
    MOST_GROWTH_MB,
    StreamCase,
    StreamSpeed,
    measure_stream,
)
from benchmarks.tables import new_console


def execute(arguments: argparse.Namespace) -> int:
    """Measure, print, and with --strict hold to the targets.

    Raises:
        BenchmarkError: The recording is too short, or a command failed.
    """
    if arguments.seconds < LEAST_SECONDS:
        raise BenchmarkError(f"--seconds must be at least {LEAST_SECONDS:g}: the tare takes half")
    cases = [
        StreamCase(command=command, suffix=suffix)
        for suffix in arguments.format or [".csv"]
        for command in COMMANDS
    ]
    speeds: list[StreamSpeed] = []
    with progress_bar(len(cases)) as tell:
        for case in cases:
            told = partial(tell, len(speeds))
            speeds.append(measure_stream(case, arguments.seconds, arguments.folder, told))
    new_console().print(stream_table(speeds))
    return FAILURE if arguments.strict and not all(speed.is_met for speed in speeds) else 0


def stream_table(speeds: Sequence[StreamSpeed]) -> Table:
    """Time and memory of every case, with the targets."""
    table = Table(
        title=f"A recording of {speeds[0].seconds:g} s at 1 kHz through the commands, CSV out "
        f"(targets: {LEAST_TIMES_REAL:g} times real time on one core, "
        f"memory grows by {MOST_GROWTH_MB:g} MB at most)"
    )
    for heading in ("command", "log"):
        table.add_column(heading, no_wrap=True)
    for heading in (
        *("rows", "us per row", "x real time", "x real time (clock on the wall)"),
        *("MB at 10 %", "MB at the end", "MB at most", "late ruptures", "late skipped", "met"),
    ):
        table.add_column(heading, justify="right")
    for speed in speeds:
        watched = speed.watched
        table.add_row(
            speed.case.command,
            speed.case.suffix,
            str(speed.rows),
            f"{1e6 * watched.cpu_s / speed.rows:.1f}",
            f"{speed.times_real:.1f}",
            f"{speed.seconds / watched.wall_s:.1f}",
            f"{watched.memory_at(0.1):.0f}",
            f"{watched.memory_at(1.0):.0f}",
            f"{watched.peak_MB:.0f}",
            "" if speed.late.ruptures is None else str(speed.late.ruptures),
            str(speed.late.skipped),
            "yes" if speed.is_met else "no",
        )
    return table
