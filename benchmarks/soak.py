"""A million ticks: does the chain grow, does it slow down?"""

import os
import subprocess
import sys
import time
import tracemalloc
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from time import perf_counter_ns

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from benchmarks.errors import BenchmarkError
from benchmarks.methods import on_lwr
from benchmarks.signals import tool_jacobians
from groundtruth import insert_needle, simulate
from needleforce import InsertionSession
from recordings import RecordingError
from recordings.columns.force_codes import FORCE_STATUS
from recordings.open_table import open_table
from residual import DEFAULT
from urdf import NeedleTool, Robot, load_lwr

SCENARIO, ARM = "gel-25-constant", "clean"
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


# Recordings of any length: one cycle of motion, again and again, with fresh noise.


Columns = dict[str, NDArray[np.float64]]

RATE_HZ = 1000.0
FREE_S = 10.0
"""So long at its start a recording of joint signals is without contact."""

_CYCLE_S = 20.0
_REACH_RAD = 0.05
_PUSH_N = 1.5
_TORQUE_NOISE_NM = 0.01
_FORCE_NOISE_N = 0.003
_WAY_S = 20.0


def joint_recording(seconds: float, rng: np.random.Generator) -> Iterator[Columns]:
    """Joint signals of an LWR that moves, and is pushed once in every cycle.

    Args:
        seconds: Length [s].
        rng: Of the noise.

    Yields:
        Columns of consecutive rows.
    """
    cycle = _joint_cycle(load_lwr(payload=NeedleTool()))
    for columns in _repeated(cycle, seconds):
        torque = columns["tau_Nm"]
        columns["tau_Nm"] = torque + _TORQUE_NOISE_NM * rng.normal(size=torque.shape)
        yield columns


def needle_recording(seconds: float, rng: np.random.Generator) -> Iterator[Columns]:
    """Depth, speed and force of a needle that goes into gel and out, again and again.

    Every cycle is in fresh tissue, whose surface lies as deep as the needle has come before: in
    the channel of an insertion there is nothing left to rupture.

    Args:
        seconds: Length [s].
        rng: Of the noise.

    Yields:
        Columns of consecutive rows.
    """
    run = insert_needle("gel-50-constant", seed=0, rate_hz=RATE_HZ)
    taring = int(np.searchsorted(run.t_s, run.tare_end_s))
    deepest_m = float(run.depth_m.max())
    way_m = deepest_m + float(run.depth_m[taring] - run.depth_m[-1])
    phase = np.arange(1.0, _WAY_S * RATE_HZ) / (_WAY_S * RATE_HZ) * np.pi
    way = run.depth_m[-1] + 0.5 * way_m * (1.0 - np.cos(phase))
    way_speed = 0.5 * way_m * np.pi / _WAY_S * np.sin(phase)
    cycle = {
        "depth_m": np.concatenate((run.depth_m, way)),
        "speed_m_s": np.concatenate((run.speed_m_s, way_speed)),
        "force_N": np.concatenate((run.force_N, np.zeros(len(way)))),
    }
    for number, columns in enumerate(_repeated(cycle, seconds, taring)):
        columns["depth_m"] += number * deepest_m
        force = columns["force_N"]
        columns["force_N"] = force + _FORCE_NOISE_N * rng.normal(size=force.shape)
        yield columns


def _repeated(cycle: Columns, seconds: float, again_from: int = 0) -> Iterator[Columns]:
    """The cycle, and then over and over its rows from `again_from` on."""
    left, done, start = round(seconds * RATE_HZ), 0, 0
    while left > 0:
        columns = {name: values[start : start + left].copy() for name, values in cycle.items()}
        rows = len(next(iter(columns.values())))
        yield {"t_s": np.arange(done, done + rows) / RATE_HZ, **columns}
        left, done, start = left - rows, done + rows, again_from


def _joint_cycle(robot: Robot) -> Columns:
    """Smooth motion that ends as it began, and a push along the needle in its second half."""
    t = np.arange(_CYCLE_S * RATE_HZ) / RATE_HZ
    joints = np.arange(robot.nv)
    pulsation = 2.0 * np.pi / _CYCLE_S * (1.0 + joints % 3)
    phase = np.outer(t, pulsation)
    middle = np.array([0.0, 0.5, 0.0, -1.2, 0.0, 0.9, 0.0])
    q = np.asarray(middle + _REACH_RAD * np.sin(phase), dtype=np.float64)
    dq = np.asarray(_REACH_RAD * pulsation * np.cos(phase), dtype=np.float64)
    ddq = -_REACH_RAD * pulsation**2 * np.sin(phase)
    push = np.where(t > FREE_S, _PUSH_N * np.sin(np.pi * (t - FREE_S) / FREE_S) ** 2, 0.0)
    data = robot.create_data()
    free = [pin.rnea(robot.model, data, *row) for row in zip(q, dq, ddq, strict=True)]
    # The tissue pushes the tool back along its z axis: torque of the environment.
    external = -push[:, None] * tool_jacobians(robot, q)[:, 2]
    return {"q_rad": q, "dq_rad_s": dq, "tau_Nm": np.array(free) - external}


