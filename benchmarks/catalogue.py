"""Every benchmark by name, from a request to jobs, and what becomes of a job."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from traceback import format_exc
from typing import NamedTuple

from benchmarks import BenchmarkError, DataError, UnknownIdError
from benchmarks.anatomy.study import ANATOMY
from benchmarks.control.study import CONTROL
from benchmarks.faults.study import FAULTS
from benchmarks.insertion.perturbations import MIXED, PERTURBATIONS, PERTURBED
from benchmarks.insertion.recorded import bovine, liver, panda, ur10e
from benchmarks.insertion.recorded.bovine import run_bovine_real
from benchmarks.insertion.recorded.liver import run_liver_real
from benchmarks.insertion.recorded.on_arm import run_bovine_on_arm, run_liver_on_arm
from benchmarks.insertion.recorded.panda import run_panda_liver, run_panda_real
from benchmarks.insertion.recorded.ur10e import run_ur10e_payload
from benchmarks.insertion.robustness import SCENARIOS as ROBUST
from benchmarks.insertion.robustness import run_robustness
from benchmarks.insertion.simulated import NEEDLE, run_simulated
from benchmarks.jobs import RECORDING, Benchmark, Job, Outcome, Progress
from benchmarks.report.published_figures import NEEDED
from benchmarks.targets import TISSUE
from groundtruth import PLANT_MODELS, SCENARIOS, GroundTruthError
from groundtruth.scenarios import RANDOM_STACK, RANDOM_TISSUE
from needleforce.plots import FiguresError
from needleforce.recordings import RecordingError
from residual import ResidualError
from urdf import UrdfError

# The two of the published Figure 5, the other speed of each, and the organs: under a
# minute.
QUICK = (
    "gel-25-sinusoidal",
    "gel-70-constant",
    "stack-sinusoidal",
    "stack-glove-constant",
    "liver-constant",
    "abdomen-sinusoidal",
)
PLANTS = (*PLANT_MODELS, NEEDLE)
_SIMULATED = (
    *(
        Benchmark(
            id=item.id,
            title=item.title,
            run=run_simulated,
            is_default=item.id in QUICK,
            possible=PLANTS if item.layers else tuple(PLANT_MODELS),
        )
        for item in SCENARIOS.values()
    ),
    *(
        Benchmark(
            id=name,
            title=f"layers, motion and {drawn} drawn anew for every seed",
            run=run_simulated,
            is_default=False,
            plants=(NEEDLE,),
            possible=PLANTS,
        )
        for name, drawn in (
            (RANDOM_STACK, "speed"),
            (RANDOM_TISSUE, "speed, tissue law"),
        )
    ),
)
_ROBUSTNESS = tuple(
    Benchmark(
        id=PERTURBED + name,
        title=title,
        run=run_robustness,
        is_default=False,
        plants=plants,
        possible=plants,
        group="robustness",
    )
    for name, title, plants in (
        *(
            (name, f"{name} in perturbed worlds", tuple(PERTURBATIONS))
            for name in ROBUST
        ),
        (MIXED, "one of these scenarios, three perturbations at a time", (MIXED,)),
    )
)
_TITLES = {
    "panda-real": "residual of a real Panda in free motion",
    "panda-liver": "real liver force on a Panda's real torques; one insertion per seed",
    "ur10e-payload": "weight of a known payload from the currents of a real UR10e",
    "liver-real": "friction in 19 insertions into liver against the pull-out force",
    "bovine-real": "the ruptures of an insertion into real bovine liver",
}
_RECORDED = tuple(
    Benchmark(id=name, title=_TITLES[name], run=run, needs=folders, recordings=count)
    for name, run, folders, count in (
        ("panda-real", run_panda_real, (panda.FOLDER,), 1),
        (
            "panda-liver",
            run_panda_liver,
            (panda.FOLDER, liver.FOLDER),
            len(liver.NUMBERS),
        ),
        ("ur10e-payload", run_ur10e_payload, (ur10e.FOLDER,), 1),
        ("liver-real", run_liver_real, (liver.FOLDER,), 1),
        ("bovine-real", run_bovine_real, (bovine.FOLDER,), 1),
    )
)
_ON_ARM = (
    Benchmark(
        id="liver-on-arm",
        title="recorded liver forces at the tip of the simulated arm; one a seed",
        run=run_liver_on_arm,
        needs=(liver.FOLDER,),
        is_on_arm=True,
        recordings=len(liver.NUMBERS),
        is_default=False,
        plants=("clean", "fri"),
    ),
    Benchmark(
        id="bovine-on-arm",
        title="the recorded bovine liver force at the tip of the simulated arm",
        run=run_bovine_on_arm,
        needs=(bovine.FOLDER,),
        is_on_arm=True,
        is_default=False,
        plants=("clean", "fri"),
    ),
)
BENCHMARKS: Mapping[str, Benchmark] = {
    item.id: item
    for item in (
        *_SIMULATED,
        *_ROBUSTNESS,
        *_RECORDED,
        *_ON_ARM,
        *CONTROL,
        *ANATOMY,
        *FAULTS,
    )
}
"""By name."""


ALL = "all"
"""Names all benchmarks that belong to no group."""
STUDIES = ("control", "anatomy")
"""Groups of which a part may be named, as control-priority."""
IDS: Mapping[str, Sequence[str]] = {
    "tissue": TISSUE,
    "robustness": tuple(PERTURBED + name for name in ROBUST),
} | {
    group: tuple(item.id for item in BENCHMARKS.values() if item.group == group)
    for group in STUDIES
}
"""Names of several benchmarks."""


def benchmark_named(benchmark_id: str) -> Benchmark:
    """Return the benchmark of that name.

    Raises:
        UnknownIdError: There is none; the message lists the names.
    """
    try:
        return BENCHMARKS[benchmark_id]
    except KeyError:
        names = ", ".join((*BENCHMARKS, *IDS, ALL))
        raise UnknownIdError(
            f"no benchmark {benchmark_id!r}; choose from: {names}"
        ) from None


@dataclass(frozen=True, slots=True)
class Request:
    """What was asked for.

    Attributes:
        ids: Names of benchmarks; none for the quick ones (and, where figures are
            wanted, for what the published figures need), ``all`` for all that belong
            to no group, ``tissue`` for the scenarios with tissue, ``control`` for all
            parts of a study.
        plants: Plant models of simulations, ``needle`` for none; when empty, every
            benchmark runs on its own: the random stack with the needle alone, so that
            hundreds are affordable; for benchmarks in perturbed worlds, names of
            perturbations.
        seeds: How many seeds are run.
        first_seed: The first of them; None for that of the benchmark.
        data: Folder of recordings, if any.
        drawings: Folder for figures, if wanted.
    """

    ids: Sequence[str] = ()
    plants: Sequence[str] = ()
    seeds: int = 1
    first_seed: int | None = None
    data: Path | None = None
    drawings: Path | None = None


class Plan(NamedTuple):
    """What a run does.

    Attributes:
        jobs: In order.
        skipped: Names of benchmarks that are left out for want of recordings.
    """

    jobs: tuple[Job, ...]
    skipped: tuple[str, ...]


def make_plan(request: Request) -> Plan:
    """Turn a request into jobs.

    Raises:
        UnknownIdError: A benchmark or a plant of that name does not exist.
        DataError: The folder of recordings does not exist, or a benchmark that was
            asked for by name needs one, or an arm where only the needle was asked for.
    """
    for plant in request.plants:
        if plant not in (*PLANTS, *PERTURBATIONS, MIXED):
            raise UnknownIdError(
                f"no plant {plant!r}; choose from: {', '.join(PLANTS)}, or, for "
                f"robustness, {', '.join(PERTURBATIONS)}"
            )
    if request.data is not None and not request.data.is_dir():
        raise DataError(f"no folder of recordings at {request.data}")
    jobs: list[Job] = []
    skipped: list[str] = []
    for benchmark in chosen_benchmarks(request):
        missing = describe_missing(benchmark, request)
        if not missing:
            jobs += make_jobs(benchmark, request)
        elif benchmark.id in request.ids:
            raise DataError(f"{benchmark.id} needs {missing}")
        elif benchmark.is_recorded:
            skipped.append(benchmark.id)
    return Plan(jobs=tuple(jobs), skipped=tuple(skipped))


def chosen_benchmarks(request: Request) -> list[Benchmark]:
    """Return the benchmarks that are asked for, in the catalogue's order."""
    ids = [name for asked in request.ids for name in IDS.get(asked, (asked,))]
    for name in ids:
        if name != ALL:
            benchmark_named(name)
    if not ids:
        drawn = NEEDED if request.drawings is not None else ()
        return [
            item for item in BENCHMARKS.values() if item.is_default or item.id in drawn
        ]
    return [
        item
        for item in BENCHMARKS.values()
        if item.id in ids or (ALL in ids and not item.group)
    ]


