"""Insertions into real human liver.

de Jong, Dankelman, van den Dobbelsteen, "Dataset on needle insertions in ex vivo human
livers", Data in Brief 2017, doi 10.1016/j.dib.2017.01.018.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from zipfile import BadZipFile

import msgspec
import numpy as np
from scipy.ndimage import uniform_filter1d

from benchmarks import DataError
from benchmarks.insertion.methods import IDENTIFIERS
from benchmarks.insertion.signals import Array
from benchmarks.jobs import Job, JobResult, Progress
from benchmarks.results import Measurement, Method
from identification import replay

WINDOW_m = 0.5e-3
"""The force at a depth is the mean over so much travel to either side."""
HAIR_m = 1e-4
"""A difference of depth that counts as none."""
SETTLED_m = 2e-3
"""Travel back after which friction has turned round and the tip touches nothing."""


def insertion_parts(depth_m: Array) -> tuple[slice, slice]:
    """Insertion and withdrawal in a recording that holds the needle in between.

    The insertion ends where the needle is within `HAIR_m` of its deepest; the
    withdrawal begins when friction has turned round.
    """
    deepest = float(depth_m.max())
    deep = np.flatnonzero(depth_m >= deepest - HAIR_m)
    back = np.flatnonzero(depth_m[deep[-1] :] < deepest - SETTLED_m)
    out = deep[-1] + (int(back[0]) if len(back) else len(depth_m))
    return slice(0, int(deep[0]) + 1), slice(int(out), len(depth_m))


def mean_at_depth(depth_m: Array, values: Array, at_m: float) -> float:
    """Mean of values near a depth, nan when the needle was never there."""
    near = np.abs(depth_m - at_m) <= WINDOW_m
    return float(np.mean(values[near])) if near.any() else float("nan")


def read_arrays(path: Path, names: Sequence[str]) -> list[Array]:
    """The named arrays of an npz file.

    Raises:
        DataError: The file cannot be read, an array is missing, empty or not finite.
    """
    try:
        with np.load(path, allow_pickle=False) as content:
            has = ", ".join(content)
            found = {
                n: np.asarray(content[n], dtype=np.float64)
                for n in names
                if n in content
            }
    except (OSError, EOFError, BadZipFile, ValueError) as error:
        raise DataError(f"cannot read {path}: {error}") from error
    if missing := [name for name in names if name not in found]:
        raise DataError(f"{path} lacks {', '.join(missing)}; it has {has}")
    for name, array in found.items():
        if array.size == 0 or not np.isfinite(array).all():
            raise DataError(
                f"{name} of {path} is empty or has values that are not finite"
            )
    return [found[name] for name in names]


def read_table(path: Path) -> dict[str, Any]:
    """The table of numbers in a JSON file.

    Raises:
        DataError: The file cannot be read or is no JSON object.
    """
    try:
        return msgspec.json.decode(path.read_bytes(), type=dict[str, Any])
    except msgspec.ValidationError as error:
        raise DataError(f"{path} holds no table of named numbers") from error
    except (OSError, msgspec.DecodeError) as error:
        raise DataError(f"cannot read {path}: {error}") from error


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
        insertion: Its parts, see `insertion_parts`.
    """

    t_s: Array
    depth_m: Array
    force_N: Array
    insertion: slice
    withdrawal: slice

    @property
    def before_withdrawal(self) -> slice:
        """Insertion and hold: the needle does not move back yet."""
        return slice(
            0, int(np.flatnonzero(self.depth_m >= self.depth_m.max() - HAIR_m)[-1]) + 1
        )

    @property
    def pullout_N(self) -> tuple[float, ...]:
        """Force of pulling the needle out at each of `DEPTHS_mm`: friction alone."""
        return tuple(-self.force_at_N(self.withdrawal, mm) for mm in DEPTHS_mm)

    def force_at_N(self, part: slice, depth_mm: float) -> float:
        """Mean force near a depth [mm] in a part of the recording; nan if the needle
        was not there.

        Negative during withdrawal, where friction holds the needle back.
        """
        return mean_at_depth(self.depth_m[part], self.force_N[part], 1e-3 * depth_mm)


