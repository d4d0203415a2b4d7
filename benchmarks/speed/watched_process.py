"""Runs a command and watches its time and memory."""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile

from benchmarks.errors import BenchmarkError

_LOOK_S = 0.05
_KB = 1024


@dataclass(frozen=True, slots=True, kw_only=True)
class Watched:
    """What a process needed.

    Attributes:
        wall_s: From start to end [s].
        cpu_s: Time on processors [s].
        memory_MB: Resident memory as it went on, of equal steps in time [MB]; empty where the
            system does not tell.
    """

    wall_s: float
    cpu_s: float
    memory_MB: tuple[float, ...]

    def memory_at(self, share: float) -> float:
        """Resident memory when that share of the time had passed [MB]; nan if unknown."""
        if not self.memory_MB:
            return float("nan")
        return self.memory_MB[min(int(share * len(self.memory_MB)), len(self.memory_MB) - 1)]

    @property
    def peak_MB(self) -> float:
        """Most resident memory seen [MB]; nan if unknown."""
        return max(self.memory_MB, default=float("nan"))


def watch_process(
    arguments: Sequence[str], tell: Callable[[float], None] = lambda seconds: None
) -> Watched:
    """Run ``python`` with these arguments to its end.

    Args:
        arguments: After the interpreter.
        tell: Told now and then how many seconds have passed.

    Raises:
        BenchmarkError: It failed.
    """
    # One thread of linear algebra: what is measured is one core.
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    before, start_s = os.times(), time.perf_counter()
    memory_MB: list[float] = []
    # A file, not a pipe: that would be full after 64 kB, and the process would wait for ever.
    with TemporaryFile() as errors:
        process = subprocess.Popen(
            [sys.executable, *arguments], env=environment, stdout=subprocess.DEVNULL, stderr=errors
        )
        while process.poll() is None:
            memory_MB += _resident_MB(process.pid)
            tell(time.perf_counter() - start_s)
            time.sleep(_LOOK_S)
        wall_s, after = time.perf_counter() - start_s, os.times()
        errors.seek(0)
        said = errors.read().decode(errors="replace").strip()
    if process.returncode != 0:
        raise BenchmarkError(f"python {' '.join(arguments)} failed: {said.splitlines()[-1:]}")
    user_s = after.children_user - before.children_user
    system_s = after.children_system - before.children_system
    return Watched(wall_s=wall_s, cpu_s=user_s + system_s, memory_MB=tuple(memory_MB))


def _resident_MB(pid: int) -> list[float]:
    """Resident memory, if the system tells it."""
    try:
        status = Path(f"/proc/{pid}/status").read_text(encoding="utf-8")
    except OSError:
        return []
    lines = [line for line in status.splitlines() if line.startswith("VmRSS:")]
    return [int(line.split()[1]) * _KB / 1e6 for line in lines]
