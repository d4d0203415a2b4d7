"""Run many jobs; keep their results on disk, and resume after an interruption.

Whatever the order of arrival, results stand in the order of the jobs: every way to run
the same jobs writes the same bytes.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from time import perf_counter

from benchmarks import ResultsError
from benchmarks.campaign.workers import DIED, Workers, answers
from benchmarks.catalogue import run_job
from benchmarks.jobs import Job, Outcome
from benchmarks.results import find_commit, read_file, write_results

MIN_PAUSE_S = 2.0
PAUSE_RATIO = 50.0
"""Between two writings of the file, and at least so many times as long as one takes: of
a long campaign it is hundreds of megabytes."""


def run_jobs(
    jobs: Sequence[Job],
    workers: Workers,
    on_progress: Callable[[int, float], None],
    results: Path | None = None,
    *,
    is_resumed: bool = False,
) -> list[Outcome]:
    """Do all jobs and return their outcomes in the order of the jobs.

    Args:
        jobs: Each once.
        workers: Who does them.
        on_progress: Takes the index of a job and the fraction of it that is done, as
            jobs end, of a serial run also meanwhile.
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
    outcomes = _earlier(results, order) if results is not None and is_resumed else {}
    remaining = [job for job in jobs if order[job] not in outcomes]
    for index in outcomes:
        on_progress(index, 1.0)

    def work(job: Job) -> Outcome:
        return run_job(job, partial(on_progress, order[job]))

    with _kept(results, outcomes) as keep:
        answered = answers(
            work if workers.is_serial(len(remaining)) else run_job, remaining, workers
        )
        for number, outcome in answered:
            index = order[remaining[number]]
            outcomes[index] = outcome or Outcome(job=remaining[number], failure=DIED)
            on_progress(index, 1.0)
            keep()
    return [outcomes[index] for index in range(len(jobs))]


def _earlier(path: Path, order: dict[Job, int]) -> dict[int, Outcome]:
    """Return what an interrupted run has left, by the index of the job.

    A run that draws, or that has not the number of rows which it gave, is not in it.
    """
    if not path.exists():
        return {}
    earlier_rows, file = read_file(path)
    named = {(job.scenario, job.plant, job.seed): job for job in order}
    rows: dict[Job, list] = {}
    for row in earlier_rows:
        job = named.get((row.scenario, row.plant, row.seed))
        if job is None:
            raise ResultsError(
                f"{path} has a run that is not asked for: {row.scenario}, {row.plant}, "
                f"seed {row.seed}",
                "Ask for that run too, or write to another file",
            )
        rows.setdefault(job, []).append(row)
    return {
        order[job]: Outcome(job=job, rows=tuple(run_rows))
        for job, run_rows in rows.items()
        if job.drawings is None and file.runs.get(str(job)) == len(run_rows)
    }


@contextmanager
def _kept(
    path: Path | None, outcomes: dict[int, Outcome]
) -> Iterator[Callable[[], None]]:
    """Yield what writes all results if that is due.

    At the end they are written anyway.
    """
    if path is None:
        yield lambda: None
        return
    due_s = perf_counter() + MIN_PAUSE_S
    commit = find_commit()

    def write() -> None:
        nonlocal due_s
        begun_s = perf_counter()
        finished = [
            outcomes[index] for index in sorted(outcomes) if outcomes[index].rows
        ]
        runs = {str(outcome.job): len(outcome.rows) for outcome in finished}
        rows = (row for outcome in finished for row in outcome.rows)
        write_results(path, rows, runs, commit)
        pause_s = PAUSE_RATIO * (perf_counter() - begun_s)
        due_s = perf_counter() + max(MIN_PAUSE_S, pause_s)

    count_at_start = len(outcomes)
    try:
        yield lambda: write() if perf_counter() >= due_s else None
    finally:
        # An interruption before the first answer leaves an older file as it was.
        if len(outcomes) > count_at_start or not path.exists():
            write()
