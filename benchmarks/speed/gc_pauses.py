"""How long Python's garbage collector stops everything."""

import gc
from time import perf_counter_ns
from typing import Any

NS_PER_US = 1e3


class GcPauses:
    """Times every collection while it is entered; collections happen in whatever tick is next.

    Attributes:
        pauses_us: Length of each [us], in order.
    """

    def __init__(self) -> None:
        self.pauses_us: list[float] = []
        self._start_ns = 0

    def __enter__(self) -> "GcPauses":
        gc.callbacks.append(self._note)
        return self

    def __exit__(self, *_: object) -> None:
        gc.callbacks.remove(self._note)

    def _note(self, phase: str, _: dict[str, Any]) -> None:
        if phase == "start":
            self._start_ns = perf_counter_ns()
        else:
            self.pauses_us.append((perf_counter_ns() - self._start_ns) / NS_PER_US)
