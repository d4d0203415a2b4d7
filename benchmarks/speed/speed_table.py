"""The tables of ``python -m benchmarks speed``."""

from collections.abc import Mapping

import numpy as np
from rich.table import Table

from benchmarks.speed.gc_pauses import GcPauses
from benchmarks.speed.tick_speed import (
    BARE_OBSERVER,
    BARE_SENSOR,
    CHAIN,
    CHAIN_WITHOUT_VELOCITY,
    OBSERVER,
    PAPER_CHAIN,
    PAPER_CHAIN_WITHOUT_VELOCITY,
    SENSOR,
    UNEVEN_OBSERVER,
    UNEVEN_SENSOR,
    SpeedReport,
)
from benchmarks.speed.timing import Timing
from benchmarks.tables.screen import met_mark
from benchmarks.verdict.targets import (
    CHAIN_COST_RATIO,
    OBSERVER_COST_RATIO,
    RERUN_COST_RATIO,
    SENSOR_COST_RATIO,
)
from speedup import COMPILER

PERCENTILES = {"median": 50.0, "99 %": 99.0, "99.9 %": 99.9}
BARE = {
    OBSERVER: BARE_OBSERVER,
    UNEVEN_OBSERVER: BARE_OBSERVER,
    SENSOR: BARE_SENSOR,
    UNEVEN_SENSOR: BARE_SENSOR,
    CHAIN: BARE_SENSOR,
    CHAIN_WITHOUT_VELOCITY: BARE_SENSOR,
    PAPER_CHAIN: BARE_SENSOR,
    PAPER_CHAIN_WITHOUT_VELOCITY: BARE_SENSOR,
}
"""What a subject's cost is a multiple of."""
LIMITS = {
    OBSERVER: OBSERVER_COST_RATIO,
    SENSOR: SENSOR_COST_RATIO,
    CHAIN: CHAIN_COST_RATIO,
    CHAIN_WITHOUT_VELOCITY: CHAIN_COST_RATIO,
    PAPER_CHAIN: CHAIN_COST_RATIO,
    PAPER_CHAIN_WITHOUT_VELOCITY: CHAIN_COST_RATIO,
}


def speed_table(timings: Mapping[str, Timing]) -> Table:
    """Microseconds per tick, and the ratio to the bare dynamics with its target."""
    ticks = next(iter(timings.values())).tick_us.size
    table = Table(
        title="Cost of a tick",
        caption=f"{ticks} ticks each of a simulated insertion, taking turns; ratios of medians; "
        + (f"compiled by {COMPILER}" if COMPILER else "plain Python: no numba, the extra `fast`"),
    )
    table.add_column("what", no_wrap=True)
    for name in (*PERCENTILES, "worst"):
        table.add_column(f"{name}\nus", justify="right")
    for name in ("ratio", "target", ""):
        table.add_column(name, justify="right", no_wrap=True)
    for name, timing in timings.items():
        times = [f"{timing.percentile_us(percent):.1f}" for percent in PERCENTILES.values()]
        ratio = ratio_of(timings, name) if name in BARE else None
        cells = _ratio_cells(ratio, LIMITS.get(name))
        table.add_row(name, *times, f"{timing.worst_us:.0f}", *cells)
    return table


def event_table(report: SpeedReport) -> Table:
    """Ticks that raise a rupture and ticks that identify a layer anew, in the same insertion."""
    table = Table(title="Ticks in which something happens")
    for name in ("what", "in"):
        table.add_column(name, no_wrap=True)
    for name in ("ticks", "median\nus", "worst\nus", "worst as\na ratio"):
        table.add_column(name, justify="right")
    bare = report.timings[BARE_SENSOR].percentile_us(50.0)
    for what, events in (("rupture raised", report.alarms), ("layer identified", report.reruns)):
        for name, indices in events.items():
            times = report.timings[name].ticks_us(indices)
            if len(times):
                worst = float(times.max())
                cells = (f"{np.median(times):.0f}", f"{worst:.0f}", f"{worst / bare:.0f}")
                table.add_row(what, name, str(len(times)), *cells)
    return table


def rerun_table(report: SpeedReport, rerun_us: Mapping[tuple[str, float], float]) -> Table:
    """The tick that identifies a layer anew, after short and long layers, with its target.

    Args:
        report: Gives the sensor's share of such a tick, and the bare dynamics.
        rerun_us: Of the identifier alone, by its name and the seconds in the layer.
    """
    table = Table(
        title="The tick that identifies a layer anew, with the sensor's median tick",
        caption="median of insertions into one gel of the needle alone, at 1 kHz",
    )
    for name in ("identifier", "layer", "us", "ratio", "target", ""):
        table.add_column(name, justify="right" if name != "identifier" else "left", no_wrap=True)
    sensor = report.timings[SENSOR].percentile_us(50.0)
    for (name, seconds), taken in rerun_us.items():
        ratio = rerun_ratio(report, taken)
        cells = _ratio_cells(ratio, RERUN_COST_RATIO)
        table.add_row(name, f"{seconds:g} s", f"{sensor + taken:.0f}", *cells)
    return table


def pause_line(pauses: GcPauses) -> str:
    """What the garbage collector took of all these ticks."""
    if not pauses.pauses_us:
        return "No garbage collection happened meanwhile."
    return (
        f"{len(pauses.pauses_us)} garbage collections happened meanwhile, in whatever tick was "
        f"next; the longest took {max(pauses.pauses_us):.0f} us. gc.freeze() after the tare "
        "spares a controller most of it (docs/loop.md)."
    )


def ratio_of(timings: Mapping[str, Timing], name: str) -> float:
    """Cost of a subject in times of its bare dynamics."""
    return timings[name].ratio_to(timings[BARE[name]])


def rerun_ratio(report: SpeedReport, identifier_us: float) -> float:
    """A sensor's median tick and an identifier's tick in times of the bare dynamics."""
    bare = report.timings[BARE_SENSOR].percentile_us(50.0)
    return (report.timings[SENSOR].percentile_us(50.0) + identifier_us) / bare


def _ratio_cells(ratio: float | None, limit: float | None) -> tuple[str, str, str]:
    if ratio is None:
        return "", "", ""
    if limit is None:
        return f"{ratio:.2f}", "", ""
    return f"{ratio:.2f}", f"≤ {limit:g}", met_mark(ratio <= limit)
