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
from benchmarks.jobs import Figure, Job, Method, make_figures
from foundation.arrays import Array
from identification import replay

HAIR_m = 1e-4
"""A difference of depth that counts as none."""


def insertion_parts(depth_m: Array) -> tuple[slice, slice]:
    """Return insertion and withdrawal in a recording that holds in between.

    The insertion ends where the needle is within `HAIR_m` of its deepest; the
    withdrawal begins 2 mm above: friction has turned round and the tip touches nothing.
    """
    deepest = float(depth_m.max())
    deep = np.flatnonzero(depth_m >= deepest - HAIR_m)
    back = np.flatnonzero(depth_m[deep[-1] :] < deepest - 2e-3)
    out = deep[-1] + (int(back[0]) if len(back) else len(depth_m))
    return slice(0, int(deep[0]) + 1), slice(int(out), len(depth_m))


def mean_at_depth(depth_m: Array, values: Array, at_m: float) -> float:
    """Return the mean of values within 0.5 mm of a depth.

    It is nan when the needle was never there.
    """
    near = np.abs(depth_m - at_m) <= 0.5e-3
    return float(np.mean(values[near])) if near.any() else float("nan")


def read_arrays(path: Path, names: Sequence[str]) -> list[Array]:
    """Read the named arrays of an npz file.

    Raises:
        DataError: The file cannot be read, an array is missing, empty or not finite.
    """
    try:
        with np.load(path, allow_pickle=False) as content:
            has = ", ".join(content)
            arrays = {
                n: np.asarray(content[n], dtype=np.float64)
                for n in names
                if n in content
            }
    except (OSError, EOFError, BadZipFile, ValueError) as error:
        raise DataError(f"cannot read {path}: {error}") from error
    if missing := [name for name in names if name not in arrays]:
        raise DataError(f"{path} lacks {', '.join(missing)}; it has {has}")
    for name, array in arrays.items():
        if array.size == 0 or not np.isfinite(array).all():
            raise DataError(
                f"{name} of {path} is empty or has values that are not finite"
            )
    return [arrays[name] for name in names]


def read_table(path: Path) -> dict[str, Any]:
    """Read the table of numbers in a JSON file.

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
        insertion: Samples of the insertion, see `insertion_parts`.
        withdrawal: Samples of the withdrawal.
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
        """Return the mean force near a depth [mm] in a part of the recording.

        It is nan if the needle was not there. Negative during withdrawal, where
        friction holds the needle back.
        """
        return mean_at_depth(self.depth_m[part], self.force_N[part], 1e-3 * depth_mm)


def read_liver(data: Path, index: int) -> LiverInsertion:
    """Read one insertion from the folder of recordings.

    The index is one into `NUMBERS`.

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


OF_MANY = "pullout_error_p90_pct"
"""One insertion has no 90th percentile."""


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


def friction_values(
    insertions: Sequence[LiverEstimates],
) -> Iterator[tuple[str, float]]:
    """Yield the errors of the friction over insertions, and how well they are stated.

    Median and 90th percentile.
    """
    true_N = np.array([item.reference[0] for item in insertions])
    error_N = np.abs(np.array([item.friction_N for item in insertions]) - true_N)
    for name, percent in (("median", 50.0), ("p90", 90.0)):
        error_pct = float(np.percentile(100.0 * error_N / true_N, percent))
        yield f"pullout_error_{name}_pct", error_pct
    std_N = np.array([item.friction_std_N for item in insertions])
    if std_N.size and np.isfinite(std_N).all():
        is_covered = error_N <= 2.0 * std_N
        for mm, covers in zip(DEPTHS_mm, is_covered.T, strict=True):
            yield f"pullout_coverage_{mm}mm", float(np.mean(covers))


def rupture_values(insertions: Sequence[LiverEstimates]) -> Iterator[tuple[str, float]]:
    """Yield the ruptures of all insertions against the drops of the force."""
    count = len(insertions)
    ruptures = drops = alarmed = at_a_drop = 0
    for item in insertions:
        _, large, small = item.reference
        ruptures += len(item.alarms_m)
        drops += len(large)
        alarmed += at_drops(item.alarms_m, large)[1]
        at_a_drop += at_drops(item.alarms_m, small)[0]
    yield "ruptures_per_insertion", ruptures / count
    yield "drops_per_insertion", drops / count
    if drops:
        yield "drop_recall", alarmed / drops
    if ruptures:
        yield "ruptures_at_drops", at_a_drop / ruptures


def run(job: Job) -> Iterator[Figure]:
    """Run ``liver-real``: friction during insertion against the pull-out force.

    The needle is pulled out against friction alone, so the pull-out force at a depth is
    what the shaft friction was there during insertion. Methods see the insertion and
    the hold only.
    """
    data = job.recordings
    by_method: dict[Method, list[LiverEstimates]] = {
        "rule-of-thumb": [],
        "published-one-setting": [],
        "ours": [],
    }
    for index in range(len(NUMBERS)):
        whole = read_liver(data, index)
        inside = whole.insertion
        forward = whole.before_withdrawal
        depth = whole.depth_m[inside]
        force = whole.force_N[inside]
        course = whole.t_s[forward], whole.depth_m[forward], whole.force_N[forward]
        reference = liver_reference(whole, depth, force)
        # The rule of thumb: this fraction of the insertion force is friction.
        thumb = tuple(0.7 * whole.force_at_N(inside, mm) for mm in DEPTHS_mm)
        by_method["rule-of-thumb"].append(LiverEstimates(reference, thumb))
        for method in IDENTIFIERS:
            by_method[method].append(liver_estimates(*course, method, reference))
    for method, estimates in by_method.items():
        yield from make_figures(dict(friction_values(estimates)), "ft", method)
        if method != "rule-of-thumb":
            yield from make_figures(dict(rupture_values(estimates)), "ft", method)
