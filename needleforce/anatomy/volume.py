"""Scans and segmentations: where each voxel lies and which structure it belongs to.

LPS and metres; arrays are (i, j, k) along the axes of their `Grid`. Two of them may be stored in
different orders and still agree, so only places are ever compared.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from needleforce.anatomy.errors import Array, VolumeError
from needleforce.anatomy.path_layers import layers_on_path
from needleforce.anatomy.surface import Surface, surface_of

BODY_HU, FAT_HU = -300.0, -30.0
"""Between air and fat, and between fat and lean tissue, in Hounsfield units."""
OBSTACLES = "bone rib ribs costal cartilage cartilages vertebra vertebrae sacrum hip femur sternum"
OBSTACLES += " scapula clavicula clavicle humerus pelvis skull"
"""Words in the names of structures that stop a needle."""
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


@dataclass(frozen=True, eq=False)
class Grid:
    """Where voxels lie: point = origin + axes @ index; whole indices are voxel centres."""

    shape: tuple[int, ...]  # voxels along each of three axes
    origin_m: Array  # (3,) centre of voxel 0, 0, 0 in LPS
    axes_m: Array  # (3, 3) columns: step from a voxel to the next along each axis

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
        return (np.asarray(points_m, float) - self.origin_m) @ np.linalg.inv(self.axes_m).T

    def corners_m(self, box: Sequence[slice] = ()) -> Array:
        """Centres of the eight voxels in the corners, of the grid or of a box in it, (8, 3)."""
        whole = [slice(0, size) for size in self.shape]
        return self.points_m(list(product(*((part.start, part.stop - 1) for part in box or whole))))


@dataclass(frozen=True, eq=False)
class Volume:
    """A scan: one number per voxel, of a CT in Hounsfield units."""

    values: NDArray[Any]  # (i, j, k)
    grid: Grid


@dataclass(frozen=True)
class Structure:
    """One labelled structure of a segmentation."""

    name: str
    value: int  # of its voxels
    colour: tuple[float, ...]  # red, green, blue from 0 to 1
    is_obstacle: bool = False  # bone or cartilage
    volume: int = 0  # in which label volume it lies: segments that overlap need several
    voxels: int = 0
    box: tuple[slice, ...] = ()  # around its voxels

    @classmethod
    def named(cls, name: str, value: int, volume: int = 0) -> "Structure":
        """Return a structure whose colour, and whether it stops a needle, its name implies."""
        words = set(name.lower().replace("-", "_").replace(" ", "_").split("_"))
        fitting = [colour for key, colour in _COLOURS.items() if words & set(key.split())]
        shade = (0.618 * value) % 1.0  # golden ratio: no two numbers close by look alike
        colour = fitting[0] if fitting else (90 + 150 * shade, 200 - 60 * shade, 240 - 150 * shade)
        stops = bool(words & set(OBSTACLES.split()))
        return cls(name, value, tuple(part / 255.0 for part in colour), stops, volume)


@dataclass(frozen=True, eq=False)
class Labels:
    """A segmentation: label volumes on one grid, and what their values mean."""

    volumes: Sequence[NDArray[np.integer]]  # each (i, j, k); 0 is no structure
    grid: Grid
    structures: tuple[Structure, ...]  # those with voxels

    @classmethod
    def of(
        cls, volumes: Sequence[NDArray[Any]], grid: Grid, structures: Iterable[Structure]
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
            raise VolumeError(f"no structure with voxels is named {name!r}; there are {there}")
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
            VolumeError: Labels that lie elsewhere than the scan, only air, or no air around.
        """
        require_agreement(self, scan)
        parts: NDArray[np.int32] = np.zeros(scan.grid.shape, np.int32)
        count = ndimage.label(scan.values > BODY_HU, output=parts)
        inside = (parts == np.bincount(parts[parts > 0], minlength=1).argmax()) & (parts > 0)
        inner = inside[1:-1, 1:-1, 1:-1]
        if not count or inside.sum() - inner.sum() == inside.size - inner.size:
            raise VolumeError(
                f"no body in a scan of {scan.values.min():g} to {scan.values.max():g}: expected a "
                f"CT in Hounsfield units with air, below {BODY_HU:g}, around the patient"
            )
        head = int(np.abs(scan.grid.axes_m[2]).argmax())  # lungs are open at the top of a scan
        for section in np.moveaxis(inside, head, 0):
            section[:] = ndimage.binary_fill_holes(section)
        kinds = inside.astype(np.uint8)
        if fat:  # among the neighbours, not in every voxel: scans are noisy
            kinds += inside & (ndimage.median_filter(scan.values, 3) < FAT_HU)
        # Each of our voxels takes the scan's nearest: grids may be flipped, cropped or finer.
        first = scan.grid.indices(self.grid.origin_m).tolist()
        steps = np.linalg.solve(scan.grid.axes_m, self.grid.axes_m)
        body = ndimage.affine_transform(
            kinds, steps, first, self.grid.shape, order=0, mode="nearest"
        )
        names = ("lean", "fat") if fat else ("body",)
        extra = [Structure.named(name, k, len(self.volumes)) for k, name in enumerate(names, 1)]
        return Labels.of([*self.volumes, body], self.grid, (*self.structures, *extra))

    def surfaces(
        self, names: Iterable[str] | None = None, progress: Callable[[float], None] | None = None
    ) -> dict[str, Surface]:
        """Closed surfaces by name (`surface.surface_of`); ``progress`` gets the fraction done."""
        wanted = [item.name for item in self.structures] if names is None else list(names)
        found = {}
        for name in wanted:
            found[name] = surface_of(self, name)
            if progress is not None:
                progress(len(found) / len(wanted))
        return found

    layers_along = layers_on_path  # it takes the labels first


def require_agreement(labels: Labels, scan: Volume) -> None:
    """Refuse labels on a grid as large as the scan's elsewhere, or with voxels outside the scan."""
    last = np.array(scan.grid.shape) - 1.0
    corners = scan.grid.indices(labels.grid.corners_m())
    off = float(np.minimum(np.abs(corners), np.abs(corners - last)).max())
    extents = (np.sort(np.ptp(grid.corners_m(), axis=0)) for grid in (labels.grid, scan.grid))
    is_as_large = np.allclose(*extents, atol=0.1 * scan.grid.spacing_m.min())
    if (is_as_large or sorted(labels.grid.shape) == sorted(scan.grid.shape)) and off > 0.1:
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
