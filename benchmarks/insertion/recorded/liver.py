"""Insertions into real human liver.

de Jong, Dankelman, van den Dobbelsteen, "Dataset on needle insertions in ex vivo human
livers", Data in Brief 2017, doi 10.1016/j.dib.2017.01.018.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter1d

from benchmarks.insertion.methods import IDENTIFIERS
from benchmarks.insertion.recorded import read_arrays
from benchmarks.jobs import Figure, Job, Method, make_figures
from foundation.arrays import Array
from identification import replay


def mean_at_depth(depth_m: Array, values: Array, at_m: float) -> float:
    """Return the mean of values within 0.5 mm of a depth.

    It is nan when the needle was never there.
    """
    near = np.abs(depth_m - at_m) <= 0.5e-3
    return float(np.mean(values[near])) if near.any() else float("nan")


FOLDER = "liver_dejong2017"
NUMBERS = (0, 2, 4, 6, 8, 10, 12, 16, 18, 20, 22, 24, 26, 28, 30, 32, 34, 36, 38)
"""Of the insertions, as in the file."""
VISIBLE_SIGMAS = 5.0
"""A fall of a recorded force is seen when it is so many times the noise."""
NOISE_N = 7e-3
"""Of the recorded force, above 20 Hz, as the recordings' description says."""
DEPTHS_mm = (42, 78)
"""Half way and near the end: where friction is compared."""
REST_s = 0.9
"""The needle rests at least this long at the start of each recording."""


class LiverInsertion(NamedTuple):
    """One recording of n samples: insertion, hold and withdrawal.

    Attributes:
        t_s: Time since its first sample, shape (n,).
        depth_m: Shape (n,).
        force_N: Axial force as recorded, shape (n,).
        insertion: Samples until the needle is at its deepest.
        forward: Samples of insertion and hold: it does not move back yet.
        withdrawal: Samples since it is 2 mm above the deepest: friction has turned
            round and the tip touches nothing.
    """

    t_s: Array
    depth_m: Array
    force_N: Array
    insertion: slice
    forward: slice
    withdrawal: slice

    @property
    def pullout_N(self) -> tuple[float, ...]:
        """Force of pulling the needle out at each of `DEPTHS_mm`: friction alone."""
        return tuple(-self.force_at_N(self.withdrawal, mm) for mm in DEPTHS_mm)

    def force_at_N(self, part: slice, depth_mm: float) -> float:
        """Return the mean force near a depth [mm] in a part of the recording.

        It is nan if the needle was not there. Negative during withdrawal, where
        friction holds the needle back.
        """
        return mean_at_depth(self.depth_m[part], self.force_N[part], 1e-3 * depth_mm)


def read_liver(data: Path, index: int) -> LiverInsertion:
    """Read one insertion from the folder of recordings.

    The index is one into `NUMBERS`.

    Raises:
        DataError: The file is missing or broken.
    """
    number = f"{NUMBERS[index]:02d}"
    names = ("sample_rate_Hz", f"depth_m_{number}", f"force_N_{number}")
    rate, depth, force = read_arrays(data / FOLDER / "insertions.npz", names)
    deepest_m = float(depth.max())
    deep = np.flatnonzero(depth >= deepest_m - 1e-4)  # which is no difference
    back = np.flatnonzero(depth[deep[-1] :] < deepest_m - 2e-3)
    out = int(deep[-1] + (back[0] if len(back) else len(depth)))
    return LiverInsertion(
        np.arange(len(depth)) / float(rate),
        depth,
        force,
        insertion=slice(0, int(deep[0]) + 1),
        forward=slice(0, int(deep[-1]) + 1),
        withdrawal=slice(out, len(depth)),
    )


class ForceDrop(NamedTuple):
    """One sudden drop of the force, found offline.

    Attributes:
        from_m: Depth at its top.
        to_m: Depth at its foot.
        drop_N: Its height.
    """

    from_m: float
    to_m: float
    drop_N: float


def force_drops(
    depth_m: Array, force_N: Array, least_N: float = 0.15
) -> list[ForceDrop]:
    """Find every drop by at least `least_N` within 2 mm of travel.

    By default the smallest internal rupture described for the liver recordings, twenty
    times their noise. Overlapping drops are one. The last 2 mm do not count: there the
    needle slows down. The needle advances, shapes (n,).
    """
    # A rupture of liver releases over 0.5 to 2 mm; what takes longer is none.
    release_m = 2e-3
    depth = np.maximum.accumulate(depth_m)
    force = uniform_filter1d(force_N, 21, mode="nearest")
    begin = np.searchsorted(depth, depth - release_m)
    inside = np.flatnonzero(depth < depth[-1] - release_m)
    drops: list[ForceDrop] = []
    for k in inside.tolist():
        top = int(begin[k]) + int(np.argmax(force[begin[k] : k + 1]))
        drop = ForceDrop(
            float(depth[top]), float(depth[k]), float(force[top] - force[k])
        )
        if drop.drop_N < least_N:
            continue
        if not drops or drop.from_m > drops[-1].to_m:
            drops.append(drop)
        elif drop.drop_N > drops[-1].drop_N:
            drops[-1] = drop
    return drops


