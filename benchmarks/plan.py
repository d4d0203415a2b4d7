"""From what was asked for to jobs."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.benchmark import Benchmark
from benchmarks.catalogue import BENCHMARKS, benchmark
from benchmarks.charts.paper_figures import NEEDED
from benchmarks.errors import DataError, UnknownIdError
from benchmarks.job import RECORDING, Job
from benchmarks.simulated.needle_benchmark import NEEDLE
from benchmarks.verdict.scenario_groups import TISSUE
from groundtruth import ARM_LEVELS

ALL = "all"
GROUPS = {"tissue": TISSUE}
"""Names that stand for several benchmarks; `ALL` for every one."""
PLANTS = (*ARM_LEVELS, NEEDLE)


@dataclass(frozen=True, slots=True, kw_only=True)
class Request:
    """What was asked for.

    Attributes:
        ids: Names of benchmarks; none for the quick ones (and, where charts are wanted, for what
            the paper's figures need), ``all`` for all, ``tissue`` for the scenarios with tissue.
        plants: Arm levels of simulations, ``needle`` for none; when empty, every benchmark runs on
            its own: the random stack with the needle alone, so that hundreds are affordable.
        seeds: Seeds 0 to seeds - 1 are run.
        data: Folder of recordings, if any.
        drawings: Folder for charts, if wanted.
    """

    ids: Sequence[str] = ()
    plants: Sequence[str] = ()
    seeds: int = 1
    data: Path | None = None
    drawings: Path | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """What will be done.

    Attributes:
        jobs: In order.
        skipped: Names of benchmarks that are left out for want of recordings.
    """

    jobs: tuple[Job, ...]
    skipped: tuple[str, ...]


def make_plan(request: Request) -> Plan:
    """Turn a request into jobs.

    Raises:
        UnknownIdError: A benchmark or an arm level of that name does not exist.
        DataError: The folder of recordings does not exist, or a benchmark that was asked for by
            name needs one, or an arm where only the needle was asked for.
    """
    _check_plants(request.plants)
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


def _check_plants(plants: Sequence[str]) -> None:
    for plant in plants:
        if plant not in PLANTS:
            raise UnknownIdError(f"no plant {plant!r}; choose from: {', '.join(PLANTS)}")


def _chosen(request: Request) -> list[Benchmark]:
    """The benchmarks in the catalogue's order, each once."""
    ids = [name for asked in request.ids for name in GROUPS.get(asked, (asked,))]
    for name in ids:
        if name != ALL:
            benchmark(name)
    if not ids:
        drawn = NEEDED if request.drawings is not None else ()
        return [item for item in BENCHMARKS.values() if item.is_default or item.id in drawn]
    return [item for item in BENCHMARKS.values() if ALL in ids or item.id in ids]


def _missing(item: Benchmark, request: Request) -> str:
    """What a benchmark lacks, nothing for one that can run."""
    if not item.is_recorded:
        return "" if _plants(item, request) else f"an arm: a plant other than {NEEDLE}"
    data = request.data
    if data is None:
        return "recordings: give --data DIR or set NEEDLEFORCE_DATA"
    absent = [name for name in item.needs if not (data / name).is_dir()]
    return f"the folder {', '.join(absent)} in {data}" if absent else ""


def _plants(item: Benchmark, request: Request) -> tuple[str, ...]:
    """The plants a simulation runs on, each once; none when it needs an arm and none was named."""
    asked = tuple(dict.fromkeys(request.plants)) or item.plants
    return tuple(plant for plant in asked if plant != NEEDLE or not item.needs_arm)


def _jobs(item: Benchmark, request: Request) -> list[Job]:
    seeds = request.seeds if item.seeds is None else min(item.seeds, request.seeds)
    plants = (RECORDING,) if item.is_recorded else _plants(item, request)
    return [
        Job(
            benchmark=item.id,
            plant=plant,
            seed=seed,
            data=request.data if item.is_recorded else None,
            # One chart of each kind tells enough.
            drawings=request.drawings if seed == 0 else None,
        )
        for plant in plants
        for seed in range(seeds)
    ]