def read_liver(data: Path, index: int) -> LiverInsertion:
    """Read one insertion from the folder of recordings; the index is one into
    `NUMBERS`.

    Raises:
        DataError: There is no such insertion, or the file is missing or broken.
    """
    if not 0 <= index < len(NUMBERS):
        raise DataError(f"there are {len(NUMBERS)} liver insertions, no number {index}")
    number = f"{NUMBERS[index]:02d}"
    names = ("sample_rate_Hz", f"depth_m_{number}", f"force_N_{number}")
    rate, depth, force = read_arrays(data / FOLDER / "insertions.npz", names)
    t_s = np.arange(len(depth)) / float(rate)
    return LiverInsertion(t_s, depth, force, *insertion_parts(depth))


LEAST_N = 0.15
"""The smallest internal rupture described for the liver recordings; twenty times
their noise."""
LONGEST_m = 2e-3
"""A rupture of liver releases over 0.5 to 2 mm; what takes longer is no rupture."""
SMOOTHING = 21
"""Samples of the centred mean that comes first."""


class ForceDrop(NamedTuple):
    """One sudden drop of the force, found offline: depths at its top and foot, and
    its height.
    """

    from_m: float
    to_m: float
    drop_N: float


NEAR_m = 0.5e-3
"""An alarm belongs to a drop when it lies between its top and its foot, or so close
to either."""


def force_drops(
    depth_m: Array, force_N: Array, least_N: float = LEAST_N
) -> list[ForceDrop]:
    """Every drop by at least `least_N` within `LONGEST_m` of travel.

    Overlapping drops are one. The last `LONGEST_m` do not count: there the needle slows
    down. The needle advances, shapes (n,).
    """
    depth = np.maximum.accumulate(depth_m)
    force = uniform_filter1d(force_N, SMOOTHING, mode="nearest")
    begin = np.searchsorted(depth, depth - LONGEST_m)
    inside = np.flatnonzero(depth < depth[-1] - LONGEST_m)
    found: list[ForceDrop] = []
    for k in inside.tolist():
        top = int(begin[k]) + int(np.argmax(force[begin[k] : k + 1]))
        drop = ForceDrop(
            float(depth[top]), float(depth[k]), float(force[top] - force[k])
        )
        if drop.drop_N < least_N:
            continue
        if not found or drop.from_m > found[-1].to_m:
            found.append(drop)
        elif drop.drop_N > found[-1].drop_N:
            found[-1] = drop
    return found


def at_drops(alarms_m: Sequence[float], drops: Sequence[ForceDrop]) -> tuple[int, int]:
    """How many alarms, given by their depths, lie at a drop, and how many drops have
    an alarm.
    """
    is_at = [
        [drop.from_m - NEAR_m <= alarm <= drop.to_m + NEAR_m for drop in drops]
        for alarm in alarms_m
    ]
    return sum(map(any, is_at)), sum(map(any, zip(*is_at, strict=True)))


class LiverReference(NamedTuple):
    """What the estimates of an insertion are compared with: pull-out force, drops of
    the force.

    Attributes:
        pullout_N: At each of `DEPTHS_mm`.
        drops: As large as an internal rupture.
        small_drops: By more than five times the noise, the former among them.
    """

    pullout_N: tuple[float, ...]
    drops: list[ForceDrop]
    small_drops: list[ForceDrop]


class LiverEstimates(NamedTuple):
    """What a method made of an insertion; a rule of thumb reports friction only.

    Attributes:
        friction_N: At each depth.
        alarms_m: Depths of the ruptures reported.
        enhanced_N: Enhanced force, shape (n,).
        friction_std_N: At each depth; empty or nan where none is stated.
        above_at_rest: Fraction at rest with friction two deviations above the force.
        below_zero: Fraction in contact with the tip force two deviations below zero.
    """

    reference: LiverReference
    friction_N: tuple[float, ...]
    alarms_m: Sequence[float] = ()
    enhanced_N: Array = np.empty(0)
    friction_std_N: tuple[float, ...] = ()
    above_at_rest: float = np.nan
    below_zero: float = np.nan


def liver_reference(
    insertion: LiverInsertion, depth_m: Array, force_N: Array
) -> LiverReference:
    """Find the drops of a force over depth, as recorded or as put on an arm, shape
    (n,) each.
    """
    small = force_drops(depth_m, force_N, VISIBLE_SIGMAS * NOISE_N)
    return LiverReference(insertion.pullout_N, force_drops(depth_m, force_N), small)


