"""The patient's anatomy against analytic shapes and a real CT.

Each part is a benchmark of its own.

A part is a module of this package with ``measure(seed, data, progress)``, which yields
numbers; ``data`` is the folder of recordings, or None.
"""

from importlib import import_module

from benchmarks.jobs import NO_PLANT, Benchmark, Job, JobResult, Progress

GROUP = "anatomy"
FIRST_SEED = 1000
"""Methods are tuned on seeds below."""
CT_FOLDER = "torso_ct_totalsegmentator"
"""Of the recordings."""
TITLES = {
    "surface": "surfaces of ellipsoids and of a CT, places read from every format",
    "path": "layers along straight paths through analytic torsos",
    "obstacles": "paths among thin ribs: through bone, and clear ones",
    "agreement": "labels against their scan: right, mirrored, shifted, foreign",
    "deviation": "the needle against the plan: aside, turned, and on it",
    "registration": "landmarks and touches: errors stated and true, what is refused",
    "match": "the plan against the ruptures of random stacks; half an hour",
    "abdomen": "how far from the target the tip stops in the demonstration",
}
"""Of the parts that ``anatomy`` runs."""


def run_part(job: Job, progress: Progress) -> JobResult:
    """Measure a part with one seed."""
    module = import_module(f"{__package__}.{job.benchmark.removeprefix(f'{GROUP}-')}")
    return JobResult(list(module.measure(job.seed, job.data, progress)))


ANATOMY = (
    *(
        Benchmark(
            id=f"{GROUP}-{part}",
            title=title,
            run=run_part,
            uses_data=True,
            first_seed=FIRST_SEED,
            group=GROUP,
            is_default=False,
            plants=(NO_PLANT,),
            possible=(NO_PLANT,),
        )
        for part, title in TITLES.items()
    ),
    Benchmark(
        id=f"{GROUP}-fullsize",
        title="time and memory of a CT of 88 million voxels; minutes and 2 GB",
        run=run_part,
        needs=(CT_FOLDER,),
        group=f"{GROUP} of full size",
        is_default=False,
    ),
)
