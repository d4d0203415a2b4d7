"""A million updates: does the chain grow, does it slow down?"""

import tracemalloc
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from time import perf_counter_ns

import numpy as np
import psutil
from numpy.typing import NDArray

from benchmarks.methods import on_lwr
from benchmarks.signals import JointSignals
from benchmarks.tables import ResultTable, met_mark
from benchmarks.targets import SOAK_COST_RATIO, SOAK_GROWTH_KB
from groundtruth import simulate
from needleforce import InsertionSession, SessionEstimate
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
    def is_busy(self) -> bool:
        """Whether every insertion had its rupture and no sample was lost: idling is cheap."""
        return self.skipped == 0 and min(self.ruptures) > 0

    @property
    def is_quick(self) -> bool:
        """Whether an update at the end costs no more than one at the start."""
        return self.tick_us[1] <= SOAK_COST_RATIO * self.tick_us[0]

    @property
    def is_lean(self) -> bool:
        """Whether Python holds no more than at the start."""
        return self.python_kB[1] - self.python_kB[0] <= SOAK_GROWTH_KB

    @property
    def is_met(self) -> bool:
        """Whether all targets are."""
        return self.is_busy and self.is_quick and self.is_lean


class Cycle:
    """An insertion with as long a rest in the tissue, without end.

    Attributes:
        length: Updates of one.
    """

    def __init__(self) -> None:
        run = simulate(SCENARIO, PLANT, 0)
        sent = run.signals
        self._robot = run.robot
        self._rows = JointSignals.of_run(run).samples()
        self._tare = int(np.searchsorted(sent.t_s, run.tare_end_s))
        at = int(np.searchsorted(sent.t_s, run.scenario.motion.insertion_end_s + SETTLED_S))
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
        self, session: InsertionSession, ticks: int
    ) -> Iterator[tuple[SessionEstimate, float]]:
        """Estimate and time [us] of every update, each cycle as a new insertion."""
        for k in range(ticks):
            at = k % self.length
            if at == 0:
                session.begin_insertion()
            row = self._rows[self._order[at]]
            before = perf_counter_ns()
            found = session.update(*row)
            yield found, (perf_counter_ns() - before) / NS_PER_US

    def time(
        self, ticks: int, progress: Callable[[float], None]
    ) -> tuple[NDArray[np.float64], tuple[int, ...], int]:
        """Time of every update [us], shape (ticks,); ruptures by whole cycle; samples rejected."""
        session, taken, ruptures = self.tared(), np.zeros(ticks), [0] * (ticks // self.length + 1)
        for k, (found, time_us) in enumerate(self.updates(session, ticks)):
            taken[k] = time_us
            ruptures[k // self.length] += found.identification.rupture is not None
            if k % WINDOW == 0:
                progress(k / ticks)
        return taken, tuple(ruptures[:-1]), session.skipped

    def memory(self, ticks: int, progress: Callable[[float], None]) -> NDArray[np.float64]:
        """Memory of Python [kB] and of the process [MB], after each whole cycle, shape (n, 2)."""
        session, process, held = self.tared(), psutil.Process(), []
        tracemalloc.start()
        try:
            for k, _ in enumerate(self.updates(session, ticks)):
                if k % self.length == 0 and k > 0:
                    python_kB = tracemalloc.get_traced_memory()[0] / BYTES_PER_KB
                    held.append((python_kB, process.memory_info().rss / BYTES_PER_MB))
                if k % WINDOW == 0:
                    progress(k / ticks)
            return np.array(held)
        finally:
            tracemalloc.stop()


def run_soak(ticks: int, progress: Callable[[float], None] = lambda fraction: None) -> Soak:
    """Insert, rest and withdraw over and over on one tare, every time as a new insertion.

    In every cycle the needle rests in the tissue for as long as it moves. Cost and memory are
    measured in separate passes, since watching memory costs time.

    Args:
        ticks: How many updates, after the tare; at least two cycles and one.
        progress: Gets the fraction done.
    """
    cycle = Cycle()
    ticks = max(ticks, 2 * cycle.length + 1)
    times, ruptures, skipped = cycle.time(ticks, lambda fraction: progress(0.5 * fraction))
    # The same part of a cycle at the end.
    last = ((len(times) - WINDOW) // cycle.length) * cycle.length
    medians = [float(np.median(times[at : at + WINDOW])) for at in (cycle.length, last)]
    held = cycle.memory(ticks, lambda fraction: progress(0.5 + 0.5 * fraction))
    return Soak(
        tick_us=(medians[0], medians[1]),
        python_kB=(held[0, 0], held[-1, 0]),
        process_MB=(held[0, 1], held[-1, 1]),
        ruptures=ruptures,
        skipped=skipped,
    )


def soak_table(found: Soak, ticks: int) -> ResultTable:
    """Start and end, with the targets."""
    return ResultTable(
        title=f"{ticks} ticks of the chain: insertions, rests and cycles on one tare",
        heads=("what", "start", "end", "target", ""),
        align="LrrrL",
        lines=(
            (
                "median tick, us",
                *(f"{value:.1f}" for value in found.tick_us),
                f"≤ {SOAK_COST_RATIO:g} x start",
                met_mark(found.is_quick),
            ),
            (
                "Python's memory, kB",
                *(f"{value:.0f}" for value in found.python_kB),
                f"+ {SOAK_GROWTH_KB:g} at most",
                met_mark(found.is_lean),
            ),
            ("memory of the process, MB", *(f"{value:.1f}" for value in found.process_MB), "", ""),
            (
                "ruptures an insertion",
                f"{found.ruptures[0]}",
                f"{found.ruptures[-1]}",
                "≥ 1 in all, none skipped",
                met_mark(found.is_busy),
            ),
        ),
    )
