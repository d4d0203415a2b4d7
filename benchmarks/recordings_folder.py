"""Where a job finds real recordings."""

from pathlib import Path

from benchmarks.errors import DataError
from benchmarks.job import Job


def recordings_folder(job: Job) -> Path:
    """The job's folder of recordings.

    Raises:
        DataError: It has none.
    """
    if job.data is None:
        raise DataError(f"{job.benchmark} needs recordings: give --data DIR")
    return job.data
