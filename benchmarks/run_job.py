"""Does one job; a failure of ours comes back as a line, not as a traceback."""

from benchmarks.catalogue import benchmark
from benchmarks.errors import BenchmarkError
from benchmarks.job import Job, Outcome, Progress
from figures import FiguresError
from groundtruth import GroundTruthError
from recordings import RecordingError
from residual import ResidualError
from urdf import UrdfError

KNOWN = (
    BenchmarkError,
    GroundTruthError,
    ResidualError,
    UrdfError,
    RecordingError,
    FiguresError,
)


def run_job(job: Job, progress: Progress) -> Outcome:
    """Run the job's benchmark.

    Args:
        job: What to do.
        progress: Told the share done.

    Returns:
        Rows, or the reason why there are none. Errors nobody has foreseen are raised.
    """
    try:
        found = benchmark(job.benchmark).run(job, progress)
    except KNOWN as error:
        return Outcome(job=job, failure=f"{type(error).__name__}: {error}")
    rows = tuple(item.row(job.benchmark, job.plant, job.seed) for item in found.measurements)
    return Outcome(job=job, rows=rows, drawings=found.drawings)
