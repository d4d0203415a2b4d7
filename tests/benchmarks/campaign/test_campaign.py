"""Runs of many jobs: on processes, on a cluster, killed, interrupted and gone on
with."""

import json
import os
import signal
import threading
import time
from contextlib import contextmanager
from unittest.mock import patch

import numpy as np
import pytest

from benchmarks import catalogue
from benchmarks.campaign import runs, workers
from benchmarks.campaign.workers import Workers, answers
from benchmarks.cli import main
from benchmarks.jobs import Benchmark
from benchmarks.report.tables import interval
from benchmarks.results import Figure, read_results
from tests.benchmarks.campaign.campaign_jobs import ANSWERS, fatal, quick_job, squares


def answered(tmp_path, workers):
    answer_list = list(answers(fatal, squares(tmp_path), workers))
    assert len(answer_list) == len(ANSWERS)
    return dict(answer_list)


@pytest.mark.slow
def test_a_killed_process_takes_no_other_job(tmp_path):
    """The job it died of is done once more."""
    assert answered(tmp_path, Workers(workers=2)) == ANSWERS
    assert Workers(workers=3).processes == 3
    assert Workers().processes >= 1
    assert Workers(workers=2).is_serial(1)
    assert not Workers(workers=1, cluster="tcp://somewhere").is_serial(1)


@contextmanager
def cluster():
    """Address of a scheduler with two workers, each a process; what kills one of
    them."""
    distributed = pytest.importorskip("distributed")
    from dask import config

    with (
        config.set({"distributed.scheduler.allowed-failures": 1}),
        patch.dict(os.environ),  # in which Dask sets numbers of threads for good
        distributed.LocalCluster(
            2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None
        ) as local,
        distributed.Client(local, set_as_default=False) as client,
    ):

        def kill():
            os.kill(min(client.run(os.getpid).values()), signal.SIGKILL)

        yield local.scheduler_address, kill


