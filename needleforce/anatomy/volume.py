"""Scans and segmentations: which structure each voxel belongs to, and what a needle
crosses.

LPS and metres; arrays are (i, j, k) along the axes of their `Grid`. Two of them may be
stored in different orders and still agree, so only places are ever compared.

Around each point of a needle's path every voxel votes for its label, weighted by a
smooth kernel; the label with most votes holds the point. Where the winner changes is a
boundary, refined between two points. The layers therefore follow each other without
gaps or overlaps, which rays through the surfaces of neighbouring structures do not
grant.
"""

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from needleforce.anatomy.errors import Array, VolumeError, require_deviation
from needleforce.anatomy.surface import Surface, closed_surface

BODY_HU = -300.0
FAT_HU = -30.0
"""Between air and fat, and between fat and lean tissue, in Hounsfield units."""
OBSTACLES = "bone rib ribs costal cartilage cartilages vertebra vertebrae sacrum hip femur sternum"
OBSTACLES += " scapula clavicula clavicle humerus pelvis skull bones spine vertebral coccyx ribcage"
OBSTACLES += " scapulae mandible radius ulna patella tibia fibula"
SOFT = frozenset(("renal", "kidney", "artery", "vein", "muscle", "nerve"))
"""Words in the names of structures that stop a needle, and those beside which they
do not count."""
_COLOURS = {
    OBSTACLES: (241, 214, 145),
    "liver": (221, 130, 101),
    "spleen": (157, 108, 162),
    "kidney adrenal": (185, 102, 83),
    "gallbladder": (139, 150, 98),
    "stomach": (216, 132, 105),
    "pancreas": (249, 180, 111),
    "lung": (197, 165, 145),
    "aorta artery": (216, 101, 79),
    "vein vena cava vessel": (0, 151, 206),
    "bowel duodenum colon bladder": (205, 167, 142),
    "gluteus iliopsoas autochthon muscle lean": (192, 104, 88),
    "fat": (230, 220, 70),
    "body skin": (177, 122, 101),
    "lesion tumor tumour mass": (144, 238, 144),
}
"""By words in names; red, green, blue of 3D Slicer's table of generic anatomy."""

UNLABELLED = "unlabelled"  # Name of what no structure covers
WIDTH_VOXELS = 1.2
REACH_VOXELS = 3
STEP_VOXELS = 0.5
"""Of the kernel: standard deviation and reach; and the distance of points on the
path."""
MOST_OUTSIDE_m = 1.0  # The first point; beyond it the unit is not the metre
VOTE_STD = 0.105
"""Standard deviation of the difference of two votes, from the voxels' size alone: of
the analytic torso's seeds below 1000, at 1 and 3 mm."""


@dataclass(frozen=True, eq=False)
class Grid:
    """Where voxels lie: point = origin + axes @ index; whole indices are voxel
    centres.

    Attributes:
        shape: Voxels along each of three axes.
        origin_m: (3,) centre of voxel 0, 0, 0 in LPS.
        axes_m: (3, 3) columns: step from a voxel to the next along each axis.
    """

    shape: tuple[int, ...]
    origin_m: Array
    axes_m: Array

    @property
    def spacing_m(self) -> Array:
        """Distance between voxels along each axis, (3,)."""
        return np.linalg.norm(self.axes_m, axis=0)

    @property
    def voxel_m3(self) -> float:
        """Volume of a voxel."""
        return abs(float(np.linalg.det(self.axes_m)))

    def points_m(self, indices: ArrayLike) -> Array:
        """Points (..., 3) in LPS of indices (..., 3), which may lie between voxels."""
        return self.origin_m + np.asarray(indices, float) @ self.axes_m.T

    def indices(self, points_m: ArrayLike) -> Array:
        """Indices (..., 3), with fractions, of points (..., 3) in LPS."""
        return (np.asarray(points_m, float) - self.origin_m) @ np.linalg.inv(
            self.axes_m
        ).T

    def corners_m(self, box: Sequence[slice] = ()) -> Array:
        """Centres of the eight voxels in the corners, of the grid or of a box in it,
        (8, 3).
        """
        whole = [slice(0, size) for size in self.shape]
        return self.points_m(
            list(product(*((part.start, part.stop - 1) for part in box or whole)))
        )


