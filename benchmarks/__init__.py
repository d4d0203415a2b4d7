"""Estimators against ground truth, on simulated insertions and on real recordings.

Reading order: `runner` (what can be run), `benchmark` (a job and what it finds), `rows`
(one number of the results, every metric). Then in the order in which numbers come
about: `signals` (what estimators get, and the ground truth), `methods` (estimators on a
signal, errors of a force), `identification_metrics` and `bounds` (how good they are,
how good they could be), put together in `simulated`, `robustness` (in the worlds of
`perturbations`) and `recorded`; `targets` and `tables` (what the numbers should be, and
how they are shown); `campaign` with `campaign_workers` (who does the jobs, and what is
kept of them) and `campaign_intervals`. Apart from these: `speed` and `long_runs` (what
an update costs), `kdl_peer` (beside another library), `faults` and `fault_study` (what
broken signals do), `control_study` (the needle in closed loop).

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
