"""Every benchmark under its permanent name."""

from collections.abc import Mapping
from types import MappingProxyType

from benchmarks.benchmark import Benchmark
from benchmarks.errors import UnknownIdError
from benchmarks.simulated import RANDOM_STACK
from benchmarks.simulated_job import run_simulated
from groundtruth import SCENARIOS

QUICK = (
    # The two of the paper's Figure 5, the other speed of each, and the organs: under a minute.
    "gel-25-sinusoidal",
    "gel-70-constant",
    "stack-sinusoidal",
    "stack-glove-constant",
    "liver-constant",
    "abdomen-sinusoidal",
)


def _simulated() -> list[Benchmark]:
    named = [
        Benchmark(id=item.id, title=item.title, run=run_simulated, is_default=item.id in QUICK)
        for item in SCENARIOS.values()
    ]
    drawn = Benchmark(
        id=RANDOM_STACK,
        title="layers, motion and speed drawn anew for every seed",
        run=run_simulated,
        is_default=False,
    )
    return [*named, drawn]


BENCHMARKS: Mapping[str, Benchmark] = MappingProxyType({item.id: item for item in (*_simulated(),)})
"""By name."""


def benchmark(benchmark_id: str) -> Benchmark:
    """The benchmark of that name.

    Raises:
        UnknownIdError: There is none; the message lists the names.
    """
    try:
        return BENCHMARKS[benchmark_id]
    except KeyError:
        raise UnknownIdError(
            f"no benchmark {benchmark_id!r}; choose from: {', '.join(BENCHMARKS)}, or all"
        ) from None
