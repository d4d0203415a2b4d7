"""Segmentations, and what is asked of them: surfaces, layers, clearances, the body.

Labels must lie where the body, and their scan, have what they name. Names alone say
that the left kidney lies left of the right one, the liver right of the spleen, a lung
above the bladder, the spine behind the liver. And in a CT bone, lung, liver and others
have Hounsfield units of their own: labels that are mirrored, shifted or of another
patient cover voxels of other kinds, and would cover more of the right ones elsewhere.
"""

import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import permutations, product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from foundation.arrays import Array
from needleforce.anatomy.clearance import Clearance, REACH_m, VoxelBoxes
from needleforce.anatomy.errors import VolumeError
from needleforce.anatomy.path_layers import TISSUES, Layer, find_layers
from needleforce.anatomy.surface import Surface, closed_surface, join_voxels
from needleforce.anatomy.volume import (
    Grid,
    Segmentation,
    Structure,
    Volume,
    words_of,
)

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


BODY_HU = -300.0
"""Between air and fat, in Hounsfield units."""

FAT_HU = -30.0
"""Between fat and lean tissue, in Hounsfield units."""

LEAN = 1
"""Value of lean tissue, and of the whole body where fat is not separated."""

FAT = 2
"""Value of fat."""


def find_body(
    scan: Volume, *, fat: bool, progress: Callable[[float], None]
) -> NDArray[np.uint8]:
    """Return which voxels of a CT belong to the largest body, its holes filled.

    Args:
        scan: The CT.
        fat: Tell fat from lean tissue.
        progress: Called with the fraction done.

    Returns:
        0 outside of the body, `LEAN` in it, `FAT` where it is separated, (i, j, k).

    Raises:
        VolumeError: There is only air, or no air around.
    """
    import SimpleITK

    body = _largest_part(scan.values > BODY_HU)
    progress(0.5)
    air_around = np.count_nonzero(~body) - np.count_nonzero(~body[1:-1, 1:-1, 1:-1])
    if not body.any() or not air_around:
        raise VolumeError(
            f"no body in a scan of {scan.values.min():g} to {scan.values.max():g}: "
            f"expected a CT in Hounsfield units with air, below {BODY_HU:g}, around "
            "the patient (no MR, and air at -1000)"
        )
    body = _without_couch(body, scan.grid)
    # Lungs are open at the top of a scan, so holes are filled section by section.
    head_axis = int(np.abs(scan.grid.axes_m[2]).argmax())
    for section in np.moveaxis(body, head_axis, 0):
        image = SimpleITK.GetImageFromArray(section.astype(np.uint8))
        filled = SimpleITK.BinaryFillhole(image, foregroundValue=1)
        section[:] = SimpleITK.GetArrayViewFromImage(filled)
    kinds = body.astype(np.uint8)  # true is `LEAN`
    if fat:
        # Scans are noisy: the median of a voxel and the 26 around it decides.
        median = SimpleITK.Median(SimpleITK.GetImageFromArray(scan.values), [1, 1, 1])
        kinds[body & (SimpleITK.GetArrayViewFromImage(median) < FAT_HU)] = FAT
    progress(1.0)
    return kinds


