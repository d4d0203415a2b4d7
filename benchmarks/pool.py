"""Jobs on several processes."""

import multiprocessing
import os
import signal
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_EXCEPTION, Future, ProcessPoolExecutor, wait
from functools import partial
from typing import Any

from benchmarks.job import Job, Outcome
from benchmarks.run_job import run_job

POLL_s = 0.2
THREAD_SETTINGS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

Shares = Callable[[int, float], None]
"""Takes the index of a job and the share of it that is done, 0 to 1."""

_worker_queue: Any = None


def run_jobs(jobs: Sequence[Job], processes: int, on_progress: Shares) -> list[Outcome]:
    """Do all jobs and return their outcomes in the order of the jobs.

    Args:
        jobs: What to do.
        processes: How many at a time; with one, all is done in this process.
        on_progress: Told now and then how far each job is.
    """
    if processes <= 1 or len(jobs) <= 1:
        return [run_job(job, partial(on_progress, index)) for index, job in enumerate(jobs)]
    # Matrices are 7 by 7: more threads than processes only get in each other's way.
    for name in THREAD_SETTINGS:
        os.environ.setdefault(name, "1")
    context = multiprocessing.get_context("spawn")
    queue = context.SimpleQueue()
    pool = ProcessPoolExecutor(
        max_workers=min(processes, len(jobs)),
        mp_context=context,
        initializer=_attach,
        initargs=(queue,),
    )
    try:
        futures = [pool.submit(_work, index, job) for index, job in enumerate(jobs)]
        _watch(futures, queue, on_progress)
        return [future.result() for future in futures]
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _watch(futures: Sequence[Future[Outcome]], queue: Any, on_progress: Shares) -> None:
    """Pass progress on until all is done or something unforeseen happens."""
    running = set(futures)
    while running:
        done, running = wait(running, timeout=POLL_s, return_when=FIRST_EXCEPTION)
        while not queue.empty():
            on_progress(*queue.get())
        if any(future.exception() for future in done):
            return


def _attach(queue: Any) -> None:
    # Ctrl-C reaches the whole group: end without a traceback each, the parent tells.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    global _worker_queue
    _worker_queue = queue


def _work(index: int, job: Job) -> Outcome:
    def tell(share: float) -> None:
        _worker_queue.put((index, share))

    outcome = run_job(job, tell)
    tell(1.0)
    return outcome
