"""Estimators against ground truth, on simulated insertions and on real recordings.

Reading order: `catalogue` (what can be run), `jobs` (a piece of work and its numbers),
`campaign` (many jobs, and their file), `judging` (what the numbers should be, and what
has become worse), `headline` (the numbers that may not become worse), `figures` (the
tables of README.md), `report` (the figures of the paper). Then the packages:
`insertion` (force and identification against ground truth), `control` (the needle in
closed loop), `anatomy` (registration, layers along a path), `performance` (what an
update costs).

Not part of the installed packages: run it from the repository, ``python -m benchmarks
--help``.
"""

from foundation.errors import NeedleforceError


class BenchmarkError(NeedleforceError):
    """Base of all errors of this package."""


class DataError(BenchmarkError, ValueError):
    """A recording is missing or is not what it should be."""

    usual_advice = (
        "Give the folder of the recordings with --data DIR or in NEEDLEFORCE_DATA"
    )


class ResultsError(BenchmarkError, ValueError):
    """A file of results cannot be read, written or compared."""
