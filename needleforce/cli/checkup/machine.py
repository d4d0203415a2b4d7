"""What a control loop would find on this machine: cores, clock, real-time priority."""

import os
import platform
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from statistics import median

SLEEPS = 50
"""Sleeps that are measured."""

SLEEP_s = 1e-3
"""Length of each: a tick of a control loop [s]."""

CLOCK_READINGS = 1000
"""Readings of the clock among which the shortest step is looked for."""

REAL_TIME_KERNEL = Path("/sys/kernel/realtime")
"""Holds 1 where the kernel is a real-time one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Machine:
    """What a control loop would find.

    Attributes:
        system: Operating system and kernel.
        processor: Kind of processor.
        cores: Cores that this process may use.
        blas_threads: Threads of linear algebra, as ``OMP_NUM_THREADS`` sets them; empty
            where it is not set.
        clock_step_s: Shortest step of the clock that was seen.
        sleep_median_s: How long a sleep of 1 ms takes, median.
        sleep_longest_s: The longest of them.
        may_run_real_time: Whether a thread may have a real-time priority (SCHED_FIFO);
            None where the system has none.
        is_real_time_kernel: Whether the kernel is a real-time one.
    """

    system: str
    processor: str
    cores: int
    blas_threads: str
    clock_step_s: float
    sleep_median_s: float
    sleep_longest_s: float
    may_run_real_time: bool | None
    is_real_time_kernel: bool


def inspect_machine() -> Machine:
    """Return what this machine offers; takes a tenth of a second."""
    sleeps_s = _measure_sleeps_s()
    return Machine(
        system=f"{platform.system()} {platform.release()}",
        processor=platform.machine(),
        cores=_count_cores(),
        blas_threads=os.environ.get("OMP_NUM_THREADS", ""),
        clock_step_s=_measure_clock_step_s(),
        sleep_median_s=median(sleeps_s),
        sleep_longest_s=max(sleeps_s),
        may_run_real_time=_may_run_real_time(),
        is_real_time_kernel=_is_real_time_kernel(),
    )


def _count_cores() -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _measure_clock_step_s() -> float:
    """Return the shortest step between readings of the clock."""
    readings = [time.perf_counter() for _ in range(CLOCK_READINGS)]
    steps_s = [later - earlier for earlier, later in pairwise(readings)]
    return min((step_s for step_s in steps_s if step_s > 0.0), default=0.0)


def _measure_sleeps_s() -> list[float]:
    """Return how long sleeps of one tick take."""
    lengths_s: list[float] = []
    for _ in range(SLEEPS):
        start_s = time.perf_counter()
        time.sleep(SLEEP_s)
        lengths_s.append(time.perf_counter() - start_s)
    return lengths_s


def _may_run_real_time() -> bool | None:
    """Return whether a thread may take a real-time priority; it ends at once."""
    if not hasattr(os, "sched_setscheduler"):
        return None
    granted: list[bool] = []

    def try_priority() -> None:
        with suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
            granted.append(True)

    thread = threading.Thread(target=try_priority)
    thread.start()
    thread.join()
    return bool(granted)


def _is_real_time_kernel() -> bool:
    """Return whether the kernel is a real-time one."""
    with suppress(OSError):
        return REAL_TIME_KERNEL.read_text(encoding="ascii").strip() == "1"
    return "PREEMPT_RT" in platform.version()
