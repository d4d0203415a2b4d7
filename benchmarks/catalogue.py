"""Every benchmark by name, from a request to jobs, and what becomes of a job."""

import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from traceback import format_exc
from typing import Any, NamedTuple

from benchmarks import BenchmarkError, DataError, UnknownIdError
from benchmarks.insertion.perturbations import MIXED, PERTURBATIONS, PERTURBED
from benchmarks.insertion.robustness import SCENARIOS as ROBUST
from benchmarks.insertion.robustness import run_robustness
from benchmarks.insertion.simulated import run_simulated
from benchmarks.jobs import (
    NEEDLE,
    RECORDING,
    Benchmark,
    Drawing,
    Job,
    Outcome,
    Progress,
)
from benchmarks.judging import TISSUE, metric
from benchmarks.report.published_figures import NEEDED
from benchmarks.results import Figure
from groundtruth import PLANT_MODELS, SCENARIOS, GroundTruthError
from groundtruth.scenarios import RANDOM_STACK, RANDOM_TISSUE
from needleforce.plots import FiguresError
from needleforce.recordings import RecordingError
from residual import ResidualError
from urdf import UrdfError

PLANTS = (*PLANT_MODELS, NEEDLE)


def simulated_benchmarks() -> Iterator[Benchmark]:
    """Yield the insertions, then the drawn ones, then those in perturbed worlds."""
    # The two of the published Figure 5, the other speed of each, and the organs: under
    # a minute.
    quick = {
        "gel-25-sinusoidal",
        "gel-70-constant",
        "stack-sinusoidal",
        "stack-glove-constant",
        "liver-constant",
        "abdomen-sinusoidal",
    }
    for item in SCENARIOS.values():
        yield Benchmark(
            id=item.id,
            title=item.title,
            run=run_simulated,
            is_default=item.id in quick,
            possible=PLANTS if item.layers else tuple(PLANT_MODELS),
        )
    for name, drawn in ((RANDOM_STACK, "speed"), (RANDOM_TISSUE, "speed, tissue law")):
        yield Benchmark(
            id=name,
            title=f"layers, motion and {drawn} drawn anew for every seed",
            run=run_simulated,
            is_default=False,
            plants=(NEEDLE,),
            possible=PLANTS,
        )
    title_of_mixed = "one of these scenarios, three perturbations at a time"
    for name, title, worlds in (
        *(
            (name, f"{name} in perturbed worlds", tuple(PERTURBATIONS))
            for name in ROBUST
        ),
        (MIXED, title_of_mixed, (MIXED,)),
    ):
        yield Benchmark(
            id=PERTURBED + name,
            title=title,
            run=run_robustness,
            is_default=False,
            plants=worlds,
            possible=worlds,
            group="robustness",
        )


def read_benchmarks() -> Iterator[Benchmark]:
    """Yield the benchmarks of `catalogue.toml`."""
    text = Path(__file__).with_suffix(".toml").read_text(encoding="utf-8")
    for family in tomllib.loads(text).values():
        for name, part in family.pop("parts").items():
            yield make_benchmark(name, **(family | part))


def make_benchmark(
    part: str,
    *,
    package: str,
    name: str,
    module: str = "",
    function: str = "run",
    has_cases: bool = False,
    **fields: Any,
) -> Benchmark:
    """Return a benchmark of a module, which is imported when it runs.

    Args:
        part: Its name in the family.
        package: Of the module.
        name: Stands before the part in the benchmark's name.
        module: If it has not the part's name.
        function: That does a job.
        has_cases: Whether the module names cases.
        fields: Of the benchmark.
    """
    path = f"{__package__}.{package}.{module or part}"

    def run(job: Job, progress: Progress) -> Iterable[Figure | Drawing]:
        return getattr(import_module(path), function)(job, progress)

    def find_cases() -> Sequence[str]:
        return import_module(path).CASES if has_cases else ("",)

    return Benchmark(id=f"{name}{part}", run=run, find_cases=find_cases, **fields)


BENCHMARKS: Mapping[str, Benchmark] = {
    item.id: item for item in (*simulated_benchmarks(), *read_benchmarks())
}
"""By name."""
ALL = "all"
"""Names all benchmarks that belong to no group."""
IDS: Mapping[str, Sequence[str]] = {
    "tissue": TISSUE,
    "robustness": tuple(PERTURBED + name for name in ROBUST),
} | {
    group: tuple(item.id for item in BENCHMARKS.values() if item.group == group)
    for group in ("control", "anatomy")
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


def chosen_plants(benchmark: Benchmark, request: Request) -> Sequence[str]:
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
    rows = []
    drawings = []
    try:
        for item in benchmark_named(job.benchmark).run(job, progress):
            if isinstance(item, Drawing):
                drawings.append(item)
            else:
                metric(item.metric)
                rows.append(item.row(job.scenario, job.plant, job.seed))
    except KNOWN as error:
        return Outcome(job=job, failure=f"{type(error).__name__}: {error}")
    except Exception:  # it must not take hours of others with it
        return Outcome(job=job, failure=format_exc())
    return Outcome(job=job, rows=tuple(rows), drawings=tuple(drawings))
