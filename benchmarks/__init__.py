"""Estimators against ground truth, on simulated insertions and on real recordings.

Reading order: `catalogue` (what can be run), `jobs` (a piece of work and its result),
`results` (rows and their file), `judging` (metrics, what they should be, what has
become worse), `headline` (the figures that may not become worse). Then the rooms:
`insertion` (force and identification against ground truth), `control` (the needle in
closed loop), `anatomy` (CT, registration, paths), `faults` (what broken signals do),
`performance` (what an update costs), `campaign` (who does the jobs, and what is kept of
them), `report` (tables, figures, the page).

Not part of the installed packages: run it from the repository, ``python -m benchmarks
--help``. Every error message is one line for the person at the keyboard.
"""

from foundation.errors import NeedleforceError

RUN_ALONE = "Read what stands above, and run it alone with --workers 1"
START_CLUSTER = (
    "Start a scheduler and workers (dask scheduler; dask worker ADDRESS "
    "--nthreads 1), and give --cluster its address"
)


class BenchmarkError(NeedleforceError):
    """Base of all errors of this package."""


class UnknownIdError(BenchmarkError, KeyError):
    """A benchmark or a plant of that name does not exist."""

    usual_advice = (
        "Give one of the names that the message lists; python -m benchmarks list "
        "has them all"
    )


class DataError(BenchmarkError, ValueError):
    """A recording is missing or is not what it should be."""

    usual_advice = (
        "Give the folder of the recordings with --data DIR or in NEEDLEFORCE_DATA"
    )


class ResultsError(BenchmarkError, ValueError):
    """A file of results cannot be read, written or compared."""

    usual_advice = (
        "Give a file that run --json wrote, or a place that can be written to"
    )


class UnknownMetricError(BenchmarkError, KeyError):
    """A number was measured that `judged.toml` does not list."""

    usual_advice = "Add it to benchmarks/judged.toml"