@dataclass(frozen=True, eq=False)
class Volume:
    """A scan: one number per voxel, of a CT in Hounsfield units.

    Attributes:
        values: (i, j, k).
    """

    values: NDArray[Any]
    grid: Grid


@dataclass(frozen=True)
class Structure:
    """One labelled structure of a segmentation.

    Attributes:
        value: Of its voxels.
        colour: red, green, blue from 0 to 1.
        is_obstacle: Bone or cartilage.
        volume: In which label volume it lies: segments that overlap need several.
        box: Around its voxels.
    """

    name: str
    value: int
    colour: tuple[float, ...]
    is_obstacle: bool = False
    volume: int = 0
    voxels: int = 0
    box: tuple[slice, ...] = ()

    @classmethod
    def named(cls, name: str, value: int, volume: int = 0) -> "Structure":
        """Return a structure whose colour, and whether it stops a needle, its name
        implies.
        """
        stated = words(name)
        stated -= set(OBSTACLES.split()) if stated & SOFT else set()
        fitting = [
            colour for key, colour in _COLOURS.items() if stated & set(key.split())
        ]
        shade = (
            0.618 * value
        ) % 1.0  # golden ratio: no two numbers close by look alike
        colour = (
            fitting[0]
            if fitting
            else (90 + 150 * shade, 200 - 60 * shade, 240 - 150 * shade)
        )
        stops = bool(stated & set(OBSTACLES.split()))
        return cls(name, value, tuple(part / 255.0 for part in colour), stops, volume)


@dataclass(frozen=True)
class Layer:
    """A stretch of the path inside one structure; depths along the needle from the
    entry point.

    Attributes:
        name: Of the structure, or `UNLABELLED`.
        entry_m: Depth at which the needle enters it.
        exit_m: Depth at which it leaves it: the next layer's entry.
        entry_std_m: Standard deviation of the former, 0 at the path's first point.
        exit_std_m: Of the latter, 0 at the path's last point.
        is_obstacle: Bone or cartilage.
    """

    name: str
    entry_m: float
    exit_m: float
    entry_std_m: float
    exit_std_m: float
    is_obstacle: bool


