"""What a tare that is fitted beside the ticks adds to the longest of them."""

from copy import deepcopy
from time import perf_counter_ns
from typing import NamedTuple

import numpy as np

from benchmarks.insertion.methods import on_lwr
from benchmarks.insertion.signals import JointSample, JointSignals
from benchmarks.report.tables import ResultTable, met_mark
from benchmarks.targets import MAX_TARE_TICK_MS
from foundation.arrays import Array
from groundtruth import Run
from needleforce import InsertionSession
from residual import DEFAULT

REPETITIONS = 5
"""Times that the same ticks are timed; of each the shortest counts, so that what the
machine does beside them does not."""

NS_PER_MS = 1e6


class TareTicks(NamedTuple):
    """Times of the same ticks of one run, with and without a tare beside them.

    Attributes:
        taring_ms: While a tare is fitted, shape (n,).
        plain_ms: Without one, shape (n,).
        blocking_ms: Time of the tare that does not return before it is done.
    """

    taring_ms: Array
    plain_ms: Array
    blocking_ms: float

    @property
    def longer_ms(self) -> float:
        """By how much the longest tick is longer with a tare than without."""
        return float(self.taring_ms.max() - self.plain_ms.max())


def time_tare(run: Run) -> TareTicks:
    """Time the ticks of a tare after the free motion of a simulated insertion."""
    signals = JointSignals.of_run(run)
    samples = signals.samples()
    tare = int(np.searchsorted(signals.t_s, run.tare_end_s))
    moved = InsertionSession(run.robot, on_lwr(DEFAULT))
    for sample in samples[:tare]:
        moved.update(*sample)
    passes = [_time_ticks(moved, samples[tare:]) for _ in range(REPETITIONS)]
    blocking_ms: list[float] = []
    for _ in range(REPETITIONS):
        session = deepcopy(moved)
        begin_ns = perf_counter_ns()
        session.tare()
        blocking_ms.append((perf_counter_ns() - begin_ns) / NS_PER_MS)
    taring_ms, plain_ms = np.min(passes, axis=0).T
    return TareTicks(taring_ms, plain_ms, min(blocking_ms))


def _time_ticks(moved: InsertionSession, samples: list[JointSample]) -> Array:
    """Time ticks with and without a tare, in turn, until it is done, shape (n, 2)."""
    taring = deepcopy(moved)
    plain = deepcopy(moved)
    taring.start_tare()
    taken_ms: list[tuple[float, float]] = []
    for sample in samples:
        taken_ms.append((_time_update(taring, sample), _time_update(plain, sample)))
        if not taring.taring:
            break
    return np.array(taken_ms)


def _time_update(session: InsertionSession, sample: JointSample) -> float:
    """Return the time of an update [ms]."""
    begin_ns = perf_counter_ns()
    session.update(*sample)
    return (perf_counter_ns() - begin_ns) / NS_PER_MS


def tare_table(ticks: TareTicks) -> ResultTable:
    """Return the longest ticks, with the target of their difference."""
    longer_ms = ticks.longer_ms
    return ResultTable(
        title="Ticks beside a tare",
        heads=(
            *("ticks", "longest\nms", "without a\ntare, ms", "difference\nms"),
            *("target", "", "tare() at\nonce, ms"),
        ),
        align="rrrrrLr",
        lines=(
            (
                str(len(ticks.taring_ms)),
                f"{ticks.taring_ms.max():.2f}",
                f"{ticks.plain_ms.max():.2f}",
                f"{longer_ms:.2f}",
                f"≤ {MAX_TARE_TICK_MS:g}",
                met_mark(longer_ms <= MAX_TARE_TICK_MS),
                f"{ticks.blocking_ms:.0f}",
            ),
        ),
        caption=f"the same ticks, taking turns; of each the shortest of {REPETITIONS} "
        "passes",
    )