@pytest.mark.slow
def test_a_killed_cluster_worker_changes_no_byte(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(runs, "run_job", quick_job)
    monkeypatch.setattr(runs, "MIN_PAUSE_S", 0.0)
    monkeypatch.setattr(runs, "PAUSE_RATIO", 0.0)  # every answer is on disk at once
    serial, other = (tmp_path / name for name in ("serial.json", "cluster.json"))
    asked = ["run", "liver-constant", "--seeds", "30", "--json"]

    assert main([*asked, str(serial), "--workers", "1"]) == 0

    hold = tmp_path / "hold"
    hold.touch()
    monkeypatch.setenv("HOLD", str(hold))
    with cluster() as (address, kill):
        assert answered(tmp_path, Workers(cluster=address)) == ANSWERS

        killed = []

        def kill_midway():
            try:
                while not other.exists() or len(read_results(other)) < 5:
                    time.sleep(0.02)
                kill()
                killed.append(30 - len(read_results(other)))
            finally:
                hold.unlink()

        thread = threading.Thread(target=kill_midway)
        thread.start()
        assert main([*asked, str(other), "--cluster", address]) == 0
        thread.join()

    assert killed[0] >= 20
    assert serial.read_bytes() == other.read_bytes()


@pytest.fixture
def jobs_done(monkeypatch):
    """Benchmarks that take no time; the seeds that were done. Seed 3 is interrupted
    once."""
    seeds_done = []

    def pretend(job, progress):
        seeds_done.append(job.seed)
        if job.seed == 3 and seeds_done.count(3) == 1:
            raise KeyboardInterrupt
        if job.seed == 4:
            raise ZeroDivisionError
        return [Figure("wrench_rmse_N", job.seed / 3.0)]

    items = {"liver-constant": Benchmark(id="liver-constant", title="", run=pretend)}
    monkeypatch.setattr(catalogue, "BENCHMARKS", items)
    return seeds_done


@pytest.mark.slow
def test_an_interrupted_run_goes_on_without_repeating(jobs_done, tmp_path, capsys):
    path, whole = (str(tmp_path / name) for name in ("a.json", "b.json"))
    asked = ["run", "--seeds", "6", "--workers", "1", "--json"]

    assert main([*asked, path]) == 130
    assert {row.seed for row in read_results(path)} == {0, 1, 2}
    # What failed in a way nobody foresaw is said with its place, and tried again.
    assert main([*asked, path, "--resume"]) == 1
    assert jobs_done == [0, 1, 2, 3, 3, 4, 5]
    assert "ZeroDivisionError" in capsys.readouterr().out
    assert main([*asked, path, "--resume"]) == 1
    assert jobs_done[7:] == [4]
    assert main([*asked, whole]) == 1
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()

    # More seeds later.
    del jobs_done[:]

    assert (
        main(["run", "--seeds", "8", "--workers", "1", "--json", path, "--resume"]) == 1
    )
    assert jobs_done == [4, 6, 7]

    capsys.readouterr()
    for arguments, message in (
        (["--first-seed", "-1"], "Must be >= 0"),
        (["--resume"], "--resume goes on with the file of --json"),
        (["--seeds", "2", "--json", path, "--resume"], "a run that is not asked for"),
        (
            ["--cluster", "tcp://127.0.0.1:9", "--report", str(tmp_path)],
            "--report draws on this",
        ),
    ):
        assert main(["run", *arguments]) == 2
        assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("changed", "again"),
    [
        ({"rows": slice(0, 3)}, [1, 2]),  # of seed 1 a part, of seed 2 nothing
        ({"rows": slice(1, 6)}, [0]),
        ({"runs": {}}, [0, 1, 2]),
        ({}, []),
    ],
)
def test_a_run_with_missing_rows_is_repeated(
    changed, again, tmp_path, monkeypatch, capsys
):
    seeds_done = []
    names = ("wrench_rmse_N", "rupture_recall")

    def pretend(job, progress):
        seeds_done.append(job.seed)
        return [Figure(name, job.seed) for name in names]

    items = {"liver-constant": Benchmark(id="liver-constant", title="", run=pretend)}
    monkeypatch.setattr(catalogue, "BENCHMARKS", items)
    path = tmp_path / "a.json"
    asked = ["run", "--seeds", "3", "--workers", "1", "--json", str(path)]

    assert main(asked) == 0

    whole = path.read_bytes()
    content = json.loads(path.read_bytes())
    for key, value in changed.items():
        content[key] = content[key][value] if isinstance(value, slice) else value
    path.write_text(json.dumps(content))
    del seeds_done[:]

    assert main([*asked, "--resume"]) == 0
    assert seeds_done == again
    assert json.loads(path.read_bytes()) == json.loads(whole)

    if again:
        assert path.read_bytes() == whole
    path.write_text(json.dumps(content | {"runs": 3}))

    assert main([*asked, "--resume"]) == 2
    assert "is not a file of results" in capsys.readouterr().err


@pytest.mark.slow
def test_an_absent_cluster_is_one_line(jobs_done, monkeypatch, capsys):
    pytest.importorskip("distributed")
    monkeypatch.setattr(workers, "CONNECT_S", 0.5)

    assert main(["run", "--cluster", "tcp://127.0.0.1:9"]) == 2
    assert "error: no Dask scheduler at tcp://127.0.0.1:9" in capsys.readouterr().err


def test_an_interval_covers_the_middle_and_draws_seeds():
    rng = np.random.default_rng(1)
    inside = 0
    for _ in range(200):
        values = rng.normal(size=40)
        low, high = interval(
            values, np.arange(40), np.random.default_rng(0), is_mean=True
        )
        inside += low <= 0.0 <= high

    assert 0.89 <= inside / 200 <= 0.98

    # Runs of one seed that are all alike tell no more than one of them.
    seeds = np.repeat(np.arange(8), 12)
    by_seed = np.repeat(rng.normal(size=8), 12)
    widths = [
        np.ptp(interval(by_seed, seed, np.random.default_rng(0), is_mean=True))
        for seed in (seeds, np.arange(96), seeds % 2)
    ]

    assert widths[0] > 2.0 * widths[1]
    assert widths[1] == widths[2]

    again = interval(by_seed, seeds, np.random.default_rng(0), is_mean=False)

    assert again == interval(by_seed, seeds, np.random.default_rng(0), is_mean=False)

    # A seed that lacks some runs.
    low, high = interval(
        by_seed[5:], seeds[5:], np.random.default_rng(0), is_mean=False
    )

    assert by_seed.min() <= low < high <= by_seed.max()
