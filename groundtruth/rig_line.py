"""An emulated line between the ends of a teleoperation, with late packets."""

from collections import deque
from typing import Generic, TypeVar

from numpy.random import Generator, default_rng

Packet = TypeVar("Packet")


class DelayLine(Generic[Packet]):
    """A line on which each packet is late by ``delay ± jitter``, drawn uniformly.

    The newest that has arrived counts; one that is overtaken is dropped.
    """

    def __init__(
        self, delay_s: float = 0.0, jitter_s: float = 0.0, rng: Generator | None = None
    ) -> None:
        self._delay_s = delay_s
        self._jitter_s = jitter_s
        self._rng = default_rng(0) if rng is None else rng
        self._under_way: deque[tuple[float, Packet]] = deque()
        self._time_s = 0.0
        self._newest: Packet | None = None

    def exchange(self, packet: Packet, dt_s: float) -> Packet | None:
        """Send a packet, let time pass, and return the newest that has arrived."""
        self._time_s += dt_s
        jitter_s = self._rng.uniform(-self._jitter_s, self._jitter_s)
        late_s = max(0.0, self._delay_s + jitter_s)
        line = self._under_way
        arrival_s = self._time_s + late_s
        while line and line[-1][0] >= arrival_s:
            line.pop()  # overtaken by this one
        line.append((arrival_s, packet))
        while line and line[0][0] <= self._time_s:
            self._newest = line.popleft()[1]
        return self._newest
