"""What a tare that is fitted beside the ticks adds to the longest of them."""

from collections.abc import Iterator
from copy import deepcopy
from time import perf_counter_ns

import numpy as np

from benchmarks.insertion.methods import on_lwr
from benchmarks.insertion.signals import JointSample, JointSignals
from benchmarks.results import Figure
from foundation.arrays import Array
from groundtruth import Run
from needleforce import InsertionSession
from residual import DEFAULT

NS_PER_MS = 1e6


def time_tare(run: Run) -> Iterator[Figure]:
    """Time the ticks of a tare after the free motion of a simulated insertion.

    The same ticks are timed five times; of each the shortest counts, so that what the
    machine does beside them does not.
    """
    repetitions = 5
    signals = JointSignals.of_run(run)
    samples = signals.samples()
    tare = int(np.searchsorted(signals.t_s, run.tare_end_s))
    moved = InsertionSession(run.robot, on_lwr(DEFAULT))
    for sample in samples[:tare]:
        moved.update(*sample)
    passes = [_time_ticks(moved, samples[tare:]) for _ in range(repetitions)]
    blocking_ms: list[float] = []
    for _ in range(repetitions):
        session = deepcopy(moved)
        begin_ns = perf_counter_ns()
        session.tare()
        blocking_ms.append((perf_counter_ns() - begin_ns) / NS_PER_MS)
    taring_ms, plain_ms = np.min(passes, axis=0).T
    yield Figure("tare_ticks", len(taring_ms))
    yield Figure("tare_tick_longest_ms", taring_ms.max())
    yield Figure("tare_tick_longest_without_ms", plain_ms.max())
    yield Figure("tare_tick_difference_ms", taring_ms.max() - plain_ms.max())
    yield Figure("tare_at_once_ms", min(blocking_ms))


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
