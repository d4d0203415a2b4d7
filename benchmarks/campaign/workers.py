"""Jobs on the processes of this machine or on a Dask cluster; answers as they come.

A process that dies takes none of the others with it: the jobs it may have held are done
once more.
"""

import os
import signal
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    CancelledError,
    Future,
    ProcessPoolExecutor,
    wait,
)
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import active_children, get_context
from typing import Annotated, TypeVar

from cyclopts import Parameter
from cyclopts.validators import Number

from benchmarks import START_CLUSTER, BenchmarkError

THREAD_SETTINGS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
AHEAD = 2
"""Jobs handed out at a time, per process: none waits for the one that hands out."""
CONNECT_S = 10.0
RESTART_S = 120.0
"""For which a worker is waited for where a job may have ended the last one: on a busy
machine it takes some 10 s to start another."""
DIED = "its process died, twice"
"""What became of a job without an answer."""
Work = TypeVar("Work")
Answer = TypeVar("Answer")


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class Workers:
    """Who does the jobs.

    Attributes:
        workers: Processes at a time; default: one per processor.
        cluster: Instead, address of a Dask scheduler whose workers do the jobs.
    """

    workers: Annotated[int | None, Parameter(validator=Number(gte=1))] = None

    cluster: str = ""

    @property
    def processes(self) -> int:
        """On this machine."""
        if self.workers is not None:
            return self.workers
        if hasattr(os, "sched_getaffinity"):
            return len(os.sched_getaffinity(0))
        return os.cpu_count() or 1

    def is_serial(self, jobs: int) -> bool:
        """Whether so many jobs are done in this process."""
        return not self.cluster and min(self.processes, jobs) <= 1


def answers(
    work: Callable[[Work], Answer], jobs: Sequence[Work], workers: Workers
) -> Iterator[tuple[int, Answer | None]]:
    """Do all jobs; yield the index of each with its answer.

    The answer is None if the job's process died twice.

    Args:
        work: Does a job; but for a serial run, a function of a module.
        jobs: What can be pickled, like the answers.
        workers: Who does them.

    Raises:
        BenchmarkError: The cluster cannot be reached, has no workers, or is lost.
    """
    if workers.is_serial(len(jobs)):
        return ((index, work(job)) for index, job in enumerate(jobs))
    if workers.cluster:
        return _on_cluster(work, jobs, workers.cluster)
    return _on_processes(work, jobs, min(workers.processes, len(jobs)))


@contextmanager
def _pool(processes: int) -> Iterator[ProcessPoolExecutor]:
    """Open a pool of processes with one thread each."""
    # Matrices are 7 by 7: more threads than processes only get in each other's way.
    single = {name: "1" for name in THREAD_SETTINGS if name not in os.environ}
    os.environ.update(single)
    # Ctrl-C reaches the whole group: workers end without a traceback each, the parent
    # reports.
    ended = (signal.SIGINT, signal.SIG_DFL)
    context = get_context("spawn")
    pool = ProcessPoolExecutor(
        processes, context, initializer=signal.signal, initargs=ended
    )
    try:
        yield pool
    except BaseException:
        for process in active_children():  # nobody waits for what they are at
            process.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)
        for name in single:
            os.environ.pop(name, None)


def _on_processes(
    work: Callable[[Work], Answer], jobs: Sequence[Work], processes: int
) -> Iterator[tuple[int, Answer | None]]:
    """Do all jobs on processes of this machine."""
    waiting = deque(range(len(jobs)))
    while waiting:
        running = dict[Future[Answer], int]()
        lost = list[int]()
        with _pool(processes) as pool:
            while running or (waiting and not lost):
                while waiting and not lost and len(running) < AHEAD * processes:
                    index = waiting.popleft()
                    try:
                        running[pool.submit(work, jobs[index])] = index
                    except BrokenProcessPool:
                        lost.append(index)
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    index = running.pop(future)
                    if isinstance(future.exception(), BrokenProcessPool):
                        lost.append(index)
                    else:
                        yield index, future.result()
        # Each by itself: it is not known which of them the process died of.
        yield from ((index, _alone(work, jobs[index])) for index in lost)


def _alone(work: Callable[[Work], Answer], job: Work) -> Answer | None:
    """Do a job in a process of its own; return None if that dies."""
    with _pool(1) as pool, suppress(BrokenProcessPool):
        return pool.submit(work, job).result()


def _on_cluster(
    work: Callable[[Work], Answer], jobs: Sequence[Work], address: str
) -> Iterator[tuple[int, Answer | None]]:
    """Do all jobs on a Dask cluster."""
    from distributed import Client, KilledWorker, as_completed

    try:
        client = Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise BenchmarkError(
            f"no Dask scheduler at {address}: {error}", START_CLUSTER
        ) from error
    with client:
        try:
            client.wait_for_workers(1, timeout=CONNECT_S)
        except TimeoutError as error:
            raise BenchmarkError(f"{address} has no workers", START_CLUSTER) from error
        futures = client.map(work, jobs, pure=False)
        order = {future.key: index for index, future in enumerate(futures)}
        coming = as_completed(futures, loop=client.loop)
        del futures  # so that the cluster forgets each answer once it has come
        lost = list[int]()

        def alone(index: int) -> Answer | None:
            client.wait_for_workers(1, timeout=RESTART_S)
            future = client.submit(work, jobs[index], pure=False)
            while not future.done():
                # A job may take long, but not for ever where no worker comes back.
                client.wait_for_workers(1, timeout=RESTART_S)
                with suppress(TimeoutError, KilledWorker):
                    future.result(timeout=RESTART_S)
            with suppress(KilledWorker):
                return future.result()
            return None

        try:
            for future in coming:
                if isinstance(future.exception(), KilledWorker):
                    lost.append(order[future.key])
                else:
                    yield order[future.key], future.result()
            yield from ((index, alone(index)) for index in lost)
        except (CancelledError, OSError) as error:
            why = (
                f"lost the cluster at {address}; --resume goes on with what was written"
            )
            raise BenchmarkError(why, START_CLUSTER) from error
