"""Whether labels lie where the body, and their scan, have what they name.

Names alone say that the left kidney lies left of the right one, the liver right of the
spleen, a lung above the bladder, the spine behind the liver. And in a CT bone, lung,
liver and others have Hounsfield units of their own: labels that are mirrored, shifted
or of another patient cover voxels of other kinds, and would cover more of the right
ones elsewhere.
"""

import re
from collections import defaultdict
from collections.abc import Iterator, Mapping
from itertools import permutations, product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.arrays import Array
from needleforce.anatomy.errors import VolumeError
from needleforce.anatomy.structures import Segmentation, Structure, words_of
from needleforce.anatomy.volume import Volume

HEAD_TO_FOOT = (
    frozenset(("skull", "brain")),
    frozenset(("heart", "lung", "sternum")),
    frozenset(("liver", "spleen", "kidney", "pancreas")),
    frozenset(("bladder", "prostate", "sacrum", "hip")),
)
"""Words of structures from head to foot."""

FRONT = frozenset(("liver", "heart", "sternum", "stomach", "bladder"))
"""Words of structures in front of the spine."""

SPINE = frozenset(("vertebra", "vertebrae", "spine", "sacrum"))

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


def require_body_order(labels: Segmentation, *, situs_inversus: bool = False) -> None:
    """Refuse labels whose structures lie the wrong way round.

    Args:
        labels: The segmentation, in LPS.
        situs_inversus: Liver and spleen of this patient are exchanged.

    Raises:
        VolumeError: Half the pairs of structures along an axis, or more, lie the wrong
            way round, or liver and spleen do, whatever lies beside them.
    """
    min_distance_m = 5e-3  # centroids closer than this say nothing
    places_m = {
        item.anatomy.lower(): labels.centroid_m(item.name) for item in labels.structures
    }
    situs = ("liver", "spleen") if situs_inversus else ("spleen", "liver")
    pairs = set(_expected_pairs(places_m))
    if {*situs} <= places_m.keys():
        pairs.add((0, situs))
    for axis, sides in enumerate(("left and right", "front and back", "head and feet")):
        gaps_m = {
            names: float(places_m[names[0]][axis] - places_m[names[1]][axis])
            for of_axis, names in pairs
            if of_axis == axis
        }
        wrong = [names for names, gap_m in gaps_m.items() if gap_m < -min_distance_m]
        right = sum(gap_m > min_distance_m for gap_m in gaps_m.values())
        if situs in wrong or len(wrong) >= max(right, 1):
            raise VolumeError(
                f"{len(wrong)} of {right + len(wrong)} pairs of structures lie the "
                f"wrong way round, as {' and '.join(wrong[0])}: {sides} are exchanged "
                "(an axis negated, RAS taken as LPS), or the situs inversus is not "
                "what was stated"
            )


def _expected_pairs(
    places_m: Mapping[str, Array],
) -> Iterator[tuple[int, tuple[str, str]]]:
    """Yield an axis of LPS, and two names of which the first lies further along it."""
    backs = [name for name in places_m if words_of(name) & SPINE]
    for name, place_m in places_m.items():
        other = name.replace("left", "right")
        if "left" in words_of(name) and other in places_m:
            yield 0, (name, other)
        if backs and words_of(name) & FRONT:
            heights_m = {back: abs(places_m[back][2] - place_m[2]) for back in backs}
            yield 1, (min(heights_m, key=heights_m.__getitem__), name)
    for upper, lower in permutations(places_m, 2):
        if np.less(_ranks(upper), _ranks(lower)).any():
            yield 2, (upper, lower)


def _ranks(name: str) -> list[float]:
    """Return how far from the head a structure lies, among organs and among vertebrae.

    Where it is none of them: nan.
    """
    ranks = [rank for rank, one in enumerate(HEAD_TO_FOOT) if words_of(name) & one]
    vertebra = re.search(r"(?:^|[^a-z])([ctls])(\d+)", name)
    if vertebra is None or not words_of(name) & SPINE:
        return [max(ranks, default=np.nan), np.nan]
    # Above the first cervical, thoracic, lumbar and sacral one.
    above = {"c": 0, "t": 7, "l": 19, "s": 24}[vertebra[1]]
    return [max(ranks, default=np.nan), above + int(vertebra[2])]


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
        fraction = float(np.nanmean(_shows(kind, scan, points_m)))
        if fraction < kind.least:
            raise VolumeError(
                f"of what is labelled as {kind.name} {100.0 * fraction:.0f} % lies "
                f"between {kind.low_HU:.0f} and {kind.high_HU:.0f} HU in the scan: the "
                "labels are mirrored, shifted, of another patient, or this is no CT"
            )
    # Labels that would cover so much more of the right voxels elsewhere lie wrongly.
    # Right ones lose a tenth and more when they are moved by 10 mm.
    better_fit = 0.05
    lengths_m = (9e-3, 16e-3, 24e-3, 34e-3)
    for length_m, *direction in product(lengths_m, *[(-1.0, 0.0, 1.0)] * 3):
        shift_m = length_m * np.array(direction) / max(np.linalg.norm(direction), 1.0)
        gains = [_gain(*cover, scan, shift_m) for cover in covers.items()]
        if np.mean(gains) > better_fit:
            raise VolumeError(
                f"the labels fit the scan better by {100.0 * np.mean(gains):.0f} % of "
                f"their voxels when moved by {(1e3 * shift_m).round().tolist()} mm: "
                "origin, spacing or directions of one of the files are wrong"
            )
    return ""


def _shows(kind: _Kind, scan: Volume, points_m: Array) -> Array:
    """Return 1 where a scan shows the units of a kind, 0 elsewhere, nan outside it."""
    places = scan.grid.indices(points_m)
    values_HU = scan.grid.nearest(scan.values, places, np.nan)
    is_shown = (values_HU >= kind.low_HU) & (values_HU <= kind.high_HU)
    return np.where(np.isnan(values_HU), np.nan, is_shown)


def _gain(kind: _Kind, points_m: Array, scan: Volume, shift_m: Array) -> float:
    """Return how many more voxels, as a fraction, would be right after a shift.

    Only those count that are in the scan before and after it.
    """
    gains = _shows(kind, scan, points_m + shift_m) - _shows(kind, scan, points_m)
    is_inside = np.isfinite(gains)
    return float(gains[is_inside].mean()) if is_inside.sum() >= MIN_VOXELS else 0.0


def _some_points_m(labels: Segmentation) -> dict[_Kind, Array]:
    """Return centres (n, 3) of some voxels of each kind that has enough of them."""
    max_points = 4000  # voxels of a kind that are looked at
    indices: dict[_Kind, list[NDArray[np.integer]]] = defaultdict(list)
    for item in labels.structures:
        kind = _kind_of(item)
        if kind is not None:
            corner = labels.corner(item.name)
            indices[kind].append(np.argwhere(labels.mask(item.name)) + corner)
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
    is_alike = sorted(labels.grid.shape) == sorted(scan.grid.shape)
    is_alike |= np.allclose(*extents_m, atol=tolerance_m)
    boxes = [labels.grid.corners_m(item.box) for item in labels.structures]
    indices = scan.grid.indices(np.concatenate(boxes))
    outside = float(np.maximum(-indices, indices - last_index).max())
    if (is_alike and shift > max_shift_voxels) or outside > max_outside_voxels:
        raise VolumeError(
            f"the labels' grid lies {shift:.1f} voxels beside the scan's, structures "
            f"up to {max(outside, 0.0):.0f} voxels outside it: origin, spacing or "
            "directions of one of the files are wrong, were lost when it was cropped, "
            "or the labels belong to another scan"
        )
