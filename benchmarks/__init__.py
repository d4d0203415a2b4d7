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

from foundation.errors import ErrorCode, NeedleforceError


class BenchmarkCode(ErrorCode):
    """Kinds of errors of the benchmarks; the advice is the command's own."""

    OPTION = (
        "NF-BENCHMARK-OPTION",
        "An option of the benchmarks cannot be, or contradicts another.",
        "Give what the message expects; --help says what each option means",
    )
    NAME = (
        "NF-BENCHMARK-NAME",
        "There is no benchmark, plant or perturbation of that name.",
        "Give one of the names that the message lists; python -m benchmarks list has "
        "them all",
    )
    DATA = (
        "NF-BENCHMARK-DATA",
        "A recording that a benchmark needs is missing or is not what it should be.",
        "Give the folder of the recordings with --data DIR or in NEEDLEFORCE_DATA",
    )
    RESULTS = (
        "NF-BENCHMARK-RESULTS",
        "A file of results cannot be read, written or compared.",
        "Give a file that run --json wrote, or a place that can be written to",
    )
    HEADLINE = (
        "NF-BENCHMARK-HEADLINE",
        "The file of headline figures cannot be read.",
        "Write it anew: python -m benchmarks headline --write",
    )
    RESUME = (
        "NF-BENCHMARK-RESUME",
        "The file to go on with holds a run that is not asked for.",
        "Ask for that run too, or write to another file",
    )
    METRIC = (
        "NF-BENCHMARK-METRIC",
        "A benchmark has measured a number that is not among the metrics.",
        "Add it to benchmarks/judged.toml",
    )
    RUN = (
        "NF-BENCHMARK-RUN",
        "A benchmark could not be run to its end.",
        "Read what stands above, and run it alone with --workers 1",
    )
    CLUSTER = (
        "NF-BENCHMARK-CLUSTER",
        "The cluster cannot be reached, or has no workers.",
        "Start a scheduler and workers (dask scheduler; dask worker ADDRESS --nthreads "
        "1), and give --cluster its address",
    )
    LIBRARY = (
        "NF-BENCHMARK-LIBRARY",
        "A library that the benchmark needs is not installed.",
        "Install {package}",
    )


class BenchmarkError(NeedleforceError):
    """Base of all errors of this package."""

    usual_code = BenchmarkCode.OPTION


class UnknownIdError(BenchmarkError, KeyError):
    """A benchmark or a plant of that name does not exist."""

    usual_code = BenchmarkCode.NAME


class DataError(BenchmarkError, ValueError):
    """A recording is missing or is not what it should be."""

    usual_code = BenchmarkCode.DATA


class ResultsError(BenchmarkError, ValueError):
    """A file of results cannot be read, written or compared."""

    usual_code = BenchmarkCode.RESULTS


class UnknownMetricError(BenchmarkError, KeyError):
    """A number was measured that `judged.toml` does not list."""

    usual_code = BenchmarkCode.METRIC
