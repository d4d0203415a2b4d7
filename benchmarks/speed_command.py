"""``python -m benchmarks speed``."""

import argparse
from collections.abc import Mapping

from rich.table import Table

from benchmarks.progress_bar import progress_bar
from benchmarks.screen import new_console
from benchmarks.speed import (
    BARE_OBSERVER,
    BARE_SENSOR,
    OBSERVER,
    SENSOR,
    UNEVEN_OBSERVER,
    UNEVEN_SENSOR,
    measure_speed,
)
from benchmarks.targets import OBSERVER_COST_RATIO, SENSOR_COST_RATIO
from benchmarks.timing import Timing

FAILURE = 1
PERCENTILES = {"median": 50.0, "99 %": 99.0, "99.9 %": 99.9}
BARE = {
    OBSERVER: BARE_OBSERVER,
    UNEVEN_OBSERVER: BARE_OBSERVER,
    SENSOR: BARE_SENSOR,
    UNEVEN_SENSOR: BARE_SENSOR,
}
"""What a subject's cost is a multiple of."""
LIMITS = {OBSERVER: OBSERVER_COST_RATIO, SENSOR: SENSOR_COST_RATIO}


def execute(arguments: argparse.Namespace) -> int:
    """Measure, print, and with --strict hold to the targets."""
    with progress_bar(1) as tell:
        timings = measure_speed(lambda share: tell(0, share))
    console = new_console()
    console.print(speed_table(timings))
    missed = any(ratio_of(timings, name) > most for name, most in LIMITS.items())
    return FAILURE if arguments.strict and missed else 0


def speed_table(timings: Mapping[str, Timing]) -> Table:
    """Microseconds per tick, and the ratio to the bare dynamics with its target."""
    ticks = next(iter(timings.values())).tick_us.size
    table = Table(
        title="Cost of a tick",
        caption=f"{ticks} ticks each of a simulated insertion, taking turns; ratios of medians",
    )
    table.add_column("what", no_wrap=True)
    for name in PERCENTILES:
        table.add_column(f"{name}\nus", justify="right")
    for name in ("ratio", "target", ""):
        table.add_column(name, justify="right", no_wrap=True)
    for name, timing in timings.items():
        times = [f"{timing.percentile_us(percent):.1f}" for percent in PERCENTILES.values()]
        table.add_row(name, *times, *_ratio_cells(timings, name))
    return table


def ratio_of(timings: Mapping[str, Timing], name: str) -> float:
    """Cost of a subject in times of its bare dynamics."""
    return timings[name].ratio_to(timings[BARE[name]])


def _ratio_cells(timings: Mapping[str, Timing], name: str) -> tuple[str, str, str]:
    if name not in BARE:
        return "", "", ""
    ratio = ratio_of(timings, name)
    if name not in LIMITS:
        return f"{ratio:.2f}", "", ""
    mark = "[green]met[/green]" if ratio <= LIMITS[name] else "[red]missed[/red]"
    return f"{ratio:.2f}", f"≤ {LIMITS[name]:g}", mark
