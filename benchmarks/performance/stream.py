"""Recordings of any length through the commands: time and memory."""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile

import numpy as np
import psutil

from benchmarks import RUN_ALONE, BenchmarkError
from benchmarks.jobs import Job, Progress
from benchmarks.performance.soak import Cycle
from benchmarks.results import Figure
from foundation.arrays import Array
from groundtruth import insert_needle
from needleforce.recordings import RecordingError
from needleforce.recordings.output import open_table

Columns = dict[str, Array]

RATE_HZ = 1000.0
FREE_S = 10.0
"""So long at its start a recording of joint signals is without contact."""
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
    return_s = 20.0
    phase = np.arange(1.0, return_s * RATE_HZ) / (return_s * RATE_HZ) * np.pi
    way = run.depth_m[-1] + 0.5 * way_m * (1.0 - np.cos(phase))
    way_speed = 0.5 * way_m * np.pi / return_s * np.sin(phase)
    cycle = {
        "depth_m": np.concatenate((run.depth_m, way)),
        "speed_m_s": np.concatenate((run.speed_m_s, way_speed)),
        "force_N": np.concatenate((run.force_N, np.zeros(len(way)))),
    }
    for number, columns in enumerate(_repeated(cycle, seconds, taring)):
        columns["depth_m"] += number * deepest_m
        force_N = columns["force_N"]
        columns["force_N"] = force_N + 0.003 * rng.normal(size=force_N.shape)  # noise
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
CASES = tuple(f"60 s {command} .csv" for command in RECORDINGS)


def name_cases(seconds: int, formats: Sequence[str]) -> list[str]:
    """Return the cases of recordings of a length, in formats.

    Raises:
        BenchmarkError: They are too short.
    """
    if seconds < MIN_SECONDS:
        raise BenchmarkError(
            f"--seconds must be at least {MIN_SECONDS:g}: the tare takes half"
        )
    cases = product(RECORDINGS, formats or [".csv"])
    return [f"{seconds} s {command} {suffix}" for command, suffix in cases]


def run_python(
    arguments: Sequence[str], progress: Callable[[float], None]
) -> tuple[float, float, list[float]]:
    """Run ``python`` with these arguments to its end, watching time and memory.

    Returns:
        Time by the clock and on processors [s], and resident memory as it went on, in
        equal steps of time [MB].

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
                memory_MB.append(process.memory_info().rss / 1e6)
            progress(time.perf_counter() - start_s)
            time.sleep(0.05)
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
    return wall_s, after_s - before_s, memory_MB


def run(job: Job, progress: Progress) -> Iterator[Figure]:
    """Make a recording and send it through a command; results are written as CSV.

    The files lie in the folder of data, where one is given.

    Raises:
        BenchmarkError: The files cannot be written, or the command failed.
    """
    length, _, command, suffix = job.case.split()
    seconds = float(length)
    options = ["--tare", f"0:{FREE_S:g}"] if command == "residual" else []
    rows = 0
    try:
        with TemporaryDirectory(dir=job.data) as place:
            log = Path(place) / f"log{suffix}"
            out = Path(place) / "out.csv"
            with open_table(log) as table:
                for columns in RECORDINGS[command](seconds):
                    table.append(columns)
                    rows += len(columns["t_s"])
                    progress(0.3 * rows / (seconds * RATE_HZ))
            use = run_python(
                ["-m", command, str(log), *options, "-o", str(out)],
                # It should take a twentieth of the recording's length.
                lambda passed_s: progress(
                    0.3 + 0.7 * min(passed_s / (seconds / 20.0), 1.0)
                ),
            )
    except (OSError, RecordingError) as error:
        raise BenchmarkError(f"no recording to stream: {error}", RUN_ALONE) from error
    yield from describe(seconds, rows, *use)


def describe(
    seconds: float, rows: int, wall_s: float, cpu_s: float, memory_MB: Sequence[float]
) -> Iterator[Figure]:
    """Yield what a command needed for a recording; unknown memory is nan.

    Args:
        seconds: Length of the recording.
        rows: Of the recording.
        wall_s: Time by the clock.
        cpu_s: Time on processors.
        memory_MB: Resident memory as it went on.
    """
    known_MB = memory_MB or [np.nan]
    tenth_MB = known_MB[len(known_MB) // 10]
    yield Figure("stream_rows", rows)
    yield Figure("stream_row_us", 1e6 * cpu_s / rows)
    yield Figure("stream_times_real", seconds / cpu_s)
    yield Figure("stream_times_wall", seconds / wall_s)
    yield Figure("stream_tenth_MB", tenth_MB)
    yield Figure("stream_end_MB", known_MB[-1])
    yield Figure("stream_growth_MB", known_MB[-1] - tenth_MB)
    yield Figure("stream_most_MB", max(known_MB))
