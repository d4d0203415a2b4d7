"""``bovine-real``: the four ruptures of an insertion into bovine liver.

The curve falls in more places than the annotated ones (docs/limits.md). An alarm that belongs to
none of the four counts as false, whatever the force does there; whether it falls there by more than
five times the noise, as a true rupture of a simulated tissue must, is told beside it.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from benchmarks.benchmark import Findings
from benchmarks.job import Job, Progress
from benchmarks.methods.identified import IDENTIFIERS
from benchmarks.metrics.measurement import Measurement
from benchmarks.metrics.transition import VISIBLE_SIGMAS
from benchmarks.recorded.bovine import NOISE_N, CONTACT_m, RUPTURES_mm, read_bovine
from benchmarks.recorded.force_falls import alarms_at_falls, force_falls
from identification import PaperConfig, Replay, replay

NEAR_mm = 1.5
"""An alarm farther than this from every annotated rupture is false."""


def run_bovine_real(job: Job, progress: Progress) -> Findings:
    """Both methods; `paper` is told where first contact is, ours finds it.

    Raises:
        DataError: The recording is missing or broken.
    """
    data = job.recordings
    signal = read_bovine(data, np.random.default_rng(job.seed))
    drawn = read_bovine(data, None)
    falls = force_falls(drawn.depth_m, drawn.force_N, VISIBLE_SIGMAS * NOISE_N)
    found: list[Measurement] = []
    for k, (method, config) in enumerate(IDENTIFIERS.items()):
        progress(k / len(IDENTIFIERS))
        if isinstance(config, PaperConfig):
            config = replace(config, contact_depth_m=CONTACT_m)
        result = replay(signal.t_s, signal.depth_m, signal.force_N, config=config)
        alarms_mm, dated_mm = _depths_mm(result)
        values = depth_metrics(alarms_mm, dated_mm, RUPTURES_mm)
        with_fall = alarms_at_falls([1e-3 * alarm for alarm in alarms_mm], falls)
        values["ruptures_without_fall"] = float(len(alarms_mm) - with_fall)
        found += [Measurement("ft", method, name, value) for name, value in values.items()]
    return Findings(found)


def depth_metrics(
    alarms_mm: Sequence[float], dated_mm: Sequence[float], true_mm: Sequence[float]
) -> dict[str, float]:
    """Missed and false ruptures, and how far the others are out.

    Each true rupture takes the nearest alarm within `NEAR_mm` that no nearer one has taken.

    Args:
        alarms_mm: Depths of the alarms.
        dated_mm: Depths at which the same ruptures were estimated to have happened.
        true_mm: Annotated depths.

    Returns:
        Numbers by name; worst distances only when something was found.
    """
    pairs = sorted(
        (abs(alarm - true), i, j)
        for i, true in enumerate(true_mm)
        for j, alarm in enumerate(alarms_mm)
        if abs(alarm - true) <= NEAR_mm
    )
    alarm_of: dict[int, int] = {}
    for _, i, j in pairs:
        if i not in alarm_of and j not in alarm_of.values():
            alarm_of[i] = j
    values = {
        "ruptures_missed": float(len(true_mm) - len(alarm_of)),
        "ruptures_false": float(len(alarms_mm) - len(alarm_of)),
    }
    if alarm_of:
        values["rupture_depth_error_mm"] = max(
            abs(alarms_mm[j] - true_mm[i]) for i, j in alarm_of.items()
        )
        values["rupture_dated_depth_error_mm"] = max(
            abs(dated_mm[j] - true_mm[i]) for i, j in alarm_of.items()
        )
    return values


def _depths_mm(result: Replay) -> tuple[list[float], list[float]]:
    """Depths of the alarms, and of the ruptures as estimated with them."""
    events = [row.rupture for row in result.estimates if row.rupture is not None]
    alarms = [1e3 * event.alarm_depth_m for event in events]
    return alarms, [1e3 * event.depth_m for event in events]
