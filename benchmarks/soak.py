"""A million updates: does the chain grow, does it slow down?"""

import tracemalloc
from collections.abc import Iterator
from dataclasses import dataclass
from time import perf_counter_ns

import numpy as np
import psutil
from numpy.typing import NDArray

from benchmarks.benchmark import Progress, progress_part
from benchmarks.methods import on_lwr
from benchmarks.signals import JointSignals
from benchmarks.tables import ResultTable, met_mark
from benchmarks.targets import SOAK_COST_RATIO, SOAK_GROWTH_KB
from groundtruth import simulate
from needleforce import InsertionSession
from residual import DEFAULT

SCENARIO, PLANT = "gel-25-constant", "clean"
WINDOW = 20_000
"""Updates of the first and of the last median: more than one cycle's worth of either."""
SETTLED_S, STILL = 0.5, 1000
"""The needle is at rest so long after its insertion, for so many samples at least."""
NS_PER_US, BYTES_PER_KB, BYTES_PER_MB = 1e3, 1024.0, 1024.0**2


@dataclass(frozen=True, slots=True, kw_only=True)
class Soak:
    """What many updates did."""

    # median update at the start, after the tare and one cycle, and at the end, over the same part
    # of a cycle [us]
    tick_us: tuple[float, float]
    # memory that Python held for the chain after that cycle and after the last whole one: in the
    # tissue a layer's data add to it [kB]
    python_kB: tuple[float, float]
    process_MB: tuple[float, float]  # resident memory of the process at the same times [MB]
    ruptures: tuple[int, ...]  # found in each whole insertion
    skipped: int  # samples that the session rejected

    @property
    def marks(self) -> tuple[bool, bool, bool]:
        """Whether it stayed as quick, held no more, and was busy: idling is cheap."""
        return (
            self.tick_us[1] <= SOAK_COST_RATIO * self.tick_us[0],
            self.python_kB[1] - self.python_kB[0] <= SOAK_GROWTH_KB,
            self.skipped == 0 and min(self.ruptures) > 0,
        )

    @property
    def is_met(self) -> bool:
        """Whether all targets are."""
        return all(self.marks)


class Cycle:
    """An insertion with as long a rest in the tissue, without end; `length` updates make one."""

    def __init__(self) -> None:
        run = simulate(SCENARIO, PLANT, 0)
        t_s = run.signals.t_s
        self._robot = run.robot
        self._rows = JointSignals.of_run(run).samples()
        self._tare = int(np.searchsorted(t_s, run.tare_end_s))
        at = int(np.searchsorted(t_s, run.scenario.motion.insertion_end_s + SETTLED_S))
        still = list(range(at, at + STILL))
        # Forth and back: a jump from the last to the first would be a spike to the session.
        moving = len(self._rows) - self._tare
        rest = (still + still[::-1]) * (moving // (2 * STILL))
        self._order = [*range(self._tare, at), *rest, *range(at, len(self._rows))]
        self.length = len(self._order)

    def tared(self) -> InsertionSession:
        """A session in free air before the first insertion."""
        session = InsertionSession(self._robot, on_lwr(DEFAULT))
        for row in self._rows[: self._tare]:
            session.update(*row)
        session.tare()
        return session

    def updates(
        self, session: InsertionSession, ticks: int, progress: Progress
    ) -> Iterator[tuple[int, bool, float]]:
        """Index, whether a rupture was raised, and time [us] of every update.

        Each cycle is a new insertion.
        """
        for k in range(ticks):
            at = k % self.length
            if at == 0:
                session.begin_insertion()
            if k % WINDOW == 0:
                progress(k / ticks)
            row = self._rows[self._order[at]]
            before = perf_counter_ns()
            found = session.update(*row)
            taken_us = (perf_counter_ns() - before) / NS_PER_US
            yield k, found.identification.rupture is not None, taken_us

    def time(
        self, ticks: int, progress: Progress
    ) -> tuple[NDArray[np.float64], tuple[int, ...], int]:
        """Time of every update [us], shape (ticks,); ruptures by whole cycle; samples rejected."""
        session, taken, ruptures = self.tared(), np.zeros(ticks), [0] * (ticks // self.length + 1)
        for k, is_rupture, taken_us in self.updates(session, ticks, progress):
            taken[k] = taken_us
            ruptures[k // self.length] += is_rupture
        return taken, tuple(ruptures[:-1]), session.skipped

    def memory(self, ticks: int, progress: Progress) -> NDArray[np.float64]:
        """Memory of Python [kB] and of the process [MB], after each whole cycle, shape (n, 2)."""
        session, process, held = self.tared(), psutil.Process(), []
        tracemalloc.start()
        try:
            for k, _, _ in self.updates(session, ticks, progress):
                if k % self.length == 0 and k > 0:
                    python_kB = tracemalloc.get_traced_memory()[0] / BYTES_PER_KB
                    held.append((python_kB, process.memory_info().rss / BYTES_PER_MB))
            return np.array(held)
        finally:
            tracemalloc.stop()


def run_soak(ticks: int, progress: Progress = lambda fraction: None) -> Soak:
    """Insert, rest and withdraw over and over on one tare, every time as a new insertion.

    In every cycle the needle rests in the tissue for as long as it moves. Cost and memory are
    measured in separate passes, since watching memory costs time. At least two cycles are run.
    """
    cycle = Cycle()
    ticks = max(ticks, 2 * cycle.length + 1)
    times, ruptures, skipped = cycle.time(ticks, progress_part(progress, 0.0, 0.5))
    # The same part of a cycle at the end.
    last = ((len(times) - WINDOW) // cycle.length) * cycle.length
    medians = [float(np.median(times[at : at + WINDOW])) for at in (cycle.length, last)]
    held = cycle.memory(ticks, progress_part(progress, 0.5, 1.0))
    return Soak(
        tick_us=(medians[0], medians[1]),
        python_kB=(held[0, 0], held[-1, 0]),
        process_MB=(held[0, 1], held[-1, 1]),
        ruptures=ruptures,
        skipped=skipped,
    )


def soak_table(found: Soak, ticks: int) -> ResultTable:
    """Start and end, with the targets."""
    is_quick, is_lean, is_busy = map(met_mark, found.marks)
    tick_us, python_kB = (f"{value:.1f}" for value in found.tick_us), map(round, found.python_kB)
    ends = (str(found.ruptures[0]), str(found.ruptures[-1]))
    return ResultTable(
        title=f"{ticks} ticks of the chain: insertions, rests and cycles on one tare",
        heads=("what", "start", "end", "target", ""),
        align="LrrrL",
        lines=(
            ("median tick, us", *tick_us, f"≤ {SOAK_COST_RATIO:g} x start", is_quick),
            ("Python's memory, kB", *map(str, python_kB), f"+ {SOAK_GROWTH_KB:g} at most", is_lean),
            ("memory of the process, MB", *(f"{value:.1f}" for value in found.process_MB), "", ""),
            ("ruptures an insertion", *ends, "≥ 1 in all, none skipped", is_busy),
        ),
    )
