"""Every benchmark under its permanent name."""

from collections.abc import Mapping
from types import MappingProxyType

from benchmarks import UnknownIdError
from benchmarks.benchmark import Benchmark
from benchmarks.recorded import bovine, liver, panda, ur10e
from benchmarks.recorded.bovine import run_bovine_real
from benchmarks.recorded.liver import run_liver_real
from benchmarks.recorded.liver_limit import run_liver_limit
from benchmarks.recorded.panda import run_panda_liver, run_panda_real
from benchmarks.recorded.ur10e import run_ur10e_payload
from benchmarks.simulated import NEEDLE, run_observers, run_simulated
from groundtruth import SCENARIOS
from groundtruth.scenarios import RANDOM_STACK

QUICK = (
    # The two of the published Figure 5, the other speed of each, and the organs: under a minute.
    "gel-25-sinusoidal",
    "gel-70-constant",
    "stack-sinusoidal",
    "stack-glove-constant",
    "liver-constant",
    "abdomen-sinusoidal",
)


_SIMULATED = (
    *(
        Benchmark(
            id=item.id,
            title=item.title,
            run=run_simulated,
            is_default=item.id in QUICK,
            needs_arm=not item.layers,
        )
        for item in SCENARIOS.values()
    ),
    Benchmark(
        id=RANDOM_STACK,
        title="layers, motion and speed drawn anew for every seed",
        run=run_simulated,
        is_default=False,
        plants=(NEEDLE,),
        needs_arm=False,
    ),
    Benchmark(
        id="observers",
        title="momentum, smoothed momentum and Kalman observer on the same samples",
        run=run_observers,
        is_default=False,
    ),
)
_RECORDED = (
    Benchmark(
        id="panda-real",
        title="residual of a real Panda in free motion",
        run=run_panda_real,
        needs=(panda.FOLDER,),
        seeds=1,
    ),
    Benchmark(
        id="panda-liver",
        title="real liver force on the real torques of a Panda; one insertion per seed",
        run=run_panda_liver,
        needs=(panda.FOLDER, liver.FOLDER),
        seeds=len(liver.NUMBERS),
    ),
    Benchmark(
        id="ur10e-payload",
        title="weight of a known payload from the currents of a real UR10e",
        run=run_ur10e_payload,
        needs=(ur10e.FOLDER,),
        seeds=1,
    ),
    Benchmark(
        id="liver-real",
        title="friction in 19 insertions into real liver against the pull-out force",
        run=run_liver_real,
        needs=(liver.FOLDER,),
        seeds=1,
    ),
    Benchmark(
        id="liver-limit",
        title="how well 19 insertions into real liver can predict the pull-out force at all",
        run=run_liver_limit,
        needs=(liver.FOLDER,),
        seeds=1,
        is_default=False,
    ),
    Benchmark(
        id="bovine-real",
        title="the ruptures of an insertion into real bovine liver",
        run=run_bovine_real,
        needs=(bovine.FOLDER,),
        seeds=1,
    ),
)
BENCHMARKS: Mapping[str, Benchmark] = MappingProxyType(
    {item.id: item for item in (*_SIMULATED, *_RECORDED)}
)
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
            f"no benchmark {benchmark_id!r}; choose from: {', '.join(BENCHMARKS)}, tissue, all"
        ) from None
