"""Whether labels lie where their scan shows what they name.

Bone, lung, liver and others have Hounsfield units of their own. Labels that are
mirrored, shifted or of another patient cover voxels of other kinds; and they would
cover more of the right ones elsewhere.
"""

from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.arrays import Array
from needleforce.anatomy.errors import VolumeError
from needleforce.anatomy.segmentation import Segmentation
from needleforce.anatomy.structures import Structure, words_of
from needleforce.anatomy.volume import Volume

MIN_VOXELS = 50
"""Kinds with fewer voxels are not judged: all of them lie at an edge."""


class _Kind(NamedTuple):
    """What a kind of structure shows in a CT.

    Attributes:
        name: Of the kind.
        low_HU: Least Hounsfield units of its voxels.
        high_HU: Largest of them.
        least: Fraction of its voxels that must lie between these: edges, noise and
            disease take the rest.
    """

    name: str
    low_HU: float
    high_HU: float
    least: float

    def holds(self, values_HU: Array) -> NDArray[np.bool_]:
        """Return which values are those of the kind."""
        return (values_HU >= self.low_HU) & (values_HU <= self.high_HU)


# Marrow of the old has 60 HU and more, a bone's surface at 3 mm voxels, too.
BONE = _Kind("bone", 60.0, 4000.0, 0.62)

MUSCLE = _Kind("muscle", -100.0, 250.0, 0.6)

KINDS = {
    "lung": _Kind("lung", -1100.0, -350.0, 0.6),
    "liver": _Kind("liver", -50.0, 250.0, 0.75),
    "spleen": _Kind("spleen", -40.0, 300.0, 0.7),
    "kidney": _Kind("kidney", -40.0, 400.0, 0.65),
    **dict.fromkeys(("muscle", "gluteus", "autochthon", "iliopsoas"), MUSCLE),
    "aorta": _Kind("aorta", -20.0, 700.0, 0.7),
    "fat": _Kind("fat", -250.0, -20.0, 0.65),
}
"""Kinds by words in the names of structures, the first one counts; contrast agent
raises vessels, spleen and kidneys."""

MIXED = frozenset(
    ("cartilage", "cartilages", "lesion", "tumor", "tumour", "cyst", "nodule", "vessel")
)
"""Words of structures that may show anything, whatever else their names say."""


def check_against_scan(labels: Segmentation, scan: Volume) -> str:
    """Refuse labels that do not lie where their scan shows what they name.

    Returns:
        What could not be checked; empty if all was.

    Raises:
        VolumeError: Their grid is as large as the scan's and lies elsewhere, a
            structure lies outside the scan, Hounsfield units are not those of the
            structures, or they would be in another place.
    """
    _require_place(labels, scan)
    covers = _some_points_m(labels)
    if not covers:
        return (
            "labels not checked against the scan: none is named as bone, lung, liver "
            "or another structure of known Hounsfield units"
        )
    for kind, points_m in covers.items():
        values_HU = _values_HU(scan, points_m)
        fraction = float(kind.holds(values_HU).mean())
        if fraction < kind.least:
            raise VolumeError(
                f"what is labelled as {kind.name} has a median of "
                f"{np.median(values_HU):.0f} HU in the scan, {100.0 * fraction:.0f} % "
                f"of it lies between {kind.low_HU:.0f} and {kind.high_HU:.0f} HU: the "
                "labels are mirrored, shifted, of another patient, or this is no CT"
            )
    # Labels that would cover so much more of the right voxels elsewhere lie wrongly.
    # Right ones lose a tenth and more when they are moved by 10 mm.
    better_fit = 0.05
    lengths_m = (9e-3, 16e-3, 24e-3, 34e-3)
    for length_m, *direction in product(lengths_m, *[(-1.0, 0.0, 1.0)] * 3):
        shift_m = length_m * np.array(direction) / max(np.linalg.norm(direction), 1.0)
        gain = np.mean([_gain(*cover, scan, shift_m) for cover in covers.items()])
        if gain > better_fit:
            raise VolumeError(
                f"the labels fit the scan better by {100.0 * gain:.0f} % of their "
                f"voxels when they are moved by {(1e3 * shift_m).round().tolist()} mm: "
                "origin, spacing or directions of one of the files are wrong"
            )
    return ""


def _values_HU(scan: Volume, points_m: Array) -> Array:
    """Return what a scan shows at points (n, 3); outside of it -inf."""
    return scan.grid.nearest(scan.values, scan.grid.indices(points_m), -np.inf)


def _gain(kind: _Kind, points_m: Array, scan: Volume, shift_m: Array) -> float:
    """Return how many more voxels, as a fraction, would be right after a shift.

    Only those count that are in the scan after it, too.
    """
    shifted_HU = _values_HU(scan, points_m + shift_m)
    is_inside = np.isfinite(shifted_HU)
    if is_inside.sum() < MIN_VOXELS:
        return 0.0
    now_HU = _values_HU(scan, points_m)
    gains = kind.holds(shifted_HU).astype(float) - kind.holds(now_HU)
    return float(gains[is_inside].mean())


def _some_points_m(labels: Segmentation) -> dict[_Kind, Array]:
    """Return centres (n, 3) of some voxels of each kind that has enough of them."""
    max_points = 4000  # voxels of a kind that are looked at
    indices: dict[_Kind, list[NDArray[np.integer]]] = {}
    for item in labels.structures:
        kind = _kind_of(item)
        if kind is not None:
            voxels = np.argwhere(labels.mask(item.name)) + labels.corner(item.name)
            indices.setdefault(kind, []).append(voxels)
    joined = {kind: np.concatenate(voxels) for kind, voxels in indices.items()}
    return {
        kind: labels.grid.points_m(voxels[:: max(len(voxels) // max_points, 1)])
        for kind, voxels in joined.items()
        if len(voxels) >= MIN_VOXELS
    }


def _kind_of(item: Structure) -> _Kind | None:
    """Return the kind of a structure by its name; None for those of no kind."""
    words = words_of(item.anatomy)
    if words & MIXED:
        return None
    if item.is_obstacle:
        return BONE
    return next((kind for word, kind in KINDS.items() if word in words), None)


def _require_place(labels: Segmentation, scan: Volume) -> None:
    """Refuse labels that do not lie where their scan does."""
    max_outside_voxels = 1.0  # labels may lie so far outside: a resampled edge
    # Grids of one size that differ by more lie beside each other.
    max_shift_voxels = 0.1
    last_index = np.array(scan.grid.shape) - 1.0
    corners = scan.grid.indices(labels.grid.corners_m())
    shift = float(np.minimum(np.abs(corners), np.abs(corners - last_index)).max())
    extents_m = [
        np.sort(np.ptp(grid.corners_m(), axis=0)) for grid in (labels.grid, scan.grid)
    ]
    tolerance_m = max_shift_voxels * scan.grid.spacing_m.min()
    is_as_large = np.allclose(*extents_m, atol=tolerance_m)
    has_as_many = sorted(labels.grid.shape) == sorted(scan.grid.shape)
    if (is_as_large or has_as_many) and shift > max_shift_voxels:
        raise VolumeError(
            f"the labels' grid is as large as the scan's and lies {shift:.1f} voxels "
            "beside it: origin, spacing or directions of one of the files are wrong"
        )
    for item in labels.structures:
        indices = scan.grid.indices(labels.grid.corners_m(item.box))
        outside = float(np.maximum(-indices, indices - last_index).max())
        if outside > max_outside_voxels:
            raise VolumeError(
                f"{item.name} lies {outside:.0f} voxels outside the scan: the labels "
                "belong to another scan, or lost their origin when they were cropped"
            )
