"""What a method tells of one insertion into real liver, against what is known of it."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.methods.identified import IDENTIFIERS
from benchmarks.metrics.transition import VISIBLE_SIGMAS
from benchmarks.recorded.force_falls import Fall, alarms_at_falls, falls_found, force_falls
from benchmarks.recorded.liver import NOISE_N
from benchmarks.recorded.pullout import mean_at_depth
from benchmarks.row import Method
from identification import replay

Array = NDArray[np.float64]

DEPTHS_mm = (42, 78)
"""Half way and near the end: where friction is compared."""


class LiverKnown(NamedTuple):
    """What is known of an insertion from elsewhere.

    Attributes:
        pullout_N: Force of pulling the needle out at each of `DEPTHS_mm`.
        falls: Falls of the force as large as an internal rupture.
        small_falls: Falls by more than five times its noise, the former among them.
    """

    pullout_N: tuple[float, ...]
    falls: list[Fall]
    small_falls: list[Fall]


class LiverTold(NamedTuple):
    """What a method made of it.

    Attributes:
        error_pct: Relative error of the friction at each depth.
        friction_N: That friction.
        ruptures: Ruptures reported; none for a rule that reports none.
        at_falls: How many of them have a fall of the force.
        falls_found: Falls as large as a rupture that have an alarm.
        enhanced_N: Enhanced force, shape (n,).
    """

    error_pct: tuple[float, ...]
    friction_N: tuple[float, ...] = ()
    ruptures: int = 0
    at_falls: int = 0
    falls_found: int = 0
    enhanced_N: Array = np.empty(0)


def known_of(pullout_N: Sequence[float], depth_m: Array, force_N: Array) -> LiverKnown:
    """Find the falls of an insertion.

    Args:
        pullout_N: At each of `DEPTHS_mm`.
        depth_m: Depth of the advancing needle, shape (n,).
        force_N: Axial force as recorded, shape (n,).
    """
    small = force_falls(depth_m, force_N, VISIBLE_SIGMAS * NOISE_N)
    return LiverKnown(tuple(pullout_N), force_falls(depth_m, force_N), small)


def tell(
    t_s: Array, depth_m: Array, force_N: Array, method: Method, known: LiverKnown
) -> LiverTold:
    """Shaft friction at each depth as told when the needle was there, and ruptures reported."""
    result = replay(t_s, depth_m, force_N, config=IDENTIFIERS[method])
    friction = np.array([estimate.shaft_friction_N for estimate in result.estimates])
    told = [mean_at_depth(depth_m, friction, 1e-3 * mm) for mm in DEPTHS_mm]
    events = [row.rupture for row in result.estimates if row.rupture is not None]
    alarms = [event.alarm_depth_m for event in events]
    return LiverTold(
        errors_pct(told, known.pullout_N),
        tuple(told),
        len(alarms),
        alarms_at_falls(alarms, known.small_falls),
        falls_found(known.falls, alarms),
        np.array([estimate.enhanced_force_N for estimate in result.estimates]),
    )


def errors_pct(told: Sequence[float], true: Sequence[float]) -> tuple[float, ...]:
    """Relative errors."""
    return tuple(100.0 * abs(a - b) / b for a, b in zip(told, true, strict=True))


def friction_values(told: Sequence[LiverTold]) -> Iterator[tuple[str, float]]:
    """Median and 90th percentile of the errors over insertions, all depths together and each."""
    errors = np.array([each.error_pct for each in told])
    columns = {"": errors.ravel()}
    for mm, column in zip(DEPTHS_mm, errors.T, strict=True):
        columns[f"_{mm}mm"] = column
    for where, values in columns.items():
        for name, share in (("median", 50.0), ("p90", 90.0)):
            yield f"pullout_error{where}_{name}_pct", float(np.percentile(values, share))


def rupture_values(told: Sequence[LiverTold], falls: int) -> Iterator[tuple[str, float]]:
    """Ruptures reported over all insertions against the falls in them.

    Args:
        told: Of each insertion.
        falls: How many falls as large as a rupture all of them hold.
    """
    ruptures = sum(each.ruptures for each in told)
    yield "ruptures_per_insertion", ruptures / len(told)
    yield "falls_per_insertion", falls / len(told)
    if falls:
        yield "fall_recall", sum(each.falls_found for each in told) / falls
    if ruptures:
        yield "ruptures_at_falls", sum(each.at_falls for each in told) / ruptures
