"""`needleforce demo abdomen` over seeds: how far from the target the tip stops."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.anatomy.study import CT_FOLDER, Figure
from benchmarks.jobs import Progress
from needleforce.cli.demos.abdomen_insertion import insert

RUNS = 20


def measure(seed: int, data: Path | None, progress: Progress) -> Iterator[Figure]:
    """Yield the errors on the analytic torso, and on the CT where it is there."""
    places = {"analytic torso": None} | (
        {} if data is None else {"CT": data / CT_FOLDER}
    )
    for number, (name, folder) in enumerate(places.items()):
        errors = []
        for k in range(RUNS):
            errors.append(insert(folder, seed + k).errors_m)
            progress((number + (k + 1) / RUNS) / len(places))
        by_plan, corrected = 1e3 * np.sqrt(np.mean(np.square(errors), axis=0))
        worst = 1e3 * float(np.max(errors, axis=0)[1])
        yield Figure(
            f"{name}: tip from the target by the plan alone, rms", "", by_plan, "mm"
        )
        yield Figure(
            f"{name}: tip from the target, corrected, rms", "", corrected, "mm", 1.5
        )
        yield Figure(f"{name}: the same, worst of {RUNS}", "", worst, "mm")
