"""Whether labels lie where their scan shows what they name.

Bone, lung, liver and others have Hounsfield units of their own. Labels that are
mirrored, shifted or of another patient cover voxels of other kinds; and they would
cover more of the right ones elsewhere.
"""

from collections.abc import Iterator, Sequence
from itertools import product
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from foundation.arrays import Array
from needleforce.anatomy.errors import LABELS_OF_SCAN, VolumeError
from needleforce.anatomy.structures import Structure, words_of
from needleforce.anatomy.volume import Grid, Volume

NO_SCAN = "labels not checked against a scan: none was given"
"""What is said of labels that were read alone."""

NOTHING_TO_CHECK = (
    "labels not checked against the scan: none is named as bone, lung, liver or "
    "another structure of known Hounsfield units"
)
"""What is said of labels whose names say nothing about their Hounsfield units."""

MIN_VOXELS = 50
"""Kinds with fewer voxels are not judged: all of them lie at an edge."""


MM_PER_M = 1e3


class CheckedLabels(Protocol):
    """What the check reads of labels."""

    @property
    def grid(self) -> Grid:
        """Where the voxels lie."""
        ...

    @property
    def structures(self) -> tuple[Structure, ...]:
        """Structures with voxels."""
        ...

    def mask(self, name: str) -> NDArray[np.bool_]:
        """Return which voxels in a structure's box belong to it, (i, j, k)."""
        ...


class _Kind(NamedTuple):
    """What a kind of structure shows in a CT.

    Attributes:
        name: In messages.
        words: In the names of its structures.
        low_HU: Least Hounsfield units of its voxels.
        high_HU: Largest of them.
        least: Fraction of its voxels that must lie between these: edges, noise and
            disease take the rest.
    """

    name: str
    words: frozenset[str]
    low_HU: float
    high_HU: float
    least: float


BONE = _Kind("bone", frozenset(), 60.0, 4000.0, 0.62)
"""Marrow of the old has 60 HU and more, a bone's surface at 3 mm voxels, too."""

KINDS = (
    _Kind("lung", frozenset(("lung",)), -1100.0, -350.0, 0.6),
    _Kind("liver", frozenset(("liver",)), -50.0, 250.0, 0.75),
    _Kind("spleen", frozenset(("spleen",)), -40.0, 300.0, 0.7),
    _Kind("kidney", frozenset(("kidney",)), -40.0, 400.0, 0.65),
    _Kind(
        "muscle",
        frozenset(("muscle", "gluteus", "autochthon", "iliopsoas")),
        -100.0,
        250.0,
        0.6,
    ),
    _Kind("aorta", frozenset(("aorta",)), -20.0, 700.0, 0.7),
    _Kind("fat", frozenset(("fat",)), -250.0, -20.0, 0.65),
)
"""Kinds by words in names; contrast agent raises vessels, spleen and kidneys."""

MIXED = frozenset(
    ("cartilage", "cartilages", "lesion", "tumor", "tumour", "cyst", "nodule", "vessel")
)
"""Words of structures that may show anything, whatever else their names say."""


class _Cover(NamedTuple):
    """The voxels of a kind.

    Attributes:
        kind: The kind.
        points_m: Centres of some of its voxels, (n, 3) in LPS.
    """

    kind: _Kind
    points_m: Array

    def values_HU(self, scan: Volume, shift_m: Array) -> NDArray[np.floating]:
        """Return what a scan shows there, after a shift; outside of it -inf."""
        index = np.rint(scan.grid.indices(self.points_m + shift_m)).astype(int)
        is_inside = np.all((index >= 0) & (index < scan.grid.shape), axis=1)
        voxels = tuple(np.where(is_inside[:, None], index, 0).T)
        return np.where(is_inside, scan.values[voxels].astype(float), -np.inf)

    def are_right(self, values_HU: NDArray[np.floating]) -> NDArray[np.bool_]:
        """Return which values are those of the kind."""
        return (values_HU >= self.kind.low_HU) & (values_HU <= self.kind.high_HU)

    def gain(self, scan: Volume, shift_m: Array) -> float:
        """Return how many more voxels, as a fraction, would be right after a shift.

        Only those count that are in the scan after it, too.
        """
        shifted_HU = self.values_HU(scan, shift_m)
        is_inside = np.isfinite(shifted_HU)
        if is_inside.sum() < MIN_VOXELS:
            return 0.0
        now_HU = self.values_HU(scan, np.zeros(3))[is_inside]
        shifted_fraction = self.are_right(shifted_HU[is_inside]).mean()
        return float(shifted_fraction - self.are_right(now_HU).mean())


