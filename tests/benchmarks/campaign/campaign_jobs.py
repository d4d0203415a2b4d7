"""Work for processes that may be killed."""

import os
import signal
import time
from pathlib import Path

import numpy as np


def square(job):
    """Of the number in a job; the process of one that names a file dies until the
    file is there."""
    number, mark = job
    if mark is not None and not Path(mark).exists():
        Path(mark).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return number**2


def squares(folder):
    """Ten jobs: of the third the process dies once, of the sixth always; and their
    answers."""
    marks = {2: str(folder / "once"), 5: str(folder / "no" / "such" / "folder")}
    return [(number, marks.get(number)) for number in range(10)]


def fatal(job):
    """As `square`; a process in whose job the mark cannot be made dies as well."""
    try:
        return square(job)
    except FileNotFoundError:
        os.kill(os.getpid(), signal.SIGKILL)


ANSWERS = {number: None if number == 5 else number**2 for number in range(10)}
"""Of `fatal`."""


def quick_job(job, progress=None):
    """Instead of `run_job`: a number of the seed; after ten it waits while HOLD
    exists."""
    from benchmarks.jobs import Outcome
    from benchmarks.results import Figure

    while job.seed >= 10 and os.path.exists(os.environ.get("HOLD", "")):
        time.sleep(0.02)
    value = float(np.random.default_rng(job.seed).normal())
    row = Figure("wrench_rmse_N", value)
    return Outcome(job=job, rows=(row.row(job.benchmark, job.plant, job.seed),))