@dataclass(frozen=True, eq=False)
class Labels:
    """A segmentation: label volumes on one grid, and what their values mean.

    Attributes:
        volumes: Each (i, j, k); 0 is no structure.
        structures: Those with voxels.
    """

    volumes: Sequence[NDArray[np.integer]]
    grid: Grid
    structures: tuple[Structure, ...]

    @classmethod
    def of(
        cls,
        volumes: Sequence[NDArray[Any]],
        grid: Grid,
        structures: Iterable[Structure],
    ) -> "Labels":
        """Count the voxels of each structure; those without any are left out.

        Raises:
            VolumeError: No structure has a voxel, or two have the same name.
        """
        boxes = [dict(enumerate(ndimage.find_objects(volume), 1)) for volume in volumes]
        found: dict[str, Structure] = {}
        for item in structures:
            if item.name in found:
                raise VolumeError(f"two structures are named {item.name!r}: rename one")
            if (box := boxes[item.volume].get(item.value)) is not None:
                voxels = np.count_nonzero(volumes[item.volume][box] == item.value)
                found[item.name] = replace(item, voxels=int(voxels), box=box)
        if not found:
            raise VolumeError("no voxel is labelled: expected at least one structure")
        return cls(volumes, grid, tuple(found.values()))

    def __getitem__(self, name: str) -> Structure:
        named = {item.name: item for item in self.structures}
        if name not in named:
            there = ", ".join(named)
            raise VolumeError(
                f"no structure with voxels is named {name!r}; there are {there}"
            )
        return named[name]

    def mask(self, name: str) -> NDArray[np.bool_]:
        """Which voxels belong to a structure, (i, j, k) in the structure's box."""
        structure = self[name]
        return self.volumes[structure.volume][structure.box] == structure.value

    def centroid_m(self, name: str) -> Array:
        """Mean place of a structure's voxels in LPS, (3,)."""
        start = [part.start for part in self[name].box]
        return self.grid.points_m(np.argwhere(self.mask(name)).mean(axis=0) + start)

    def with_body(self, scan: Volume, *, fat: bool = False) -> "Labels":
        """Add ``body``: all that is not air around the patient, found in the CT.

        With ``fat`` it comes as two structures, ``lean`` and ``fat``.

        Raises:
            VolumeError: Labels that lie elsewhere than the scan, only air, or no air
                around.
        """
        require_agreement(self, scan)
        parts: NDArray[np.int32] = np.zeros(scan.grid.shape, np.int32)
        count = ndimage.label(scan.values > BODY_HU, output=parts)
        inside = (parts == np.bincount(parts[parts > 0], minlength=1).argmax()) & (
            parts > 0
        )
        inner = inside[1:-1, 1:-1, 1:-1]
        if not count or inside.sum() - inner.sum() == inside.size - inner.size:
            raise VolumeError(
                f"no body in a scan of {scan.values.min():g} to {scan.values.max():g}: expected a "
                f"CT in Hounsfield units with air, below {BODY_HU:g}, around the patient"
            )
        head = int(
            np.abs(scan.grid.axes_m[2]).argmax()
        )  # lungs are open at the top of a scan
        for section in np.moveaxis(inside, head, 0):
            section[:] = ndimage.binary_fill_holes(section)
        kinds = inside.astype(np.uint8)
        if fat:  # among the neighbours, not in every voxel: scans are noisy
            kinds += inside & (ndimage.median_filter(scan.values, 3) < FAT_HU)
        # Each of our voxels takes the scan's nearest: grids may be flipped, cropped or
        # finer.
        first = scan.grid.indices(self.grid.origin_m).tolist()
        steps = np.linalg.solve(scan.grid.axes_m, self.grid.axes_m)
        body = ndimage.affine_transform(
            kinds, steps, first, self.grid.shape, order=0, mode="grid-constant"
        )
        names = ("lean", "fat") if fat else ("body",)
        extra = [
            Structure.named(name, k, len(self.volumes))
            for k, name in enumerate(names, 1)
        ]
        return Labels.of([*self.volumes, body], self.grid, (*self.structures, *extra))

    def surfaces(
        self,
        names: Iterable[str] | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> dict[str, Surface]:
        """Closed surfaces by name, of all structures or those named; see
        `closed_surface`.

        ``progress`` gets the fraction done.

        Raises:
            VolumeError: No structure with voxels has one of the names.
        """
        wanted = (
            [item.name for item in self.structures] if names is None else list(names)
        )
        found = {}
        for name in wanted:
            item = self[name]
            mask = self.mask(name)
            corner_m = self.grid.points_m([part.start for part in item.box])
            found[name] = closed_surface(
                name, mask, corner_m, self.grid.axes_m, item.colour
            )
            if progress is not None:
                progress(len(found) / len(wanted))
        return found

    def layers_along(
        self, entry_m: ArrayLike, target_m: ArrayLike, boundary_std_m: float = 0.0
    ) -> list[Layer]:
        """Return what a straight path crosses, in order, without gaps or overlaps.

        Where structures overlap the smaller one counts. Layers thinner than about 1.5
        voxels may be missed.

        Args:
            entry_m: First point, (3,) in LPS.
            target_m: Last point, inside the volume.
            boundary_std_m: Standard deviation of the segmentation's boundaries along
                their normals. The stated deviations hold what the voxels' size brings,
                and this.

        Raises:
            VolumeError: A point is not finite, both are the same, the target lies
                outside, or the entry more than a metre; a deviation that is negative or
                in millimetres.
        """
        if boundary_std_m != 0.0:
            require_deviation("boundary_std_m", boundary_std_m, VolumeError)
        entry = np.asarray(entry_m, float)
        target = np.asarray(target_m, float)
        if (
            entry.shape != (3,)
            or target.shape != (3,)
            or not np.all(np.isfinite([entry, target]))
        ):
            given = f"entry {entry_m} and target {target_m}"
            raise VolumeError(f"{given}: expected two points of 3 numbers")
        first, last = self.grid.indices(np.array([entry, target]))
        if np.any(last < -0.5) or np.any(last > np.array(self.grid.shape) - 0.5):
            raise VolumeError(f"the target {target.tolist()} m lies outside the volume")
        beyond_m = np.maximum(-first, first - self.grid.shape) * self.grid.spacing_m
        if beyond_m.max() > MOST_OUTSIDE_m:
            raise VolumeError(
                f"the entry {entry.tolist()} lies {beyond_m.max():.3g} m outside the volume: "
                "expected metres, not millimetres"
            )
        length_m = float(np.linalg.norm(target - entry))
        steps = np.linalg.norm(last - first)
        if steps == 0.0:
            raise VolumeError(f"entry and target are the same point {entry.tolist()}")
        at = np.linspace(0.0, 1.0, int(np.ceil(steps / STEP_VOXELS)) + 1)
        votes, kinds = _votes(self, first + at[:, None] * (last - first))
        winners = votes.argmax(axis=1)
        (i,) = np.nonzero(np.diff(winners))
        left = winners[i]
        right = winners[i + 1]
        # The winner leads before a boundary and trails behind it.
        lead_m = np.diff(at)[i] * length_m
        lead = votes[i, left] - votes[i, right]
        trail = votes[i + 1, right] - votes[i + 1, left]
        fall = np.maximum(lead + trail, 1e-9)
        cuts_m = at[i] * length_m + lead_m * lead / fall
        cuts = first + (cuts_m / length_m)[:, None] * (last - first)
        steepest_1_m = (
            _steepest_1_m(self, cuts, left, right) if boundary_std_m and len(i) else 0.0
        )
        std_m = np.hypot(VOTE_STD, boundary_std_m * steepest_1_m) * lead_m / fall
        depths = pairwise([0.0, *cuts_m.tolist(), length_m])
        deviations = pairwise([0.0, *np.minimum(std_m, length_m).tolist(), 0.0])
        return [
            Layer(kinds[rank][0], *depth, *std, kinds[rank][1])
            for rank, depth, std in zip(
                winners[[0, *(i + 1)]], depths, deviations, strict=True
            )
        ]


def words(name: str) -> set[str]:
    """The words of a structure's name, in small letters."""
    return set(re.split(r"[\W_]+", name.lower()))


def require_agreement(labels: Labels, scan: Volume) -> None:
    """Refuse labels on a grid as large as the scan's elsewhere, or with voxels
    outside the scan.
    """
    last = np.array(scan.grid.shape) - 1.0
    corners = scan.grid.indices(labels.grid.corners_m())
    off = float(np.minimum(np.abs(corners), np.abs(corners - last)).max())
    extents = (
        np.sort(np.ptp(grid.corners_m(), axis=0)) for grid in (labels.grid, scan.grid)
    )
    is_as_large = np.allclose(*extents, atol=0.1 * scan.grid.spacing_m.min())
    if (
        is_as_large or sorted(labels.grid.shape) == sorted(scan.grid.shape)
    ) and off > 0.1:
        raise VolumeError(
            f"the labels' grid is as large as the scan's and lies {off:.1f} voxels beside it: "
            "origin, spacing or directions of one of the files are wrong"
        )
    for item in labels.structures:
        found = scan.grid.indices(labels.grid.corners_m(item.box))
        if (off := float(np.maximum(-found, found - last).max())) > 1.0:
            raise VolumeError(
                f"{item.name} lies {off:.0f} voxels outside the scan: the labels belong to another "
                "scan, or lost their origin when they were cropped"
            )


def _votes(labels: Labels, indices: Array) -> tuple[Array, list[tuple[str, bool]]]:
    """Votes at points (n, 3), (n, 1 + structures), rows sum to 1; of what: name, if an
    obstacle.

    Where structures overlap the last, which is the smallest, holds the voxel. The
    kernel, a Gaussian times 5/2 - r^2 / 2, has no second moment: it keeps boundaries
    that curve in place where a Gaussian would pull them inwards (Wand and Schucany
    1990).
    """
    offsets = np.arange(-REACH_VOXELS, REACH_VOXELS + 1)
    voxels = np.rint(indices).astype(int)[:, :, None] + offsets  # (n, 3, 7)
    squares = ((voxels - indices[:, :, None]) / WIDTH_VOXELS) ** 2
    weights = _outer(np.multiply, np.exp(-0.5 * squares)) * (
        2.5 - 0.5 * _outer(np.add, squares)
    )
    weights /= weights.sum(axis=(1, 2, 3), keepdims=True)
    inside = (voxels >= 0) & (voxels < np.array(labels.grid.shape)[:, None])
    i, j, k = np.moveaxis(np.where(inside, voxels, 0), 1, 0)
    places = i[:, :, None, None], j[:, None, :, None], k[:, None, None, :]
    ranked = sorted(labels.structures, key=lambda item: -item.voxels)
    found = np.zeros(weights.shape, np.intp)
    for number, volume in enumerate(labels.volumes):
        values = {
            item.value: rank
            for rank, item in enumerate(ranked, 1)
            if item.volume == number
        }
        table = np.zeros(max(values, default=0) + 2, np.intp)  # from label to rank
        table[list(values)] = list(values.values())
        np.maximum(found, table[np.clip(volume[places], 0, len(table) - 1)], out=found)
    found *= _outer(np.logical_and, inside)  # outside the volume is no structure
    count = len(indices)
    size = 1 + len(ranked)
    found += size * np.arange(count)[:, None, None, None]
    votes = np.bincount(found.ravel(), weights.ravel(), count * size)
    kinds = [(UNLABELLED, False), *((item.name, item.is_obstacle) for item in ranked)]
    return votes.reshape(count, size).astype(float, copy=False), kinds


def _steepest_1_m(
    labels: Labels, cuts: Array, left: NDArray[np.intp], right: NDArray[np.intp]
) -> Array:
    """By how much the lead falls per metre along the boundaries' normals at these
    indices (n, 3).

    Across a flat boundary it falls by 2 k(0) a voxel, k the kernel in one dimension;
    how long a voxel is there depends on the normal.
    """
    around = cuts[:, None] + 0.5 * np.vstack((np.eye(3), -np.eye(3)))
    votes, kinds = _votes(labels, around.reshape(-1, 3))
    each = votes.reshape(len(cuts), 6, len(kinds))
    rows = np.arange(len(cuts))
    lead = each[rows, :, left] - each[rows, :, right]
    fall = lead[:, :3] - lead[:, 3:]
    per_voxel = np.maximum(np.linalg.norm(fall, axis=1), 1e-9)
    voxels_1_m = (
        np.linalg.norm(fall @ np.linalg.inv(labels.grid.axes_m), axis=1) / per_voxel
    )
    return 3.0 / (np.sqrt(2.0 * np.pi) * WIDTH_VOXELS) * voxels_1_m


def _outer(combine: np.ufunc, parts: NDArray[Any]) -> NDArray[Any]:
    """Combine what belongs to three axes, (n, 3, m), for each voxel of a cube, (n,
    m, m, m).
    """
    x, y, z = np.moveaxis(parts, 1, 0)
    return combine(
        combine(x[:, :, None, None], y[:, None, :, None]), z[:, None, None, :]
    )
