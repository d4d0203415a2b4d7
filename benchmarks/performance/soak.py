"""Many updates of the chain: does it grow or slow down?"""

import tracemalloc
from collections.abc import Iterator
from time import perf_counter_ns

import numpy as np
import psutil

from benchmarks.insertion.methods import on_lwr
from benchmarks.insertion.signals import JointSignals
from benchmarks.jobs import Job, Progress, progress_part
from benchmarks.results import Figure
from foundation.arrays import Array
from groundtruth import simulate
from needleforce import InsertionSession
from residual import DEFAULT

CASES = ("1000000 ticks",)
WINDOW = 20_000
"""Updates of the first and of the last median: more than one cycle's worth of
either."""


class Cycle:
    """An insertion with as long a rest in the tissue, without end.

    `length` updates make one.
    """

    def __init__(self) -> None:
        run = simulate("gel-25-constant", "clean", 0)
        t_s = run.signals.t_s
        self.signals = JointSignals.of_run(run)
        self._robot = run.robot
        self._rows = self.signals.samples()
        self.tare = int(np.searchsorted(t_s, run.tare_end_s))
        # The needle is at rest half a second after its insertion, for a second at
        # least.
        at = int(np.searchsorted(t_s, run.scenario.motion.insertion_end_s + 0.5))
        still = list(range(at, at + 1000))
        # Forth and back: a jump from the last to the first would be a spike to the
        # session.
        moving = len(self._rows) - self.tare
        resting = (still + still[::-1]) * (moving // (2 * len(still)))
        self.order = [*range(self.tare, at), *resting, *range(at, len(self._rows))]
        self.length = len(self.order)

    def tared(self) -> InsertionSession:
        """Return a session in free air before the first insertion."""
        session = InsertionSession(self._robot, on_lwr(DEFAULT))
        for row in self._rows[: self.tare]:
            session.update(*row)
        session.tare()
        return session

    def updates(
        self, session: InsertionSession, ticks: int, progress: Progress
    ) -> Iterator[tuple[float, bool]]:
        """Update a session; yield the time of each [us], and whether it is a rupture.

        Each cycle is a new insertion, into fresh tissue.
        """
        for k in range(ticks):
            at = k % self.length
            if at == 0:
                session.begin_insertion()
                session.forget_channels()
            if k % WINDOW == 0:
                progress(k / ticks)
            row = self._rows[self.order[at]]
            begin_ns = perf_counter_ns()
            estimate = session.update(*row)
            taken_us = 1e-3 * (perf_counter_ns() - begin_ns)
            yield taken_us, estimate.identification.rupture is not None

    def memory(self, ticks: int, progress: Progress) -> Array:
        """Return memory of Python [kB] and of the process [MB], shape (n, 2).

        One row after each whole cycle: in the tissue a layer's data add to it.
        """
        session = self.tared()
        process = psutil.Process()
        held = []
        tracemalloc.start()
        try:
            for tick, _ in enumerate(self.updates(session, ticks, progress)):
                if tick % self.length == 0 and tick > 0:
                    python_kB = tracemalloc.get_traced_memory()[0] / 1024.0
                    held.append((python_kB, process.memory_info().rss / 1024.0**2))
            return np.array(held)
        finally:
            tracemalloc.stop()


def run(job: Job, progress: Progress) -> Iterator[Figure]:
    """Insert, rest and withdraw over and over on one tare.

    Every time is a new insertion. In every cycle the needle rests in the tissue for as
    long as it moves. Cost and memory are measured in separate passes, since watching
    memory costs time. At least two cycles are run.
    """
    cycle = Cycle()
    ticks = max(int(job.case.split()[0]), 2 * cycle.length + 1)
    session = cycle.tared()
    timing = progress_part(progress, 0.0, 0.5)
    taken_us, is_rupture = np.array(list(cycle.updates(session, ticks, timing))).T
    held = cycle.memory(ticks, progress_part(progress, 0.5, 1.0))
    yield from describe(taken_us, is_rupture, cycle.length, held)
    yield Figure("soak_rejected", session.rejected)


def describe(
    taken_us: Array, is_rupture: Array, length: int, held: Array
) -> Iterator[Figure]:
    """Yield what changed from the start to the end.

    Args:
        taken_us: Time of every update, shape (n,).
        is_rupture: Whether it raised one, shape (n,).
        length: Updates of a cycle.
        held: Memory as `Cycle.memory` returns it.
    """
    # The start is after the tare and one cycle; the end is the same part of a cycle.
    end = ((len(taken_us) - WINDOW) // length) * length
    start_us, end_us = (
        float(np.median(taken_us[at : at + WINDOW])) for at in (length, end)
    )
    cycles = len(taken_us) // length
    ruptures = is_rupture[: cycles * length].reshape(cycles, length).sum(axis=1)
    yield Figure("soak_tick_start_us", start_us)
    yield Figure("soak_tick_end_us", end_us)
    yield Figure("soak_tick_ratio", end_us / start_us)
    yield Figure("soak_python_start_kB", held[0, 0])
    yield Figure("soak_python_growth_kB", held[-1, 0] - held[0, 0])
    yield Figure("soak_process_start_MB", held[0, 1])
    yield Figure("soak_process_end_MB", held[-1, 1])
    # Idling is cheap: there was something to do throughout.
    yield Figure("soak_ruptures_fewest", ruptures.min())
