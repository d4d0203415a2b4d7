"""A run of many jobs: its results on disk as they come, gone on with after an
interruption.

Whatever the order of arrival, results stand in the order of the jobs: every way to run
the same jobs writes the same bytes.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from time import perf_counter

import msgspec

from benchmarks import ResultsError
from benchmarks.campaign.workers import DIED, Workers, answers
from benchmarks.catalogue import run_job
from benchmarks.jobs import Job, Outcome
from benchmarks.results import read_results, write_results

JobProgress = Callable[[int, float], None]
"""Takes the index of a job and the fraction of it that is done, 0 to 1."""
LEAST_PAUSE_S = 2.0
PAUSE_RATIO = 50.0
"""Between two writings of the file, and at least so many times as long as one takes: of
a long campaign it is hundreds of megabytes."""


def run_jobs(
    jobs: Sequence[Job],
    workers: Workers,
    on_progress: JobProgress,
    results: Path | None = None,
    *,
    is_resumed: bool = False,
) -> list[Outcome]:
    """Do all jobs and return their outcomes in the order of the jobs.

    Args:
        jobs: Each once.
        workers: Who does them.
        on_progress: Is called as jobs end, of a serial run also meanwhile.
        results: Where their rows are written while they come, and at the end, or when
            the run is interrupted; each time whole.
        is_resumed: Whether jobs all of whose rows stand there are not done again.

    Raises:
        ResultsError: The file cannot be read or written, or has rows of other jobs.
        BenchmarkError: The cluster cannot be reached or is lost.
    """
    if results is not None and (results.is_dir() or not results.parent.is_dir()):
        raise ResultsError(
            f"cannot write {results}: not a file in a folder that there is"
        )
    order = {job: index for index, job in enumerate(jobs)}
    found = _earlier(results, order) if results is not None and is_resumed else {}
    left = [job for job in jobs if order[job] not in found]
    for index in found:
        on_progress(index, 1.0)

    def work(job: Job) -> Outcome:
        return run_job(job, partial(on_progress, order[job]))

    with _kept(results, found) as keep:
        done = answers(work if workers.is_serial(len(left)) else run_job, left, workers)
        for number, outcome in done:
            index = order[left[number]]
            found[index] = outcome or Outcome(job=left[number], failure=DIED)
            on_progress(index, 1.0)
            keep()
    return [found[index] for index in range(len(jobs))]


class _Counts(msgspec.Struct):
    """What stands in a file of results beside its rows: how many each run has given."""

    runs: dict[str, int] = {}


def _counts(path: Path) -> dict[str, int]:
    try:
        return msgspec.json.decode(path.read_bytes(), type=_Counts).runs
    except msgspec.ValidationError as error:
        raise ResultsError(f"{path} is not a file of results: {error}") from error


def _earlier(path: Path, order: dict[Job, int]) -> dict[int, Outcome]:
    """What an interrupted run has left, by the index of the job.

    A run that draws, or that has not the number of rows which it gave, is not in it.
    """
    counts = _counts(path) if path.exists() else {}
    named = {(job.scenario, job.plant, job.seed): job for job in order}
    rows: dict[Job, list] = {}
    for row in read_results(path) if path.exists() else ():
        job = named.get((row.scenario, row.plant, row.seed))
        if job is None:
            raise ResultsError(
                f"{path} has a run that is not asked for: {row.scenario}, {row.plant}, seed "
                f"{row.seed}; ask for it too, or write to another file"
            )
        rows.setdefault(job, []).append(row)
    return {
        order[job]: Outcome(job=job, rows=tuple(each))
        for job, each in rows.items()
        if job.drawings is None and counts.get(str(job)) == len(each)
    }


@contextmanager
def _kept(path: Path | None, found: dict[int, Outcome]) -> Iterator[Callable[[], None]]:
    """Yields what writes all that was found if that is due; at the end it is written
    anyway.
    """
    if path is None:
        yield lambda: None
        return
    due_s = perf_counter() + LEAST_PAUSE_S

    def write() -> None:
        nonlocal due_s
        begun_s = perf_counter()
        done = [found[index] for index in sorted(found) if found[index].rows]
        runs = {str(outcome.job): len(outcome.rows) for outcome in done}
        write_results(path, (row for outcome in done for row in outcome.rows), runs)
        pause_s = PAUSE_RATIO * (perf_counter() - begun_s)
        due_s = perf_counter() + max(LEAST_PAUSE_S, pause_s)

    before = len(found)
    try:
        yield lambda: write() if perf_counter() >= due_s else None
    finally:
        # An interruption before the first answer leaves an older file as it was.
        if len(found) > before or not path.exists():
            write()