def at_drops(alarms_m: Sequence[float], drops: Sequence[ForceDrop]) -> tuple[int, int]:
    """Return how many alarms lie at a drop, and how many drops have an alarm.

    Alarms are given by their depths. One belongs to a drop when it lies between its top
    and its foot, or within half a millimetre of either.
    """
    near_m = 0.5e-3
    is_at = [
        [drop.from_m - near_m <= alarm <= drop.to_m + near_m for drop in drops]
        for alarm in alarms_m
    ]
    return sum(map(any, is_at)), sum(map(any, zip(*is_at, strict=True)))


LiverReference = tuple[tuple[float, ...], list[ForceDrop], list[ForceDrop]]
"""What the estimates of an insertion are compared with: pull-out force at each of
`DEPTHS_mm` [N], drops as large as an internal rupture, drops by more than five times
the noise, the former among them."""


class LiverEstimates(NamedTuple):
    """What a method made of an insertion; a rule of thumb reports friction only.

    Attributes:
        reference: What they are compared with.
        friction_N: At each depth.
        alarms_m: Depths of the ruptures reported.
        friction_std_N: At each depth; empty or nan where none is stated.
    """

    reference: LiverReference
    friction_N: tuple[float, ...]
    alarms_m: Sequence[float] = ()
    friction_std_N: tuple[float, ...] = ()


def liver_reference(
    insertion: LiverInsertion, depth_m: Array, force_N: Array
) -> LiverReference:
    """Find the drops of a force over depth, shape (n,) each.

    The force is as recorded or as put on an arm.
    """
    small = force_drops(depth_m, force_N, VISIBLE_SIGMAS * NOISE_N)
    return insertion.pullout_N, force_drops(depth_m, force_N), small


def liver_estimates(
    t_s: Array,
    depth_m: Array,
    force_N: Array,
    method: Method,
    reference: LiverReference,
) -> LiverEstimates:
    """Replay a recording; return friction at each depth, and ruptures, by a method."""
    estimates = replay(t_s, depth_m, force_N, config=IDENTIFIERS[method]).estimates
    rows = [(item.shaft_friction_N, item.shaft_friction_std_N) for item in estimates]
    friction, friction_std = np.array(rows, dtype=float).T  # None becomes nan
    # A session counts depth from the tare: where an alarm came, the recording knows.
    alarms_m = [
        float(at)
        for row, at in zip(estimates, depth_m, strict=True)
        if row.rupture is not None
    ]
    return LiverEstimates(
        reference,
        tuple(mean_at_depth(depth_m, friction, 1e-3 * mm) for mm in DEPTHS_mm),
        alarms_m,
        tuple(mean_at_depth(depth_m, friction_std, 1e-3 * mm) for mm in DEPTHS_mm),
    )


def friction_values(insertions: Sequence[LiverEstimates]) -> dict[str, float]:
    """Return the errors of the friction over insertions, and how well they are stated.

    Median and 90th percentile.
    """
    true_N = np.array([item.reference[0] for item in insertions])
    error_N = np.abs(np.array([item.friction_N for item in insertions]) - true_N)
    values = {
        f"pullout_error_{name}_pct": float(np.percentile(100.0 * error_N / true_N, pct))
        for name, pct in (("median", 50.0), ("p90", 90.0))
    }
    std_N = np.array([item.friction_std_N for item in insertions])
    if std_N.size and np.isfinite(std_N).all():
        is_covered = error_N <= 2.0 * std_N
        for mm, covers in zip(DEPTHS_mm, is_covered.T, strict=True):
            values[f"pullout_coverage_{mm}mm"] = float(np.mean(covers))
    return values


def rupture_values(insertions: Sequence[LiverEstimates]) -> dict[str, float]:
    """Return the ruptures of all insertions against the drops of the force."""
    ruptures = sum(len(item.alarms_m) for item in insertions)
    drops = sum(len(item.reference[1]) for item in insertions)
    values = {
        "ruptures_per_insertion": ruptures / len(insertions),
        "drops_per_insertion": drops / len(insertions),
    }
    if drops:
        with_alarm = [
            at_drops(item.alarms_m, item.reference[1])[1] for item in insertions
        ]
        values["drop_recall"] = sum(with_alarm) / drops
    if ruptures:
        at_one = [at_drops(item.alarms_m, item.reference[2])[0] for item in insertions]
        values["ruptures_at_drops"] = sum(at_one) / ruptures
    return values


def run(job: Job) -> Iterator[Figure]:
    """Run ``liver-real``: friction during insertion against the pull-out force.

    The needle is pulled out against friction alone, so the pull-out force at a depth is
    what the shaft friction was there during insertion. Methods see the insertion and
    the hold only. The rule of thumb: 0.7 of the insertion force is friction.
    """
    by_method: dict[Method, list[LiverEstimates]] = {"rule-of-thumb": []}
    by_method |= {method: [] for method in IDENTIFIERS}
    for index in range(len(NUMBERS)):
        whole = read_liver(job.recordings, index)
        inside = whole.insertion
        forward = whole.forward
        reference = liver_reference(whole, whole.depth_m[inside], whole.force_N[inside])
        thumb = tuple(0.7 * whole.force_at_N(inside, mm) for mm in DEPTHS_mm)
        by_method["rule-of-thumb"].append(LiverEstimates(reference, thumb))
        course = whole.t_s[forward], whole.depth_m[forward], whole.force_N[forward]
        for method in IDENTIFIERS:
            by_method[method].append(liver_estimates(*course, method, reference))
    for method, estimates in by_method.items():
        values = friction_values(estimates)
        if method != "rule-of-thumb":
            values |= rupture_values(estimates)
        yield from make_figures(values, "ft", method)
