"""``liver-real``: friction told during insertion against the force that pulls the needle out.

The needle is pulled out against friction alone, so the pull-out force at a depth is what the shaft
friction was there on the way in. Methods see the insertion only.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from benchmarks.benchmark import Findings
from benchmarks.force_falls import Fall, falls_found, force_falls
from benchmarks.identified import IDENTIFIERS
from benchmarks.job import Job, Progress
from benchmarks.liver import NUMBERS, LiverInsertion, read_liver
from benchmarks.measurement import Measurement
from benchmarks.pullout import in_and_out, mean_at_depth
from benchmarks.recordings_folder import recordings_folder
from benchmarks.row import Method
from identification import replay

DEPTHS_mm = (42, 78)
"""Half way and near the end: where friction is compared."""
GUESS_SHARE = 0.7
"""The rule of thumb: so much of the insertion force is friction."""


class _Told(NamedTuple):
    """What a method made of one insertion.

    Attributes:
        error_pct: Relative error of the friction at each depth.
        ruptures: Ruptures reported.
        falls_found: Falls of the force found offline that have an alarm.
    """

    error_pct: list[float]
    ruptures: int = 0
    falls_found: int = 0


def run_liver_real(job: Job, progress: Progress) -> Findings:
    """All insertions through both methods and the guess.

    Raises:
        DataError: The recording is missing or broken.
    """
    data = recordings_folder(job)
    told: dict[Method, list[_Told]] = {"guess": [], "paper": [], "default": []}
    falls = 0
    for index in range(len(NUMBERS)):
        progress(index / len(NUMBERS))
        insertion = read_liver(data, index, as_recorded=True)
        parts = in_and_out(insertion.depth_m)
        inside = parts.insertion
        known = force_falls(insertion.depth_m[inside], insertion.force_N[inside])
        falls += len(known)
        true = [-_force_at(insertion, parts.withdrawal, mm) for mm in DEPTHS_mm]
        guess = [GUESS_SHARE * _force_at(insertion, inside, mm) for mm in DEPTHS_mm]
        told["guess"].append(_Told(_errors_pct(guess, true)))
        for method in IDENTIFIERS:
            told[method].append(_identify(insertion, inside, method, true, known))
    found = [item for method, each in told.items() for item in _measure(method, each, falls)]
    return Findings(found)


def _identify(
    insertion: LiverInsertion,
    inside: slice,
    method: Method,
    true: Sequence[float],
    falls: Sequence[Fall],
) -> _Told:
    """Shaft friction at each depth as told when the needle was there, and ruptures reported."""
    depth, force = insertion.depth_m[inside], insertion.force_N[inside]
    result = replay(insertion.t_s[inside], depth, force, config=IDENTIFIERS[method])
    friction = np.array([estimate.shaft_friction_N for estimate in result.estimates])
    told = [mean_at_depth(depth, friction, 1e-3 * mm) for mm in DEPTHS_mm]
    events = [row.rupture for row in result.estimates if row.rupture is not None]
    alarms = [event.alarm_depth_m for event in events]
    return _Told(_errors_pct(told, true), len(alarms), falls_found(falls, alarms))


def _force_at(insertion: LiverInsertion, part: slice, depth_mm: float) -> float:
    return mean_at_depth(insertion.depth_m[part], insertion.force_N[part], 1e-3 * depth_mm)


def _errors_pct(told: Sequence[float], true: Sequence[float]) -> list[float]:
    return [100.0 * abs(a - b) / b for a, b in zip(told, true, strict=True)]


def _measure(method: Method, told: Sequence[_Told], falls: int) -> Iterator[Measurement]:
    """Numbers of one method over all insertions, with so many falls in them."""
    errors = np.array([each.error_pct for each in told])
    columns = {"": errors.ravel()}
    for mm, column in zip(DEPTHS_mm, errors.T, strict=True):
        columns[f"_{mm}mm"] = column
    for where, values in columns.items():
        for name, share in (("median", 50.0), ("p90", 90.0)):
            value = float(np.percentile(values, share))
            yield Measurement("ft", method, f"pullout_error{where}_{name}_pct", value)
    if method == "guess":
        return
    count = len(told)
    ruptures = sum(each.ruptures for each in told)
    yield Measurement("ft", method, "ruptures_per_insertion", ruptures / count)
    yield Measurement("ft", method, "falls_per_insertion", falls / count)
    if falls:
        share_found = sum(each.falls_found for each in told) / falls
        yield Measurement("ft", method, "fall_recall", share_found)