def describe_missing(benchmark: Benchmark, request: Request) -> str:
    """Return what a benchmark lacks, nothing for one that can run."""
    if not chosen_plants(benchmark, request):
        return f"a plant, one of {', '.join(benchmark.possible)}"
    if not benchmark.is_recorded:
        return ""
    if request.data is None:
        return "recordings"
    absent = [name for name in benchmark.needs if not (request.data / name).is_dir()]
    return f"the folder {', '.join(absent)} in {request.data}" if absent else ""


def chosen_plants(benchmark: Benchmark, request: Request) -> tuple[str, ...]:
    """Return the plants a benchmark runs on, each once.

    There are none when it needs an arm and none was named.
    """
    if benchmark.is_recorded and not benchmark.is_on_arm:
        return (RECORDING,)
    if not benchmark.has_plants:
        return benchmark.plants
    asked = dict.fromkeys(request.plants or benchmark.plants)
    return tuple(plant for plant in asked if plant in benchmark.possible)


def make_jobs(benchmark: Benchmark, request: Request) -> list[Job]:
    """Return a job for every case, plant and seed."""
    first_seed = request.first_seed
    count = request.seeds
    if first_seed is None:
        first_seed = benchmark.first_seed
    if benchmark.is_recorded:
        first_seed = 0
        count = min(benchmark.recordings, request.seeds)
    has_data = benchmark.is_recorded or benchmark.uses_data
    return [
        Job(
            benchmark=benchmark.id,
            case=case,
            plant=plant,
            seed=seed,
            data=request.data if has_data else None,
            # One figure of each kind is enough.
            drawings=request.drawings if seed == first_seed else None,
        )
        for case in benchmark.find_cases()
        for plant in chosen_plants(benchmark, request)
        for seed in range(first_seed, first_seed + count)
    ]


KNOWN = (
    BenchmarkError,
    GroundTruthError,
    ResidualError,
    UrdfError,
    RecordingError,
    FiguresError,
)
"""Errors that come back from a job as one line, not as a traceback."""


def run_job(job: Job, progress: Progress = lambda fraction: None) -> Outcome:
    """Do a job; return its rows, or the reason why there are none.

    The reason of an unforeseen error is its traceback.
    """
    try:
        result = benchmark_named(job.benchmark).run(job, progress)
        rows = tuple(
            item.row(job.scenario, job.plant, job.seed) for item in result.measurements
        )
    except KNOWN as error:
        return Outcome(job=job, failure=f"{type(error).__name__}: {error}")
    except Exception:  # it must not take hours of others with it
        return Outcome(job=job, failure=format_exc())
    return Outcome(job=job, rows=rows, drawings=result.drawings)
