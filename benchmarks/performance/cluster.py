"""The same jobs on one Dask worker, then on two."""

from collections.abc import Iterator
from importlib import import_module
from time import perf_counter
from typing import Any

from benchmarks import BenchmarkError
from benchmarks.campaign.workers import Workers, answers
from benchmarks.jobs import Job, Progress
from benchmarks.results import Figure
from groundtruth import insert_needle
from identification import Identifier

SEEDS = range(8)
"""One insertion each."""

RATE_HZ = 100.0
"""Samples of an insertion: a job takes some seconds."""


def count_layers(seed: int) -> int:
    """Return how many layers are found in an insertion into a gel."""
    run = insert_needle("gel-25-constant", seed=seed, rate_hz=RATE_HZ)
    identifier = Identifier()
    rows = zip(
        run.depth_m.tolist(), run.speed_m_s.tolist(), run.force_N.tolist(), strict=True
    )
    for depth_m, speed_m_s, force_N in rows:
        identifier.update(depth_m, speed_m_s, force_N, 1.0 / RATE_HZ)
    return len(identifier.layers)


def run(job: Job, progress: Progress) -> Iterator[Figure]:
    """Time the jobs on one worker and on two, each a process with one thread.

    Raises:
        BenchmarkError: Two workers answer otherwise than one.
    """
    # Loaded here: the package is an extra, without types.
    distributed: Any = import_module("distributed")
    taken_s: list[float] = []
    found: list[dict[int, int | None]] = []
    for count in (1, 2):
        with (
            distributed.LocalCluster(
                count, threads_per_worker=1, host="127.0.0.1", dashboard_address=None
            ) as local,
            distributed.Client(local, set_as_default=False) as client,
        ):
            client.run(count_layers, 0)  # every worker has its code compiled
            begin_s = perf_counter()
            workers = Workers(cluster=local.scheduler_address)
            found.append(dict(answers(count_layers, SEEDS, workers)))
            taken_s.append(perf_counter() - begin_s)
        progress(0.5 * count)
    if found[0] != found[1]:
        raise BenchmarkError(f"two workers answer {found[1]}, one {found[0]}")
    yield Figure("cluster_one_worker_s", taken_s[0])
    yield Figure("cluster_two_workers_s", taken_s[1])
    yield Figure("cluster_speedup", taken_s[0] / taken_s[1])
