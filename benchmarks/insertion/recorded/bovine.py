"""One insertion into bovine liver, digitised from a figure.

Okamura, Simone, O'Leary, "Force modeling for needle insertion into soft tissue", IEEE
TBME 2004, doi 10.1109/TBME.2004.831542.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks import DataError
from benchmarks.insertion.methods import IDENTIFIERS
from benchmarks.insertion.recorded.liver import VISIBLE_SIGMAS, at_drops, force_drops
from benchmarks.insertion.signals import NeedleSignal
from benchmarks.jobs import Figure, Job, make_figures
from groundtruth.rupture_match import nearest_pairs
from identification import PublishedConfig, replay

FOLDER = "bovine_liver_okamura2004"
RUPTURES_mm = (19.2, 29.9, 32.7, 36.7)
"""The capsule as annotated by the authors; the others read off the curve."""


def read_bovine(data: Path) -> NeedleSignal:
    """Return the insertion from the points of the figure.

    The curve was traced in one stroke of 232 points; those that follow it in the file
    go over parts of it again, less exactly, and would put a zigzag into it. The
    stroke's points are joined by straight lines; where it falls it goes straight down.

    Args:
        data: Folder of recordings.

    Raises:
        DataError: The file is missing or broken.
    """
    path = data / FOLDER / "depth_force.csv"
    try:
        table = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)
    except (OSError, ValueError) as error:
        raise DataError(f"cannot read {path}: {error}") from error
    if table.shape[1] != 2 or not np.isfinite(table).all():
        raise DataError(
            f"{path} should have two columns, depth_m and force_N, and finite values"
        )
    # Where the depth falls by more than a millimetre, a new stroke begins.
    lifts = np.flatnonzero(np.diff(table[:, 0]) < -1e-3)
    stroke = table[: lifts[0] + 1] if len(lifts) else table
    depth = np.maximum.accumulate(stroke[:, 0])
    rate_hz = 1000.0
    speed_m_s = 3e-3
    t_s = np.arange(int(depth[-1] / speed_m_s * rate_hz)) / rate_hz
    depth_m = t_s * speed_m_s
    force_N = np.interp(depth_m, depth, stroke[:, 1])
    return NeedleSignal("ft", t_s, depth_m, None, force_N)


def run(job: Job) -> Iterator[Figure]:
    """Run ``bovine-real``: the four ruptures of the insertion, by both methods.

    The curve falls in more places than the annotated ones: at 15.7 and 38.6 mm by 0.09
    and 0.16 N. An alarm that belongs to none of the four counts as false, whatever the
    force does there; whether it drops there by more than five times the noise, as at a
    true rupture of a simulated tissue, is reported beside it.
    `published` is given the depth of first contact, ours finds it.
    """
    drawn = read_bovine(job.recordings)
    # A drawn line shows no noise, and every sensor has some: this is sigma_0, and what
    # the points of the later strokes scatter by in free air, between two dips there.
    noise_N = 0.01
    drops = force_drops(drawn.depth_m, drawn.force_N, VISIBLE_SIGMAS * noise_N)
    rng = np.random.default_rng(job.seed)
    force_N = drawn.force_N + noise_N * rng.standard_normal(len(drawn.force_N))
    for method, config in IDENTIFIERS.items():
        if isinstance(config, PublishedConfig):
            # About where the needle meets the liver.
            config = replace(config, contact_depth_m=8e-3)
        result = replay(drawn.t_s, drawn.depth_m, force_N, config=config)
        events = [row.rupture for row in result.estimates if row.rupture is not None]
        alarms_m = [event.alarm_depth_m for event in events]
        values = depth_metrics(
            [1e3 * alarm_m for alarm_m in alarms_m],
            [1e3 * event.depth_m for event in events],
            RUPTURES_mm,
        )
        values["ruptures_without_drop"] = float(
            len(events) - at_drops(alarms_m, drops)[0]
        )
        yield from make_figures(values, "ft", method)


def depth_metrics(
    alarms_mm: Sequence[float], estimated_mm: Sequence[float], true_mm: Sequence[float]
) -> dict[str, float]:
    """Count missed and false ruptures; return how far the others are out, if any.

    Each annotated rupture takes the nearest alarm within 1.5 mm that no nearer one has
    taken; an alarm that is farther from all of them is false.
    """
    alarm_of = nearest_pairs(true_mm, alarms_mm, 1.5, 1.5)
    values = {
        "ruptures_missed": float(len(true_mm) - len(alarm_of)),
        "ruptures_false": float(len(alarms_mm) - len(alarm_of)),
    }
    named = {
        "rupture_depth_error_mm": alarms_mm,
        "estimated_depth_error_mm": estimated_mm,
    }
    for name, depths_mm in named.items() if alarm_of else ():
        values[name] = max(abs(depths_mm[j] - true_mm[i]) for i, j in alarm_of.items())
    return values
