"""`needleforce demo abdomen` over seeds: how far from the target the tip stops."""

from collections.abc import Iterator

import numpy as np

from benchmarks.anatomy import CT_FOLDER
from benchmarks.jobs import Figure, Job
from needleforce.simulation.planned_insertion import insert

RUNS = 20


def run(job: Job) -> Iterator[Figure]:
    """Yield the errors on the analytic torso, and on the CT where it is there."""
    places = {"analytic torso": None} | (
        {} if job.data is None else {"CT": job.data / CT_FOLDER}
    )
    for name, folder in places.items():
        errors = [insert(folder, job.seed + k).errors_m for k in range(RUNS)]
        by_plan_mm, corrected_mm = 1e3 * np.sqrt(np.mean(np.square(errors), axis=0))
        worst_mm = 1e3 * float(np.max(errors, axis=0)[1])
        yield Figure("target_error_by_plan_rms_mm", by_plan_mm, name)
        yield Figure("target_error_rms_mm", corrected_mm, name)
        yield Figure("target_error_max_mm", worst_mm, name)
