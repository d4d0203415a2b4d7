"""Every benchmark by name, from a request to jobs, and what becomes of a job."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from traceback import format_exc
from typing import NamedTuple

from benchmarks import BenchmarkError, DataError, UnknownIdError
from benchmarks.insertion.perturbations import MIXED, PERTURBATIONS, PERTURBED
from benchmarks.insertion.recorded import bovine, liver, panda, ur10e
from benchmarks.insertion.recorded.bovine import run_bovine_real
from benchmarks.insertion.recorded.liver import run_liver_real
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
)
QUICK += ("liver-constant", "abdomen-sinusoidal")
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
        perturbs=True,
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
    "panda-liver": "real liver force on the real torques of a Panda; one insertion per seed",
    "ur10e-payload": "weight of a known payload from the currents of a real UR10e",
    "liver-real": "friction in 19 insertions into real liver against the pull-out force",
    "bovine-real": "the ruptures of an insertion into real bovine liver",
}
_RECORDED = tuple(
    Benchmark(id=name, title=_TITLES[name], run=run, needs=folders, seeds=seeds)
    for name, run, folders, seeds in (
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
BENCHMARKS: Mapping[str, Benchmark] = {
    item.id: item for item in (*_SIMULATED, *_ROBUSTNESS, *_RECORDED)
}
"""By name."""


def benchmark_named(benchmark_id: str) -> Benchmark:
    """The benchmark of that name.

    Raises:
        UnknownIdError: There is none; the message lists the names.
    """
    try:
        return BENCHMARKS[benchmark_id]
    except KeyError:
        raise UnknownIdError(
            f"no benchmark {benchmark_id!r}; choose from: {', '.join((*BENCHMARKS, *IDS))}, all"
        ) from None


ALL = "all"
IDS = {"tissue": TISSUE, "robustness": tuple(PERTURBED + name for name in ROBUST)}
"""Names of several benchmarks; `ALL` is for all but those in perturbed worlds."""


@dataclass(frozen=True, slots=True)
class Request:
    """What was asked for.

    Attributes:
        ids: Names of benchmarks; none for the quick ones (and, where figures are
            wanted, for what the published figures need), ``all`` for all, ``tissue``
            for the scenarios with tissue.
        plants: Plant models of simulations, ``needle`` for none; when empty, every
            benchmark runs on its own: the random stack with the needle alone, so that
            hundreds are affordable; for benchmarks in perturbed worlds, names of
            perturbations.
        seeds: How many seeds are run.
        first_seed: The first of them.
        data: Folder of recordings, if any.
        drawings: Folder for figures, if wanted.
    """

    ids: Sequence[str] = ()
    plants: Sequence[str] = ()
    seeds: int = 1
    first_seed: int = 0
    data: Path | None = None
    drawings: Path | None = None


class Plan(NamedTuple):
    """Jobs in order, and names of benchmarks that are left out for want of
    recordings.
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
                f"no plant {plant!r}; choose from: {', '.join(PLANTS)}, or, for robustness, "
                f"{', '.join(PERTURBATIONS)}"
            )
    if request.data is not None and not request.data.is_dir():
        raise DataError(f"no folder of recordings at {request.data}")
    jobs: list[Job] = []
    skipped = []
    for item in _chosen(request):
        missing = _missing(item, request)
        if not missing:
            jobs += _jobs(item, request)
        elif item.id in request.ids:
            raise DataError(f"{item.id} needs {missing}")
        elif item.is_recorded:
            skipped.append(item.id)
    return Plan(jobs=tuple(jobs), skipped=tuple(skipped))


def _chosen(request: Request) -> list[Benchmark]:
    """The benchmarks in the catalogue's order, each once."""
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
        if item.id in ids or (ALL in ids and not item.perturbs)
    ]


def _missing(item: Benchmark, request: Request) -> str:
    """What a benchmark lacks, nothing for one that can run."""
    if not item.is_recorded:
        return (
            ""
            if _plants(item, request)
            else f"a plant, one of {', '.join(item.possible)}"
        )
    data = request.data
    if data is None:
        return "recordings: give --data DIR or set NEEDLEFORCE_DATA"
    absent = [name for name in item.needs if not (data / name).is_dir()]
    return f"the folder {', '.join(absent)} in {data}" if absent else ""


def _plants(item: Benchmark, request: Request) -> tuple[str, ...]:
    """The plants a simulation runs on, each once; none when it needs an arm and none
    was named.
    """
    asked = dict.fromkeys(request.plants or item.plants)
    return tuple(plant for plant in asked if plant in item.possible)


def _jobs(item: Benchmark, request: Request) -> list[Job]:
    first = request.first_seed
    seeds = request.seeds
    plants = _plants(item, request)
    if item.is_recorded:
        first = 0
        seeds = min(item.seeds, request.seeds)
        plants = (RECORDING,)
    return [
        Job(
            benchmark=item.id,
            plant=plant,
            seed=seed,
            data=request.data if item.is_recorded else None,
            # One figure of each kind is enough.
            drawings=request.drawings if seed == first else None,
        )
        for plant in plants
        for seed in range(first, first + seeds)
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
    """Rows of a job, or the reason why there are none: of an unforeseen error, where
    it was.
    """
    try:
        found = benchmark_named(job.benchmark).run(job, progress)
    except KNOWN as error:
        return Outcome(job=job, failure=f"{type(error).__name__}: {error}")
    except Exception:  # it must not take hours of others with it
        return Outcome(job=job, failure=format_exc())
    rows = tuple(
        item.row(job.benchmark, job.plant, job.seed) for item in found.measurements
    )
    return Outcome(job=job, rows=rows, drawings=found.drawings)
