"""A million updates, and recordings of any length: does the chain grow or slow down?"""

import math
import os
import subprocess
import sys
import time
import tracemalloc
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from time import perf_counter_ns
from typing import NamedTuple

import numpy as np
import psutil

from benchmarks import RUN_ALONE, BenchmarkError
from benchmarks.insertion.methods import on_lwr
from benchmarks.insertion.signals import JointSignals
from benchmarks.jobs import Progress, progress_part
from benchmarks.report.tables import ResultTable, met_mark
from benchmarks.targets import SOAK_COST_RATIO, SOAK_GROWTH_KB
from foundation.arrays import Array
from groundtruth import insert_needle, simulate
from needleforce import InsertionSession
from needleforce.recordings import RecordingError
from needleforce.recordings.output import open_table
from residual import DEFAULT

SCENARIO = "gel-25-constant"
PLANT = "clean"
WINDOW = 20_000
"""Updates of the first and of the last median: more than one cycle's worth of
either."""
SETTLED_S = 0.5
STILL = 1000
"""The needle is at rest so long after its insertion, for so many samples at least."""
NS_PER_US = 1e3
BYTES_PER_KB = 1024.0
BYTES_PER_MB = 1024.0**2


@dataclass(frozen=True, slots=True, kw_only=True)
class Soak:
    """What many updates did.

    Attributes:
        tick_us: Median update at the start, after the tare and one cycle, and at the
            end, over the same part of a cycle [us].
        python_kB: Memory that Python held for the chain after that cycle and after the
            last whole one: in the tissue a layer's data add to it [kB].
        process_MB: Resident memory of the process at the same times [MB].
        ruptures: Found in each whole insertion.
        skipped: Samples that the session rejected.
    """

    tick_us: tuple[float, float]
    python_kB: tuple[float, float]
    process_MB: tuple[float, float]
    ruptures: tuple[int, ...]
    skipped: int

    @property
    def is_quick(self) -> bool:
        """Whether an update stayed as quick."""
        return self.tick_us[1] <= SOAK_COST_RATIO * self.tick_us[0]

    @property
    def is_lean(self) -> bool:
        """Whether Python held no more."""
        return self.python_kB[1] - self.python_kB[0] <= SOAK_GROWTH_KB

    @property
    def is_busy(self) -> bool:
        """Whether there was something to do throughout: idling is cheap."""
        return self.skipped == 0 and min(self.ruptures) > 0

    @property
    def is_met(self) -> bool:
        """Whether all targets are."""
        return self.is_quick and self.is_lean and self.is_busy


class TickTime(NamedTuple):
    """One update of a soak.

    Attributes:
        tick: Its number.
        is_rupture: Whether it raised a rupture.
        taken_us: Time it took.
    """

    tick: int
    is_rupture: bool
    taken_us: float


class SoakTimes(NamedTuple):
    """What a pass over all updates took and found.

    Attributes:
        taken_us: Time of every update, shape (ticks,).
        ruptures: Found in each whole cycle.
        rejected: Samples that the session rejected.
    """

    taken_us: Array
    ruptures: tuple[int, ...]
    rejected: int