def _largest_part(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which voxels belong to the largest part of a mask."""
    import SimpleITK

    image = SimpleITK.GetImageFromArray(mask.astype(np.uint8))
    parts = SimpleITK.RelabelComponent(SimpleITK.ConnectedComponent(image))
    return np.asarray(SimpleITK.GetArrayViewFromImage(parts) == 1)


def _without_couch(body: NDArray[np.bool_], grid: Grid) -> NDArray[np.bool_]:
    """Return the body without the couch, where that touches the back.

    A couch is alike in all sections, wide, and lies behind what else is.
    """
    least_common = 0.95  # of the sections have something there
    min_width_m = 0.2
    head_axis, left_axis = (int(np.abs(grid.axes_m[k]).argmax()) for k in (2, 0))
    back_axis = 3 - head_axis - left_axis
    backwards = -1 if grid.axes_m[1, back_axis] < 0.0 else 1
    # A view of the same voxels, left to right, front to back, along the body.
    ordered = body.transpose(left_axis, back_axis, head_axis)[:, ::backwards]
    labelled: Any = ndimage.label(ordered.mean(axis=2) > least_common)
    parts, count = labelled
    boxes = ndimage.find_objects(parts)
    sizes = np.bincount(parts.ravel())
    trunk_stop = boxes[sizes[1:].argmax()][1].stop if count else 0
    couches = [
        number
        for number, box in enumerate(boxes, 1)
        if (box[0].stop - box[0].start) * grid.spacing_m[left_axis] > min_width_m
        and box[1].stop > trunk_stop
    ]
    if not couches:
        return body
    # Its edges, whose voxels are half air, go with it; so does its filling.
    edged = ndimage.binary_dilation(np.isin(parts, couches))
    ordered[np.asarray(ndimage.binary_fill_holes(edged), bool)] = False
    return _largest_part(body)


def resample_nearest(
    values: NDArray[np.uint8], source: Grid, target: Grid
) -> NDArray[np.uint8]:
    """Return values on another grid, which may be flipped, cropped or finer.

    Args:
        values: On the source grid, (i, j, k).
        source: Their grid.
        target: The other grid; outside of the source the result is 0.
    """
    import SimpleITK

    # From indices of the target to those of the source.
    turn = np.linalg.inv(source.axes_m) @ target.axes_m
    shift = source.indices(target.origin_m)
    taken = SimpleITK.Resample(
        SimpleITK.GetImageFromArray(values.T),
        [int(size) for size in target.shape],
        SimpleITK.AffineTransform(turn.ravel().tolist(), shift.tolist()),
        SimpleITK.sitkNearestNeighbor,
    )
    return np.ascontiguousarray(SimpleITK.GetArrayViewFromImage(taken).T)


SHOWN_VOXEL_m = 3e-3
"""Voxels of surfaces that are looked at: finer ones add triangles that nobody sees."""

DENSE = "dense_as_bone"
"""Name of what is as dense as bone in the CT and not labelled."""


class Labels(Segmentation):
    """A segmentation; see `Segmentation` for what it holds."""

    def with_body(
        self,
        scan: Volume,
        *,
        fat: bool = False,
        progress: Callable[[float], None] = lambda fraction: None,
    ) -> "Labels":
        """Add ``body``: all that is not air around the patient, found in the CT.

        Args:
            scan: The CT.
            fat: Add two structures in place of it, ``lean`` and ``fat``.
            progress: Called with the fraction done.

        Raises:
            VolumeError: Labels that lie elsewhere than the scan shows what they name,
                only air, or no air around.
        """
        checked = self.checked_against(scan)
        kinds = find_body(scan, fat=fat, progress=progress)
        values = resample_nearest(kinds, scan.grid, self.grid)
        return checked._with_volume(values, ("lean", "fat") if fat else ("body",))

    def _with_volume(self, values: NDArray[Any], names: Sequence[str]) -> "Labels":
        """Return labels with one more volume, and structures of values from 1."""
        number = len(self.volumes)
        added = [Structure.named(name, k, number) for k, name in enumerate(names, 1)]
        structures = [*self.structures, *added]
        labels = Labels.of([*self.volumes, values], self.grid, structures)
        return replace(labels, unchecked=self.unchecked)

    def with_dense(self, scan: Volume) -> "Labels":
        """Add `DENSE`, an obstacle: what is dense as bone in the CT and not labelled.

        What ``lean``, ``fat`` or ``body`` covers counts as not labelled. Pieces smaller
        than 10 mm³, which stop no needle, are left out.

        Args:
            scan: The CT, in HU.
        """
        import SimpleITK

        min_dense_m3 = 10e-9  # smaller pieces are calcifications, or noise
        # Soft tissue, with contrast medium too, seldom exceeds it; bone and metal do.
        dense_HU = 200.0
        dense = resample_nearest(
            (scan.values > dense_HU).astype(np.uint8), scan.grid, self.grid
        )
        for item in self.structures:
            if item.name not in TISSUES:
                dense[item.box][self.mask(item.name)] = 0
        pieces = SimpleITK.ConnectedComponent(SimpleITK.GetImageFromArray(dense), True)
        min_voxels = int(np.ceil(min_dense_m3 / self.grid.voxel_m3))
        large = SimpleITK.RelabelComponent(pieces, min_voxels)
        values = (SimpleITK.GetArrayViewFromImage(large) > 0).astype(np.uint8)
        return self._with_volume(values, (DENSE,)) if values.any() else self

    def checked_against(self, scan: Volume) -> "Labels":
        """Return the same labels, checked against their scan.

        Raises:
            VolumeError: The labels do not lie where the scan shows what they name.
        """
        return replace(self, unchecked=check_against_scan(self, scan))

    def surfaces(
        self,
        names: Iterable[str] | None = None,
        progress: Callable[[float], None] = lambda fraction: None,
        *,
        voxel_m: float = 0.0,
    ) -> dict[str, Surface]:
        """Return closed surfaces by name; see `closed_surface`.

        Args:
            names: Of the structures; None for all.
            progress: Called with the fraction done.
            voxel_m: Voxels are joined as long as they do not become larger than this,
                for surfaces that are only looked at (`SHOWN_VOXEL_m`).

        Raises:
            VolumeError: No structure with voxels has one of the names.
        """
        rounding = 1e-6  # fraction of a voxel by which it may be larger
        chosen = [item.name for item in self.structures] if names is None else [*names]
        voxels = voxel_m / self.grid.spacing_m + rounding
        joined = np.maximum(voxels, 1.0).astype(int)
        surfaces: dict[str, Surface] = {}
        for name in chosen:
            surfaces[name] = closed_surface(
                name,
                join_voxels(self.mask(name), joined),
                self.grid.points_m(self.corner(name) + 0.5 * (joined - 1)),
                self.grid.axes_m * joined,
                self[name].colour,
            )
            progress(len(surfaces) / len(chosen))
        return surfaces

    def skin(self) -> Surface:
        """Return the closed surface of all that is labelled; see `with_body`."""
        inside = [self.inside().astype(np.uint8)]
        return Labels.of(inside, self.grid, [Structure.named("skin", 1)]).surfaces()[
            "skin"
        ]

    def layers_along(self, entry_m: ArrayLike, target_m: ArrayLike) -> list[Layer]:
        """Return what a straight path crosses, in order, without gaps or overlaps.

        Where structures overlap the smaller one counts. Layers thinner than about 1.5
        voxels may be missed. The stated deviations contain what the voxels' size adds.

        Args:
            entry_m: First point, (3,) in LPS.
            target_m: Last point, inside the volume.

        Raises:
            VolumeError: A point is not finite, both are the same, the target lies
                outside, or the entry more than a metre.
        """
        return find_layers(self, entry_m, target_m)

    def clearances(
        self,
        entry_m: ArrayLike,
        target_m: ArrayLike,
        names: Iterable[str] | None = None,
    ) -> list[Clearance]:
        """Return how near a path comes to structures within 0.1 m, the nearest first.

        Every voxel counts as the box that it fills. `VoxelBoxes` judges many paths
        faster; `require_clear_path` refuses one that comes too near to an obstacle.

        Args:
            entry_m: First point, (3,) in LPS.
            target_m: Last point.
            names: Of the structures; None for obstacles and structures at risk.

        Raises:
            VolumeError: No structure with voxels has one of the names.
        """
        chosen = self.at_risk() if names is None else [self[name] for name in names]
        nearest = [
            VoxelBoxes(self, one).nearest(entry_m, target_m, REACH_m) for one in chosen
        ]
        found = [one for one in nearest if one is not None]
        return sorted(found, key=lambda one: (one.distance_m, one.depth_m))