def check_against_scan(labels: CheckedLabels, scan: Volume) -> str:
    """Refuse labels that do not lie where their scan shows what they name.

    Returns:
        What could not be checked; empty if all was.

    Raises:
        VolumeError: Their grid is as large as the scan's and lies elsewhere, a
            structure lies outside the scan, Hounsfield units are not those of the
            structures, or they would be in another place.
    """
    _require_place(labels, scan)
    covers = list(_find_covers(labels))
    if not covers:
        return NOTHING_TO_CHECK
    still = np.zeros(3)
    for cover in covers:
        kind = cover.kind
        values_HU = cover.values_HU(scan, still)
        fraction = float(cover.are_right(values_HU).mean())
        if fraction < kind.least:
            median_HU = np.median(values_HU)
            raise VolumeError(
                f"what is labelled as {kind.name} has a median of {median_HU:.0f} HU "
                f"in the scan, and only {100.0 * fraction:.0f} % of it lies between "
                f"{kind.low_HU:.0f} and {kind.high_HU:.0f} HU: the labels are mirrored "
                "or shifted, of another patient, or the scan is no CT",
                LABELS_OF_SCAN,
            )
    _require_best_place(covers, scan)
    return ""


def _require_best_place(covers: Sequence[_Cover], scan: Volume) -> None:
    """Refuse labels that would fit better after a shift."""
    # Labels that would cover so much more of the right voxels elsewhere lie wrongly.
    # Right ones lose a tenth and more when they are moved by 10 mm.
    better_fit = 0.05
    directions = [np.array(signs) for signs in product((-1, 0, 1), repeat=3)]
    shifts_m = [
        length_m * direction / np.linalg.norm(direction)
        for length_m in (9e-3, 16e-3, 24e-3, 34e-3)
        for direction in directions
        if direction.any()
    ]
    gains = [
        float(np.mean([cover.gain(scan, shift_m) for cover in covers]))
        for shift_m in shifts_m
    ]
    best = int(np.argmax(gains))
    if gains[best] > better_fit:
        shift_mm = np.round(MM_PER_M * shifts_m[best]).astype(int).tolist()
        raise VolumeError(
            f"the labels fit the scan better by {100.0 * gains[best]:.0f} "
            f"% of their voxels when they are moved by {shift_mm} mm: origin, spacing "
            "or directions of one of the files are wrong",
            LABELS_OF_SCAN,
        )


def _find_covers(labels: CheckedLabels) -> Iterator[_Cover]:
    """Yield the voxels of each kind that has enough of them."""
    for kind in (BONE, *KINDS):
        structures = [item for item in labels.structures if _kind_of(item) is kind]
        if sum(item.voxels for item in structures) < MIN_VOXELS:
            continue
        yield _Cover(kind, labels.grid.points_m(_spread_voxels(labels, structures)))


def _spread_voxels(
    labels: CheckedLabels, structures: Sequence[Structure]
) -> NDArray[np.intp]:
    """Return the indices (n, 3) of every so many-th voxel of structures."""
    max_points = 4000  # voxels of a kind that are looked at
    step = max(sum(item.voxels for item in structures) // max_points, 1)
    passed = 0
    chosen: list[NDArray[np.intp]] = []
    for item in structures:
        mask = labels.mask(item.name)
        voxels = np.flatnonzero(mask)
        index = np.unravel_index(voxels[-passed % step :: step], mask.shape)
        chosen.append(np.column_stack(index) + [side.start for side in item.box])
        passed += len(voxels)
    return np.concatenate(chosen)


def _kind_of(item: Structure) -> _Kind | None:
    """Return the kind of a structure by its name; None for those of no kind."""
    words = words_of(item.anatomy)
    if words & MIXED:
        return None
    if item.is_obstacle:
        return BONE
    kinds = [kind for kind in KINDS if words & kind.words]
    return kinds[0] if kinds else None


def _require_place(labels: CheckedLabels, scan: Volume) -> None:
    """Refuse labels that do not lie where their scan does.

    Raises:
        VolumeError: Their grid is as large as the scan's and lies elsewhere, or a
            structure lies outside the scan.
    """
    # By so much labels may lie outside their scan: a resampled edge.
    max_outside_voxels = 1.0
    # Grids of one size that differ by more lie beside each other.
    max_shift_voxels = 0.1
    last_index = np.array(scan.grid.shape) - 1.0
    corners = scan.grid.indices(labels.grid.corners_m())
    shift = float(np.minimum(np.abs(corners), np.abs(corners - last_index)).max())
    labels_extent_m, scan_extent_m = (
        np.sort(np.ptp(grid.corners_m(), axis=0)) for grid in (labels.grid, scan.grid)
    )
    tolerance_m = max_shift_voxels * scan.grid.spacing_m.min()
    is_as_large = np.allclose(labels_extent_m, scan_extent_m, atol=tolerance_m)
    has_as_many = sorted(labels.grid.shape) == sorted(scan.grid.shape)
    if (is_as_large or has_as_many) and shift > max_shift_voxels:
        raise VolumeError(
            f"the labels' grid is as large as the scan's and lies {shift:.1f} voxels "
            "beside it: origin, spacing or directions of one of the files are wrong",
            LABELS_OF_SCAN,
        )
    for item in labels.structures:
        indices = scan.grid.indices(labels.grid.corners_m(item.box))
        outside = float(np.maximum(-indices, indices - last_index).max())
        if outside > max_outside_voxels:
            raise VolumeError(
                f"{item.name} lies {outside:.0f} voxels outside the scan: the labels "
                "belong to another scan, or lost their origin when they were cropped",
                LABELS_OF_SCAN,
            )