class Cycle:
    """An insertion with as long a rest in the tissue, without end.

    `length` updates make one.
    """

    def __init__(self) -> None:
        run = simulate(SCENARIO, PLANT, 0)
        t_s = run.signals.t_s
        self.signals = JointSignals.of_run(run)
        self._robot = run.robot
        self._rows = self.signals.samples()
        self.tare = int(np.searchsorted(t_s, run.tare_end_s))
        at = int(np.searchsorted(t_s, run.scenario.motion.insertion_end_s + SETTLED_S))
        still = list(range(at, at + STILL))
        # Forth and back: a jump from the last to the first would be a spike to the
        # session.
        moving = len(self._rows) - self.tare
        resting = (still + still[::-1]) * (moving // (2 * STILL))
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
    ) -> Iterator[TickTime]:
        """Update a session, and yield what each update took.

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
            taken_us = (perf_counter_ns() - begin_ns) / NS_PER_US
            yield TickTime(k, estimate.identification.rupture is not None, taken_us)

    def time(self, ticks: int, progress: Progress) -> SoakTimes:
        """Time every update, and count ruptures and rejected samples."""
        session = self.tared()
        taken_us = np.zeros(ticks)
        ruptures = [0] * (ticks // self.length + 1)
        for update in self.updates(session, ticks, progress):
            taken_us[update.tick] = update.taken_us
            ruptures[update.tick // self.length] += update.is_rupture
        return SoakTimes(taken_us, tuple(ruptures[:-1]), session.rejected)

    def memory(self, ticks: int, progress: Progress) -> Array:
        """Return memory of Python [kB] and of the process [MB], shape (n, 2).

        One row after each whole cycle.
        """
        session = self.tared()
        process = psutil.Process()
        held = []
        tracemalloc.start()
        try:
            for update in self.updates(session, ticks, progress):
                if update.tick % self.length == 0 and update.tick > 0:
                    python_kB = tracemalloc.get_traced_memory()[0] / BYTES_PER_KB
                    held.append((python_kB, process.memory_info().rss / BYTES_PER_MB))
            return np.array(held)
        finally:
            tracemalloc.stop()


def run_soak(ticks: int, progress: Progress = lambda fraction: None) -> Soak:
    """Insert, rest and withdraw over and over on one tare.

    Every time is a new insertion. In every cycle the needle rests in the tissue for as
    long as it moves. Cost and memory are measured in separate passes, since watching
    memory costs time. At least two cycles are run.
    """
    cycle = Cycle()
    ticks = max(ticks, 2 * cycle.length + 1)
    times = cycle.time(ticks, progress_part(progress, 0.0, 0.5))
    taken_us = times.taken_us
    # The same part of a cycle at the end.
    end = ((len(taken_us) - WINDOW) // cycle.length) * cycle.length
    medians_us = [
        float(np.median(taken_us[at : at + WINDOW])) for at in (cycle.length, end)
    ]
    held = cycle.memory(ticks, progress_part(progress, 0.5, 1.0))
    return Soak(
        tick_us=(medians_us[0], medians_us[1]),
        python_kB=(held[0, 0], held[-1, 0]),
        process_MB=(held[0, 1], held[-1, 1]),
        ruptures=times.ruptures,
        skipped=times.rejected,
    )


def soak_table(soak: Soak, ticks: int) -> ResultTable:
    """Return start and end, with the targets."""
    tick_us = (f"{value:.1f}" for value in soak.tick_us)
    python_kB = map(round, soak.python_kB)
    ends = (str(soak.ruptures[0]), str(soak.ruptures[-1]))
    return ResultTable(
        title=f"{ticks} ticks of the chain: insertions, rests and cycles on one tare",
        heads=("what", "start", "end", "target", ""),
        align="LrrrL",
        lines=(
            (
                "median tick, us",
                *tick_us,
                f"≤ {SOAK_COST_RATIO:g} x start",
                met_mark(soak.is_quick),
            ),
            (
                "Python's memory, kB",
                *map(str, python_kB),
                f"+ {SOAK_GROWTH_KB:g} at most",
                met_mark(soak.is_lean),
            ),
            (
                "memory of the process, MB",
                *(f"{value:.1f}" for value in soak.process_MB),
                "",
                "",
            ),
            (
                "ruptures an insertion",
                *ends,
                "≥ 1 in all, none skipped",
                met_mark(soak.is_busy),
            ),
        ),
    )


Columns = dict[str, Array]

RATE_HZ = 1000.0
FREE_S = 10.0
"""So long at its start a recording of joint signals is without contact."""
RETURN_S = 20.0
FORCE_NOISE_N = 0.003
POLL_S = 0.05
BYTES_IN_MB = 1e6
MIN_TIMES_REAL = 20.0
"""Times real time, on one core."""
MAX_GROWTH_MB = 20.0
"""From a tenth of the recording to its end; interpreters and allocators breathe."""
MIN_SECONDS = 2.0 * FREE_S


def joint_recording(seconds: float) -> Iterator[Columns]:
    """Yield joint signals of the insertions of a soak, part by part."""
    cycle = Cycle()
    order = [*range(cycle.tare), *cycle.order]
    sent = cycle.signals
    assert sent.dq_rad_s is not None
    columns = {"q_rad": sent.q_rad, "dq_rad_s": sent.dq_rad_s, "tau_Nm": sent.tau_Nm}
    cycle_columns = {name: values[order] for name, values in columns.items()}
    return _repeated(cycle_columns, seconds, cycle.tare)


def needle_recording(seconds: float) -> Iterator[Columns]:
    """Yield depth, speed and force of a needle inserted into gel again and again.

    Every cycle is in fresh tissue, whose surface lies as deep as the needle
    has come before: in the channel of an insertion there is nothing left to rupture.
    """
    run = insert_needle("gel-50-constant", seed=0, rate_hz=RATE_HZ)
    rng = np.random.default_rng(0)
    taring = int(np.searchsorted(run.t_s, run.tare_end_s))
    deepest_m = float(run.depth_m.max())
    way_m = deepest_m + float(run.depth_m[taring] - run.depth_m[-1])
    phase = np.arange(1.0, RETURN_S * RATE_HZ) / (RETURN_S * RATE_HZ) * np.pi
    way = run.depth_m[-1] + 0.5 * way_m * (1.0 - np.cos(phase))
    way_speed = 0.5 * way_m * np.pi / RETURN_S * np.sin(phase)
    cycle = {
        "depth_m": np.concatenate((run.depth_m, way)),
        "speed_m_s": np.concatenate((run.speed_m_s, way_speed)),
        "force_N": np.concatenate((run.force_N, np.zeros(len(way)))),
    }
    for number, columns in enumerate(_repeated(cycle, seconds, taring)):
        columns["depth_m"] += number * deepest_m
        force = columns["force_N"]
        columns["force_N"] = force + FORCE_NOISE_N * rng.normal(size=force.shape)
        yield columns


def _repeated(cycle: Columns, seconds: float, again_from: int) -> Iterator[Columns]:
    """Yield the cycle, and then over and over its rows from `again_from` on."""
    remaining = round(seconds * RATE_HZ)
    written = 0
    start = 0
    while remaining > 0:
        columns = {
            name: values[start : start + remaining].copy()
            for name, values in cycle.items()
        }
        rows = len(next(iter(columns.values())))
        yield {"t_s": np.arange(written, written + rows) / RATE_HZ, **columns}
        remaining = remaining - rows
        written = written + rows
        start = again_from


RECORDINGS: Mapping[str, Callable[[float], Iterator[Columns]]] = {
    "residual": joint_recording,
    "identification": needle_recording,
}
"""What is sent through a command, by its name."""


class ProcessUse(NamedTuple):
    """What a process needed.

    Attributes:
        wall_s: From start to end.
        cpu_s: Time on processors.
        memory_MB: Resident memory as it went on, in equal steps of time.
    """

    wall_s: float
    cpu_s: float
    memory_MB: tuple[float, ...]

    def memory_at(self, fraction: float) -> float:
        """Return resident memory when that fraction of the time had passed [MB].

        It is nan if unknown.
        """
        if not self.memory_MB:
            return float("nan")
        return self.memory_MB[
            min(int(fraction * len(self.memory_MB)), len(self.memory_MB) - 1)
        ]


def run_python(
    arguments: Sequence[str], progress: Callable[[float], None] = lambda seconds: None
) -> ProcessUse:
    """Run ``python`` with these arguments to its end, watching time and memory.

    Raises:
        BenchmarkError: It failed.
    """
    # One thread of linear algebra: what is measured is one core.
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    start_s = time.perf_counter()
    times_before = psutil.Process().cpu_times()
    memory_MB: list[float] = []
    # A file, not a pipe: that would be full after 64 kB, and the process would wait for
    # ever.
    with TemporaryFile() as errors:
        command = [sys.executable, *arguments]
        process = psutil.Popen(
            command, env=environment, stdout=subprocess.DEVNULL, stderr=errors
        )
        while process.poll() is None:
            with suppress(psutil.Error):  # it may have ended since the question
                memory_MB.append(process.memory_info().rss / BYTES_IN_MB)
            progress(time.perf_counter() - start_s)
            time.sleep(POLL_S)
        wall_s = time.perf_counter() - start_s
        errors.seek(0)
        said = errors.read().decode(errors="replace").strip()
    if process.returncode != 0:
        raise BenchmarkError(
            f"python {' '.join(arguments)} failed: {said.splitlines()[-1:]}",
            RUN_ALONE,
        )
    # Time of all children that have ended: nothing else is started meanwhile.
    times = (times_before, psutil.Process().cpu_times())
    before_s, after_s = (cpu.children_user + cpu.children_system for cpu in times)
    return ProcessUse(wall_s, after_s - before_s, tuple(memory_MB))


class StreamSpeed(NamedTuple):
    """What a command needed for a recording.

    Attributes:
        command: ``residual`` or ``identification``.
        suffix: Of the recording; results are written as CSV.
        seconds: Length of the recording.
        rows: Of the recording.
        use: What the process needed.
    """

    command: str
    suffix: str
    seconds: float
    rows: int
    use: ProcessUse

    @property
    def times_real(self) -> float:
        """Length of the recording over time on the processor."""
        return self.seconds / self.use.cpu_s

    @property
    def is_met(self) -> bool:
        """Whether both targets are; unknown memory counts as a miss."""
        growth_MB = self.use.memory_at(1.0) - self.use.memory_at(0.1)
        return self.times_real >= MIN_TIMES_REAL and growth_MB <= MAX_GROWTH_MB


def measure_stream(
    command: str,
    suffix: str,
    seconds: float,
    folder: Path | None,
    progress: Callable[[float], None],
) -> StreamSpeed:
    """Make a recording of at least `MIN_SECONDS` and send it through a command.

    Raises:
        BenchmarkError: The files cannot be written, or the command failed.
    """
    options = ["--tare", f"0:{FREE_S:g}"] if command == "residual" else []
    expected_s = seconds / MIN_TIMES_REAL
    rows = 0
    try:
        with TemporaryDirectory(dir=folder) as place:
            log = Path(place) / f"log{suffix}"
            out = Path(place) / "out.csv"
            with open_table(log) as table:
                for columns in RECORDINGS[command](seconds):
                    table.append(columns)
                    rows += len(columns["t_s"])
                    progress(0.3 * rows / (seconds * RATE_HZ))
            use = run_python(
                ["-m", command, str(log), *options, "-o", str(out)],
                lambda passed_s: progress(0.3 + 0.7 * min(passed_s / expected_s, 1.0)),
            )
    except (OSError, RecordingError) as error:
        raise BenchmarkError(f"no recording to stream: {error}", RUN_ALONE) from error
    return StreamSpeed(command, suffix, seconds, rows, use)


def stream_table(speeds: Sequence[StreamSpeed]) -> ResultTable:
    """Time and memory of every case, with the targets."""
    lines = []
    for speed in speeds:
        use = speed.use
        memory = (
            use.memory_at(0.1),
            use.memory_at(1.0),
            max(use.memory_MB, default=math.nan),
        )
        costs = (
            1e6 * use.cpu_s / speed.rows,
            speed.times_real,
            speed.seconds / use.wall_s,
        )
        numbers = (
            *(f"{value:.1f}" for value in costs),
            *(f"{value:.0f}" for value in memory),
        )
        mark = met_mark(speed.is_met)
        lines.append((speed.command, speed.suffix, str(speed.rows), *numbers, mark))
    return ResultTable(
        title=f"A recording of {speeds[0].seconds:g} s at 1 kHz through the commands, "
        "CSV out",
        caption="x real: seconds of the recording per second of one core; x wall: per "
        "second by the clock. MB: memory after a tenth, at the end, at most.",
        target_caption=f"Targets: {MIN_TIMES_REAL:g} x real; memory grows by "
        f"{MAX_GROWTH_MB:g} MB at most.",
        heads=(
            *("command", "log", "rows", "us per row", "x real", "x wall"),
            *("MB 10 %", "MB end", "MB most", "target"),
        ),
        align="LL" + 7 * "r" + "L",
        lines=tuple(lines),
    )
