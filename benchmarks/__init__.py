"""Estimators against ground truth, on simulated insertions and on real recordings.

Reading order: `catalogue` (what can be run), `jobs` (a piece of work and its result),
`results` (rows, metrics, their file), `targets` (what the numbers should be). Then the
rooms: `insertion` (force and identification against ground truth), `control` (the
needle in closed loop), `anatomy` (CT, registration, paths), `faults` (what broken
signals do), `performance` (what an update costs), `campaign` (who does the jobs, and
what is kept of them), `report` (tables, figures, the page).

Not part of the installed packages: run it from the repository, ``python -m benchmarks
--help``. Every error message is one line for the person at the keyboard.
"""


class BenchmarkError(Exception):
    """Base of all errors of this package."""

    def __str__(self) -> str:
        """The message itself; a KeyError would put it in quotes."""
        return str(self.args[0]) if self.args else ""


class UnknownIdError(BenchmarkError, KeyError):
    """A benchmark or a plant of that name does not exist."""


class DataError(BenchmarkError, ValueError):
    """A recording is missing or is not what it should be."""


class ResultsError(BenchmarkError, ValueError):
    """A file of results cannot be read, written or compared."""


class UnknownMetricError(BenchmarkError, KeyError):
    """A number was measured that `metrics.csv` does not list."""
