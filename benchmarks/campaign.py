"""Run many jobs on this machine or a cluster; their numbers are one Parquet file.

The columns of a file, and of every frame of results, are `judging.COLUMNS`; the file
also names the commit of the code (``frame.attrs``).
"""

import subprocess
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from traceback import format_exc
from typing import Any, NamedTuple

import pandas as pd
from joblib import Parallel, delayed, parallel_config
from rich.progress import track

from benchmarks import BenchmarkError, ResultsError
from benchmarks.catalogue import BENCHMARKS
from benchmarks.jobs import Job
from benchmarks.judging import COLUMNS, KEYS, METRICS, unit_of
from foundation.errors import NeedleforceError


class JobResult(NamedTuple):
    """What became of a job.

    Attributes:
        job: The job.
        rows: Its numbers, with `COLUMNS`; none where it failed.
        failure: Why it failed; empty where it did not.
    """

    job: Job
    rows: pd.DataFrame
    failure: str = ""


def make_frame(rows: Sequence[tuple] = ()) -> pd.DataFrame:
    """Return rows as a frame with `COLUMNS`."""
    types = {"seed": "int64", "value": "float64"}
    return pd.DataFrame(rows, columns=list(COLUMNS)).astype(types)


def run_job(job: Job) -> JobResult:
    """Do a job; an error does not take hours of other jobs with it."""
    benchmark = BENCHMARKS[job.benchmark]
    rows = []
    try:
        function = getattr(import_module(benchmark.module), benchmark.function)
        for metric, value, source, method in function(job):
            if metric not in METRICS:
                raise BenchmarkError(f"judged.toml has no metric {metric!r}")
            row = (job.scenario, job.plant, job.seed, source, method, metric)
            rows.append((*row, float(value), unit_of(metric)))
    except NeedleforceError as error:
        return JobResult(job, make_frame(), f"{type(error).__name__}: {error}")
    except Exception:
        return JobResult(job, make_frame(), format_exc())
    return JobResult(job, make_frame(rows))


@contextmanager
def open_workers(workers: int, cluster: str) -> Iterator[None]:
    """Let joblib use processes here, or the workers of a Dask scheduler.

    Raises:
        BenchmarkError: The scheduler cannot be reached.
    """
    if not cluster:
        # Matrices are 7 by 7: more threads than processes only get in each other's way.
        with parallel_config("loky", n_jobs=workers, inner_max_num_threads=1):
            yield
        return
    from distributed import Client

    try:
        client = Client(cluster, timeout=10.0)
    except OSError as error:
        raise BenchmarkError(f"no Dask scheduler at {cluster}: {error}") from error
    with client, parallel_config("dask"):
        yield


def run_jobs(
    jobs: Sequence[Job],
    out: Path | None = None,
    *,
    resume: bool = False,
    workers: int = -1,
    cluster: str = "",
) -> tuple[pd.DataFrame, list[JobResult]]:
    """Do all jobs; return their numbers, and the jobs that failed.

    Args:
        jobs: Each once.
        out: File that the numbers are written to, as they come, and at the end or when
            the run is interrupted.
        resume: Whether jobs whose numbers stand there are not done again.
        workers: Processes; -1 for one per processor, 1 for this one.
        cluster: Instead of them, the address of a Dask scheduler.

    Raises:
        ResultsError: The file cannot be read or written.
        BenchmarkError: The cluster cannot be reached.
    """
    if out is not None and not out.parent.is_dir():
        raise ResultsError(f"cannot write {out}: its folder does not exist")
    frames = [make_frame()]
    if resume and out is not None and out.exists():
        frames = [read_results(out)]
    done = set(frames[0].groupby(["scenario", "plant", "seed"]).groups)
    remaining = [job for job in jobs if (job.scenario, job.plant, job.seed) not in done]
    failed: list[JobResult] = []
    pause_s = 20.0  # between two writings
    written_s = time.monotonic()
    with open_workers(workers, cluster):
        parallel: Any = Parallel(return_as="generator_unordered")
        try:
            results = parallel(delayed(run_job)(job) for job in remaining)
            for result in track(results, f"{len(jobs)} jobs", len(remaining)):
                frames.append(result.rows)
                if result.failure:
                    failed.append(result)
                if out is not None and time.monotonic() > written_s + pause_s:
                    write_results(out, frames)
                    written_s = time.monotonic()
        finally:
            if out is not None:
                write_results(out, frames)
    return join_frames(frames), failed


def join_frames(frames: Sequence[pd.DataFrame]) -> pd.DataFrame:
    """Return all rows, in an order that does not depend on who was first."""
    filled = [frame for frame in frames if len(frame)] or [make_frame()]
    return pd.concat(filled).sort_values(KEYS, ignore_index=True)


def write_results(path: Path, frames: Sequence[pd.DataFrame]) -> None:
    """Write numbers to a file, whole or not at all.

    Raises:
        ResultsError: It cannot be written.
    """
    joined = join_frames(frames)
    joined.attrs["commit"] = find_commit()
    part = path.with_name(f"{path.name}.part")
    try:
        joined.to_parquet(part, index=False)
        part.replace(path)
    except OSError as error:
        raise ResultsError(f"cannot write {path}: {error}") from error


def read_results(path: Path) -> pd.DataFrame:
    """Read a file of results.

    Raises:
        ResultsError: It cannot be read, or is no file of results.
    """
    try:
        frame = pd.read_parquet(path)
    except (OSError, ValueError) as error:
        raise ResultsError(f"cannot read results from {path}: {error}") from error
    if tuple(frame.columns) != COLUMNS:
        raise ResultsError(f"{path} has the columns {list(frame)}, expected {COLUMNS}")
    return frame


def read_merged(paths: Sequence[Path]) -> pd.DataFrame:
    """Read several files; a later one replaces the same scenario on the same plant."""
    frames = [read_results(path).assign(file=k) for k, path in enumerate(paths)]
    joined = pd.concat(frames, ignore_index=True)
    latest = joined.groupby(["scenario", "plant"])["file"].transform("max")
    return joined[joined["file"] == latest].drop(columns="file")


def find_commit() -> str:
    """Return the commit of this project, empty where it is no clone.

    Of a clone in which files are changed it ends with ``-dirty``.
    """
    command = ["git", "describe", "--always", "--dirty", "--abbrev=8"]
    try:
        answer = subprocess.run(
            command,
            cwd=Path(__file__).resolve().parents[1],
            capture_output=True,
            text=True,
            check=True,
        )
    except (OSError, subprocess.CalledProcessError):
        return ""
    return answer.stdout.strip()
