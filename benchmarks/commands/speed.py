"""``python -m benchmarks speed``."""

import argparse

from rich.table import Table

from benchmarks.commands.arguments import FAILURE
from benchmarks.commands.progress_bar import progress_bar
from benchmarks.methods import IDENTIFIERS
from benchmarks.soak import soak
from benchmarks.speed import (
    LIMITS,
    LONG_S,
    SHORT_S,
    event_table,
    measure_speed,
    pause_line,
    ratio_of,
    rerun_ratio,
    rerun_table,
    rerun_us,
    speed_table,
)
from benchmarks.tables import met_mark, new_console
from benchmarks.targets import RERUN_COST_RATIO, SOAK_COST_SHARE, SOAK_GROWTH_KB


def execute(arguments: argparse.Namespace) -> int:
    """Measure, print, and with --strict hold to the targets."""
    missed = _soak(arguments.soak) if arguments.soak else _speed()
    return FAILURE if arguments.strict and missed else 0


def _speed() -> bool:
    """Print what ticks cost; whether a target was missed."""
    with progress_bar(1) as tell:
        report = measure_speed(lambda share: tell(0, share))
    reruns = {
        (name, seconds): rerun_us(seconds, config)
        for name, config in IDENTIFIERS.items()
        for seconds in (SHORT_S, LONG_S)
    }
    console = new_console()
    console.print(speed_table(report.timings))
    console.print(event_table(report))
    console.print(rerun_table(report, reruns))
    console.print(pause_line(report.pauses))
    too_dear = any(ratio_of(report.timings, name) > most for name, most in LIMITS.items())
    return too_dear or any(rerun_ratio(report, us) > RERUN_COST_RATIO for us in reruns.values())


def _soak(ticks: int) -> bool:
    """Print what many ticks do to memory and to their own cost; whether a target was missed."""
    with progress_bar(1) as tell:
        found = soak(ticks, lambda share: tell(0, share))
    table = Table(title=f"{ticks} ticks of the chain: insertions, rests and cycles on one tare")
    for name in ("what", "start", "end", "target", ""):
        table.add_column(name, justify="left" if name == "what" else "right")
    cheap, lean = found.cost_share <= SOAK_COST_SHARE, found.growth_kB <= SOAK_GROWTH_KB
    for name, pair, target, met in (
        (
            "median tick, us",
            (f"{found.first_us:.1f}", f"{found.last_us:.1f}"),
            f"≤ {SOAK_COST_SHARE:g} x start",
            met_mark(cheap),
        ),
        (
            "Python's memory, kB",
            (f"{found.first_kB:.0f}", f"{found.last_kB:.0f}"),
            f"+ {SOAK_GROWTH_KB:g} at most",
            met_mark(lean),
        ),
        (
            "memory of the process, MB",
            (f"{found.first_rss_MB:.1f}", f"{found.last_rss_MB:.1f}"),
            "",
            "",
        ),
        (
            "ruptures an insertion",
            (f"{found.ruptures[0]}", f"{found.ruptures[-1]}"),
            "≥ 1 in all, none skipped",
            met_mark(found.is_busy),
        ),
    ):
        table.add_row(name, *pair, target, met)
    new_console().print(table)
    return not (cheap and lean and found.is_busy)