# What a command still found at the end of a long recording.


LATE_ROWS = 80_000
"""Longer than a cycle of a recording of `long_recording`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LateRows:
    """Of the last `LATE_ROWS` rows, or all if there are fewer.

    Attributes:
        ruptures: Found in them; None for a command that looks for none.
        skipped: Rows that the command could not use.
    """

    ruptures: int | None
    skipped: int


def late_rows(path: Path) -> LateRows:
    """Read the end of a table that `residual` or `identification` has written as CSV."""
    with path.open(encoding="utf-8") as lines:
        names = next(lines).strip().split(",")
        last = deque(lines, maxlen=LATE_ROWS)
    wanted = ("force_status",) if "force_status" in names else ("absorbed", "rupture")
    values = np.loadtxt(
        last, delimiter=",", usecols=[names.index(name) for name in wanted], ndmin=2
    )
    if wanted == ("force_status",):
        skipped = np.count_nonzero(values[:, 0] == FORCE_STATUS.index("skipped"))
        return LateRows(ruptures=None, skipped=int(skipped))
    return LateRows(
        ruptures=int(np.count_nonzero(values[:, 1])),
        skipped=int(np.count_nonzero(values[:, 0] == 0.0)),
    )


# Runs a command and watches its time and memory.


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


# How fast the commands go through a long recording, and whether their memory grows.


LEAST_TIMES_REAL = 20.0
"""Times real time, on one core."""

MOST_GROWTH_MB = 20.0
"""From a tenth of the recording to its end; interpreters and allocators breathe."""

LEAST_SECONDS = 2.0 * FREE_S


@dataclass(frozen=True, slots=True, kw_only=True)
class StreamCase:
    """A command on a recording.

    Attributes:
        command: ``residual`` or ``identification``.
        suffix: Of the recording; results are written as CSV.
    """

    command: str
    suffix: str


@dataclass(frozen=True, slots=True, kw_only=True)
class StreamSpeed:
    """What it needed.

    Attributes:
        case: Which command on what.
        seconds: Length of the recording [s].
        rows: Of the recording.
        watched: Time and memory.
        late: What was found at the end: a command that idles is fast.
    """

    case: StreamCase
    seconds: float
    rows: int
    watched: Watched
    late: LateRows

    @property
    def is_busy(self) -> bool:
        """Whether no late row was skipped and ruptures went on; a short recording may have none."""
        is_alive = self.late.ruptures != 0 or self.rows < 2 * LATE_ROWS
        return is_alive and self.late.skipped == 0

    @property
    def times_real(self) -> float:
        """Length of the recording over time on the processor."""
        return self.seconds / self.watched.cpu_s

    @property
    def growth_MB(self) -> float:
        """Memory at the end over that at a tenth of the time [MB]; nan if unknown."""
        return self.watched.memory_at(1.0) - self.watched.memory_at(0.1)

    @property
    def is_met(self) -> bool:
        """Whether both targets are, without idling; unknown memory counts as a miss."""
        is_fast = self.times_real >= LEAST_TIMES_REAL
        return is_fast and self.growth_MB <= MOST_GROWTH_MB and self.is_busy


_RECORDINGS: dict[str, Callable[[float, np.random.Generator], Iterator[Columns]]] = {
    "residual": joint_recording,
    "identification": needle_recording,
}
COMMANDS = tuple(_RECORDINGS)


def measure_stream(
    case: StreamCase, seconds: float, folder: Path | None, tell: Callable[[float], None]
) -> StreamSpeed:
    """Make a recording and send it through the command.

    Args:
        case: Which command on what.
        seconds: Length of the recording [s], at least `LEAST_SECONDS`.
        folder: Where the files lie while it runs; None for the system's place.
        tell: Told the share done so far, roughly.

    Raises:
        BenchmarkError: The files cannot be written, or the command failed.
    """
    rng = np.random.default_rng(0)
    try:
        with TemporaryDirectory(dir=folder) as place:
            log = Path(place) / f"log{case.suffix}"
            rows = 0
            with open_table(log) as table:
                for columns in _RECORDINGS[case.command](seconds, rng):
                    table.append(columns)
                    rows += len(columns["t_s"])
                    tell(0.3 * rows / (seconds * 1000.0))
            options = ["--tare", f"0:{FREE_S:g}"] if case.command == "residual" else []
            out = Path(place) / "out.csv"
            expected_s = seconds / LEAST_TIMES_REAL
            watched = watch_process(
                ["-m", case.command, str(log), *options, "-o", str(out)],
                lambda passed_s: tell(0.3 + 0.7 * min(passed_s / expected_s, 1.0)),
            )
            late = late_rows(out)
    except (OSError, RecordingError) as error:
        raise BenchmarkError(f"no recording to stream: {error}") from error
    return StreamSpeed(case=case, seconds=seconds, rows=rows, watched=watched, late=late)
