"""The needle moved in closed loop: every part of the study, a benchmark each.

A part is a module of this package with `CASES`, names of its cases, and
``measure(case, plant, seed)``, which yields the numbers of one run of some seconds.
Targets are judged on the plant ``clean``; ``fri`` stands beside it.
"""

from collections.abc import Sequence
from functools import partial
from importlib import import_module
from typing import Any

from benchmarks.jobs import Benchmark, Job, JobResult, Progress
from groundtruth import PLANT_MODELS

GROUP = "control"
FIRST_SEED = 1000
"""Controllers are tuned on seeds below."""
TITLES = {
    "priority": "strict priority of tasks and hard limits, random and hostile input",
    "limits": "commands within the limits of five arms, a minute about an entry",
    "constraints": "remote centre, fixture and turn about the tip, true positions",
    "guidance": "hands on hub, wrist and elbow lead the arm",
    "teleoperation": "a hand drives the needle over a delay",
    "autonomous": "the needle by itself: ruptures, bone, side forces, lost signals",
    "pulls": "forces that no tissue makes: steps, drifts, pushes at the hub",
    "faults": "faults of sensors, clocks and devices while the needle moves",
}
"""Of the parts."""


def import_part(part: str) -> Any:
    """Import the module of a part, which may need packages that others do not."""
    return import_module(f"{__package__}.{part}")


def find_cases(part: str) -> Sequence[str]:
    """Return the names of the cases of a part."""
    return import_part(part).CASES


def run_part(job: Job, progress: Progress) -> JobResult:
    """Measure one case on one plant with one seed."""
    module = import_part(job.benchmark.removeprefix(f"{GROUP}-"))
    measurements = list(module.measure(job.case, job.plant, job.seed))
    progress(1.0)
    return JobResult(measurements)


WITHOUT_PLANT = ("priority", "limits")
"""Parts in which no plant plays a part: the controller's arithmetic alone."""

CONTROL = tuple(
    Benchmark(
        id=f"{GROUP}-{part}",
        title=title,
        run=run_part,
        find_cases=partial(find_cases, part),
        first_seed=FIRST_SEED,
        group=GROUP,
        is_default=False,
        plants=("clean",) if part in WITHOUT_PLANT else ("clean", "fri"),
        possible=("clean",) if part in WITHOUT_PLANT else tuple(PLANT_MODELS),
    )
    for part, title in TITLES.items()
)
