"""Times ticks of several subjects side by side."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from time import perf_counter_ns

import numpy as np
from numpy.typing import NDArray

Tick = Callable[[int], object]
"""Processes the sample of that index."""

BLOCK = 200
"""Ticks of one subject before the next has its turn: short enough that whatever slows the machine
down slows all of them."""
NS_PER_US = 1e3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Timing:
    """Times of one subject.

    Attributes:
        tick_us: Time of each tick [us], shape (blocks, BLOCK).
    """

    tick_us: NDArray[np.float64]

    def percentile_us(self, percent: float) -> float:
        """Time that this share of all ticks keeps [us]."""
        return float(np.percentile(self.tick_us, percent))

    @property
    def worst_us(self) -> float:
        """Time of the slowest tick [us]."""
        return float(self.tick_us.max())

    def ticks_us(self, indices: Iterable[int]) -> NDArray[np.float64]:
        """Times of some ticks [us], counted from the first that was timed, shape (m,)."""
        flat = self.tick_us.reshape(-1)
        return np.array([flat[k] for k in indices if 0 <= k < flat.size])

    def ratio_to(self, other: "Timing") -> float:
        """Cost in times of the other's: median of the ratios of neighbouring blocks' medians."""
        ours, theirs = (np.median(item.tick_us, axis=1) for item in (self, other))
        return float(np.median(ours / theirs))


def time_side_by_side(subjects: Mapping[str, Tick], first: int, last: int) -> dict[str, Timing]:
    """Let subjects take turns, block by block, over the same samples.

    Args:
        subjects: By name; each gets every index from 0 to last - 1 once, in order.
        first: Ticks before this index are not counted: caches fill, filters settle.
        last: End of the samples; at least one block after ``first``.
    """
    times: dict[str, list[list[float]]] = {name: [] for name in subjects}
    for tick in subjects.values():
        _time(tick, 0, first)
    for start in range(first, last - BLOCK + 1, BLOCK):
        for name, tick in subjects.items():
            times[name].append(_time(tick, start, start + BLOCK))
    return {name: Timing(tick_us=np.array(blocks)) for name, blocks in times.items()}


def _time(tick: Tick, start: int, stop: int) -> list[float]:
    taken = []
    for k in range(start, stop):
        before = perf_counter_ns()
        tick(k)
        taken.append((perf_counter_ns() - before) / NS_PER_US)
    return taken
