"""``liver-real``: friction told during insertion against the force that pulls the needle out.

The needle is pulled out against friction alone, so the pull-out force at a depth is what the shaft
friction was there on the way in. Methods see the insertion only.
"""

from benchmarks.benchmark import Findings
from benchmarks.job import Job, Progress
from benchmarks.methods.identified import IDENTIFIERS
from benchmarks.metrics.measurement import Measurement
from benchmarks.recorded.liver import NUMBERS, read_liver
from benchmarks.recorded.liver_told import (
    DEPTHS_mm,
    LiverTold,
    errors_pct,
    friction_values,
    known_of,
    rupture_values,
    tell,
)
from benchmarks.recorded.pullout import in_and_out
from benchmarks.row import Method

GUESS_SHARE = 0.7
"""The rule of thumb: so much of the insertion force is friction."""


def run_liver_real(job: Job, progress: Progress) -> Findings:
    """All insertions through both methods and the guess.

    Raises:
        DataError: The recording is missing or broken.
    """
    data = job.recordings
    told: dict[Method, list[LiverTold]] = {"guess": [], "paper": [], "default": []}
    falls = 0
    for index in range(len(NUMBERS)):
        progress(index / len(NUMBERS))
        insertion = read_liver(data, index, as_recorded=True)
        parts = in_and_out(insertion.depth_m)
        inside = parts.insertion
        t_s, depth, force = (
            column[inside] for column in (insertion.t_s, insertion.depth_m, insertion.force_N)
        )
        pullout = [-insertion.force_at_N(parts.withdrawal, mm) for mm in DEPTHS_mm]
        known = known_of(pullout, depth, force)
        falls += len(known.falls)
        guess = [GUESS_SHARE * insertion.force_at_N(inside, mm) for mm in DEPTHS_mm]
        told["guess"].append(LiverTold(errors_pct(guess, pullout)))
        for method in IDENTIFIERS:
            told[method].append(tell(t_s, depth, force, method, known))
    found: list[Measurement] = []
    for method, each in told.items():
        values = list(friction_values(each))
        if method != "guess":
            values += rupture_values(each, falls)
        found += [Measurement("ft", method, name, value) for name, value in values]
    return Findings(found)
