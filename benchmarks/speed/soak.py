"""A million ticks: does the chain grow, does it slow down?"""

import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter_ns

import numpy as np

from benchmarks.methods.sensor_settings import on_lwr
from groundtruth import simulate
from insertion import InsertionSession
from residual import DEFAULT

SCENARIO, ARM = "gel-25-constant", "realistic"
WINDOW = 20_000
"""Ticks of the first and of the last median: more than one cycle's worth of either."""
SETTLED_S, STILL = 0.5, 1000
"""The needle has come to rest so long after its way in, for so many ticks at least."""
NS_PER_US, BYTES_PER_KB, BYTES_PER_MB = 1e3, 1024.0, 1024.0**2


@dataclass(frozen=True, slots=True, kw_only=True)
class Soak:
    """What many ticks did.

    Attributes:
        first_us: Median tick at the start [us], after the tare and one cycle.
        last_us: The same at the end, over the same part of a cycle.
        first_kB: Memory that Python held for the chain after that cycle.
        last_kB: The same after the last whole cycle: in the tissue a layer's data add to it.
        first_rss_MB: Memory of the process then; 0 where the system does not tell.
        last_rss_MB: The same at the end.
        ruptures: Found in each whole insertion.
        skipped: Samples that the session refused.
    """

    first_us: float
    last_us: float
    first_kB: float
    last_kB: float
    first_rss_MB: float
    last_rss_MB: float
    ruptures: tuple[int, ...]
    skipped: int

    @property
    def is_busy(self) -> bool:
        """Whether every insertion had its rupture and no sample was lost: idling is cheap."""
        return self.skipped == 0 and min(self.ruptures) > 0

    @property
    def cost_share(self) -> float:
        """Cost of a tick at the end, in times of that at the start."""
        return self.last_us / self.first_us

    @property
    def growth_kB(self) -> float:
        """What Python holds more than at the start."""
        return self.last_kB - self.first_kB


def soak(ticks: int, progress: Callable[[float], None] = lambda share: None) -> Soak:
    """Insert, rest and withdraw over and over on one tare, every time as a new insertion.

    In every cycle the needle stands still in the tissue for as long as it moves. Cost and memory
    are measured in separate passes, since watching memory costs time.

    Args:
        ticks: How many, after the tare; at least two cycles and one.
        progress: Told the share done.
    """
    cycle = Cycle()
    ticks = max(ticks, 2 * cycle.length + 1)
    times, ruptures, skipped = cycle.time(ticks, lambda share: progress(0.5 * share))
    first = times[cycle.length : cycle.length + WINDOW]
    # The same part of a cycle at the end.
    start = ((len(times) - WINDOW) // cycle.length) * cycle.length
    start = start if start + WINDOW <= len(times) else start - cycle.length
    last = times[start : start + WINDOW]
    memory = cycle.memory(ticks, lambda share: progress(0.5 + 0.5 * share))
    return Soak(
        first_us=float(np.median(first)),
        last_us=float(np.median(last)),
        first_kB=memory[0][0],
        last_kB=memory[1][0],
        first_rss_MB=memory[0][1],
        last_rss_MB=memory[1][1],
        ruptures=ruptures,
        skipped=skipped,
    )


class Cycle:
    """An insertion with as long a rest in the tissue, without end.

    Attributes:
        length: Ticks of one.
    """

    def __init__(self) -> None:
        run = simulate(SCENARIO, ARM, 0)
        sent = run.signals
        self._robot = run.robot
        assert sent.dq_rad_s is not None, "the arm that is timed sends velocities"
        step = [1e-3] * len(sent.t_s)
        self._rows = list(zip(sent.q_rad, sent.dq_rad_s, sent.tau_Nm, step, strict=True))
        self._tare = int(np.searchsorted(sent.t_s, run.tare_end_s))
        at = int(np.searchsorted(sent.t_s, run.scenario.motion.insertion_end_s + SETTLED_S))
        still = list(range(at, at + STILL))
        # Forth and back: a jump from the last to the first would be a spike to the session.
        moving = len(self._rows) - self._tare
        rest = (still + still[::-1]) * (moving // (2 * STILL))
        self._order = [*range(self._tare, at), *rest, *range(at, len(self._rows))]
        self.length = len(self._order)

    def _tared(self) -> InsertionSession:
        session = InsertionSession(self._robot, on_lwr(DEFAULT))
        for row in self._rows[: self._tare]:
            session.update(*row)
        session.tare()
        return session

    def time(
        self, ticks: int, progress: Callable[[float], None]
    ) -> tuple[np.ndarray, tuple[int, ...], int]:
        """Time of every tick [us], shape (ticks,); ruptures by whole cycle; samples skipped."""
        session, taken, ruptures = self._tared(), np.zeros(ticks), [0] * (ticks // self.length + 1)
        for k in range(ticks):
            cycle, at = divmod(k, self.length)
            if at == 0:
                session.begin_insertion()
            row = self._rows[self._order[at]]
            before = perf_counter_ns()
            found = session.update(*row)
            taken[k] = (perf_counter_ns() - before) / NS_PER_US
            ruptures[cycle] += found.identification.rupture is not None
            if k % WINDOW == 0:
                progress(k / ticks)
        return taken, tuple(ruptures[:-1]), session.skipped

    def memory(
        self, ticks: int, progress: Callable[[float], None]
    ) -> tuple[tuple[float, float], tuple[float, float]]:
        """Python's memory [kB] and that of the process [MB], after the first and the last cycle."""
        session, held = self._tared(), []
        tracemalloc.start()
        try:
            for k in range(ticks):
                at = k % self.length
                if at == 0:
                    session.begin_insertion()
                session.update(*self._rows[self._order[at]])
                if at == 0 and k > 0:
                    held.append(_held())
                if k % WINDOW == 0:
                    progress(k / ticks)
            return held[0], held[-1]
        finally:
            tracemalloc.stop()


def _held() -> tuple[float, float]:
    """Memory now: Python's since tracing began [kB], and that of the process [MB]."""
    status = Path("/proc/self/statm")
    pages = int(status.read_text(encoding="utf-8").split()[1]) if status.exists() else 0
    return tracemalloc.get_traced_memory()[0] / BYTES_PER_KB, pages * 4096.0 / BYTES_PER_MB