def liver_estimates(
    t_s: Array,
    depth_m: Array,
    force_N: Array,
    method: Method,
    reference: LiverReference,
) -> LiverEstimates:
    """Shaft friction at each depth as estimated when the needle was there, ruptures,
    and rest.
    """
    estimates = replay(t_s, depth_m, force_N, config=IDENTIFIERS[method]).estimates
    names = (
        "shaft_friction_N",
        "shaft_friction_std_N",
        "tip_force_N",
        "tip_force_std_N",
    )
    rows = [[getattr(estimate, name) for name in names] for estimate in estimates]
    friction, friction_std, tip, tip_std = np.array(
        rows, dtype=float
    ).T  # None becomes nan
    rests = depth_m >= depth_m.max() - HAIR_m
    rests[: int(np.argmax(rests)) + 1] = False
    in_contact = np.array([estimate.in_contact for estimate in estimates])
    return LiverEstimates(
        reference,
        tuple(mean_at_depth(depth_m, friction, 1e-3 * mm) for mm in DEPTHS_mm),
        [row.rupture.alarm_depth_m for row in estimates if row.rupture is not None],
        np.array([estimate.enhanced_force_N for estimate in estimates]),
        tuple(mean_at_depth(depth_m, friction_std, 1e-3 * mm) for mm in DEPTHS_mm),
        float(np.mean((friction - 2.0 * friction_std > force_N)[rests]))
        if rests.any()
        else 0.0,
        float(np.mean((tip + 2.0 * tip_std < 0.0)[in_contact])),
    )


def friction_values(found: Sequence[LiverEstimates]) -> Iterator[tuple[str, float]]:
    """Median and 90th percentile of the errors over insertions, and how well they
    are stated.
    """
    true = np.array([each.reference.pullout_N for each in found])
    off = np.abs(np.array([each.friction_N for each in found]) - true)
    for name, percent in (("median", 50.0), ("p90", 90.0)):
        yield (
            f"pullout_error_{name}_pct",
            float(np.percentile(100.0 * off / true, percent)),
        )
    stds = np.array([each.friction_std_N for each in found])
    if stds.size and np.isfinite(stds).all():
        for mm, covers in zip(DEPTHS_mm, (off <= 2.0 * stds).T, strict=True):
            yield f"pullout_coverage_{mm}mm", float(np.mean(covers))
        yield (
            "friction_above_force_at_rest",
            float(np.mean([e.above_at_rest for e in found])),
        )
        yield "tip_force_below_zero", float(np.mean([e.below_zero for e in found]))


def rupture_values(found: Sequence[LiverEstimates]) -> Iterator[tuple[str, float]]:
    """Ruptures reported over all insertions against the drops of the force in them."""
    ruptures = sum(len(each.alarms_m) for each in found)
    drops = sum(len(each.reference.drops) for each in found)
    yield "ruptures_per_insertion", ruptures / len(found)
    yield "drops_per_insertion", drops / len(found)
    if drops:
        yield (
            "drop_recall",
            sum(at_drops(e.alarms_m, e.reference.drops)[1] for e in found) / drops,
        )
    if ruptures:
        at = sum(
            at_drops(each.alarms_m, each.reference.small_drops)[0] for each in found
        )
        yield "ruptures_at_drops", at / ruptures


GUESSED_FRICTION = 0.7
"""The rule of thumb: this fraction of the insertion force is friction."""


def run_liver_real(job: Job, progress: Progress) -> JobResult:
    """``liver-real``: friction estimated during insertion against the pull-out force.

    The needle is pulled out against friction alone, so the pull-out force at a depth is
    what the shaft friction was there during insertion. Methods see the insertion and
    the hold only.
    """
    data = job.recordings
    by_method: dict[Method, list[LiverEstimates]] = {
        "guess": [],
        "published": [],
        "ours": [],
    }
    for index in range(len(NUMBERS)):
        progress(index / len(NUMBERS))
        whole = read_liver(data, index)
        inside = whole.insertion
        before = whole.before_withdrawal
        depth = whole.depth_m[inside]
        force = whole.force_N[inside]
        course = whole.t_s[before], whole.depth_m[before], whole.force_N[before]
        reference = liver_reference(whole, depth, force)
        guess = tuple(
            GUESSED_FRICTION * whole.force_at_N(inside, mm) for mm in DEPTHS_mm
        )
        by_method["guess"].append(LiverEstimates(reference, guess))
        for method in IDENTIFIERS:
            by_method[method].append(liver_estimates(*course, method, reference))
    found: list[Measurement] = []
    for method, each in by_method.items():
        values = [
            *friction_values(each),
            *(rupture_values(each) if method != "guess" else ()),
        ]
        found += [Measurement("ft", method, name, value) for name, value in values]
    return JobResult(found)
