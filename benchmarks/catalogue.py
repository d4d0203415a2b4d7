"""Every benchmark by name, and from names to jobs.

`catalogue.toml` has the benchmarks of the studies; those of simulated insertions are
made here, one for each scenario and for each scenario in perturbed worlds.
"""

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from importlib import import_module
from pathlib import Path

import msgspec

from benchmarks import BenchmarkError, DataError
from benchmarks.insertion.perturbations import MIXED, PERTURBATIONS, PERTURBED
from benchmarks.insertion.robustness import SCENARIOS as ROBUST
from benchmarks.jobs import NEEDLE, Job
from benchmarks.judging import TISSUE
from groundtruth import PLANT_MODELS, SCENARIOS
from groundtruth.scenarios import DRAWN

PLANTS = (*PLANT_MODELS, NEEDLE)
PERTURBED_PLANTS = (*PERTURBATIONS, MIXED)


class Benchmark(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One thing that can be run by name.

    Attributes:
        title: One line for people.
        module: Where its function is, within `benchmarks`.
        function: Does a job: yields its numbers.
        has_cases: Whether the module's `CASES` are jobs of their own.
        group: Name under which its kind runs.
        plants: On which plants it runs when none is named.
        possible: On which it can run; none for those of `plants` only.
        first_seed: The first seed where none is named.
        recordings: How many recordings it has, one a seed; 0 for none.
    """

    title: str
    module: str
    group: str
    function: str = "run"
    has_cases: bool = False
    plants: tuple[str, ...] = ("clean",)
    possible: tuple[str, ...] = ()
    first_seed: int = 0
    recordings: int = 0


def simulated_benchmarks() -> Iterator[tuple[str, Benchmark]]:
    """Yield the insertions, then the drawn ones, then those in perturbed worlds."""
    simulated = "benchmarks.insertion.simulated"
    for name, item in SCENARIOS.items():
        yield (
            name,
            Benchmark(
                title=item.title,
                module=simulated,
                group="insertion",
                possible=PLANTS if item.layers else tuple(PLANT_MODELS),
            ),
        )
    for name in DRAWN:
        yield (
            name,
            Benchmark(
                title="tissue drawn anew for every seed",
                module=simulated,
                group="random",
                plants=(NEEDLE,),
                possible=PLANTS,
            ),
        )
    for name in (*ROBUST, MIXED):
        yield (
            PERTURBED + name,
            Benchmark(
                title=f"{name} in perturbed worlds, which --plant names",
                module="benchmarks.insertion.robustness",
                group="mixed" if name == MIXED else "robustness",
                plants=(MIXED,) if name == MIXED else tuple(PERTURBATIONS),
            ),
        )


def read_benchmarks() -> Iterator[tuple[str, Benchmark]]:
    """Yield the benchmarks of `catalogue.toml`, each with its family's fields."""
    text = Path(__file__).with_suffix(".toml").read_text(encoding="utf-8")
    for family in tomllib.loads(text).values():
        for name, part in family.pop("parts").items():
            yield name, msgspec.convert(family | part, Benchmark)


BENCHMARKS: Mapping[str, Benchmark] = dict(
    [*simulated_benchmarks(), *read_benchmarks()]
)
"""By name."""
GROUPS: Mapping[str, Sequence[str]] = {
    # Run when nothing is named: under a minute.
    "quick": (
        "gel-25-sinusoidal",
        "gel-70-constant",
        "stack-sinusoidal",
        "stack-glove-constant",
        "liver-constant",
        "abdomen-sinusoidal",
    ),
    # What the figures of the paper need.
    "paper": (
        "gel-70-constant",
        "gel-70-sinusoidal",
        "stack-constant",
        "stack-sinusoidal",
        "stack-glove-constant",
        "liver-constant",
        "abdomen-sinusoidal",
    ),
    "tissue": TISSUE,
} | {
    group: tuple(name for name, item in BENCHMARKS.items() if item.group == group)
    for group in dict.fromkeys(item.group for item in BENCHMARKS.values())
}
"""Names of several benchmarks."""


def make_jobs(
    ids: Sequence[str] = (),
    plants: Sequence[str] = (),
    *,
    seeds: int = 1,
    first_seed: int | None = None,
    data: Path | None = None,
    report: Path | None = None,
) -> list[Job]:
    """Return a job for every case, plant and seed of the benchmarks that are named.

    Args:
        ids: Names of benchmarks or of `GROUPS`; none for the quick ones, or, with a
            report, for what it needs.
        plants: Plant models of simulations, or perturbations; none for those of each
            benchmark. One that has only one plant runs on that.
        seeds: How many seeds are run.
        first_seed: The first of them; None for that of the benchmark.
        data: Folder of recordings.
        report: Folder for the figures of the paper.

    Raises:
        BenchmarkError: A benchmark or a plant of that name does not exist, or a
            benchmark cannot run on any of the plants.
        DataError: A benchmark needs recordings, and there is no folder.
    """
    asked = ids or ("quick" if report is None else "paper",)
    names = dict.fromkeys(name for item in asked for name in GROUPS.get(item, (item,)))
    if unknown := [name for name in names if name not in BENCHMARKS]:
        raise BenchmarkError(
            f"no benchmark {unknown[0]!r}; choose from: "
            f"{', '.join((*GROUPS, *BENCHMARKS))}"
        )
    known_plants = (*PLANTS, *PERTURBED_PLANTS)
    if wrong := [plant for plant in plants if plant not in known_plants]:
        raise BenchmarkError(
            f"no plant {wrong[0]!r}; choose from: {', '.join(known_plants)}"
        )
    jobs = []
    for name in names:
        item = BENCHMARKS[name]
        if item.recordings and (data is None or not data.is_dir()):
            raise DataError(f"{name} needs recordings; there is no folder {data}")
        chosen = choose_plants(name, plants)
        begin = item.first_seed if first_seed is None else first_seed
        chosen_seeds = range(begin, begin + seeds)
        if item.recordings:
            chosen_seeds = range(min(item.recordings, seeds))
        cases = import_module(item.module).CASES if item.has_cases else ("",)
        jobs += [
            Job(
                benchmark=name,
                case=case,
                plant=plant,
                seed=seed,
                data=data,
                report=report if seed == chosen_seeds[0] else None,
            )
            for case in cases
            for plant in chosen
            for seed in chosen_seeds
        ]
    return jobs


def choose_plants(name: str, plants: Sequence[str]) -> Sequence[str]:
    """Return the plants a benchmark runs on, each once.

    Raises:
        BenchmarkError: It cannot run on any of those that are asked for.
    """
    item = BENCHMARKS[name]
    possible = item.possible or item.plants
    if len(possible) == 1 or not plants:
        return item.plants
    chosen = [plant for plant in dict.fromkeys(plants) if plant in possible]
    if not chosen:
        raise BenchmarkError(f"{name} runs on {', '.join(possible)}; got {plants}")
    return chosen
