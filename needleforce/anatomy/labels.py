"""Segmentations: which structure each voxel belongs to."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from foundation.arrays import Array
from needleforce.anatomy.body import find_body, resample_nearest
from needleforce.anatomy.clearance import Clearance, VoxelBoxes, find_clearances
from needleforce.anatomy.errors import VolumeError
from needleforce.anatomy.path_layers import TISSUES, Layer, find_layers
from needleforce.anatomy.scan_agreement import NO_SCAN, check_against_scan
from needleforce.anatomy.structures import Structure
from needleforce.anatomy.surface import Surface, closed_surface, join_voxels
from needleforce.anatomy.volume import Grid, Volume

SHOWN_VOXEL_m = 3e-3
"""Voxels of surfaces that are looked at: finer ones add triangles that nobody sees."""

DENSE = "dense_as_bone"
"""Name of what is as dense as bone in the CT and not labelled."""


@dataclass(frozen=True, eq=False)
class Labels:
    """A segmentation: label volumes on one grid, and what their values mean.

    Attributes:
        volumes: Each (i, j, k); 0 is no structure.
        grid: Where the voxels lie.
        structures: Those with voxels.
        unchecked: Why the labels were not checked against their scan; empty if they
            were.
    """

    volumes: Sequence[NDArray[np.integer]]
    grid: Grid
    structures: tuple[Structure, ...]
    unchecked: str = NO_SCAN

    @classmethod
    def of(
        cls,
        volumes: Sequence[NDArray[Any]],
        grid: Grid,
        structures: Iterable[Structure],
    ) -> "Labels":
        """Return labels with the voxels of each structure counted.

        Structures without voxels are left out.

        Raises:
            VolumeError: No structure has a voxel, or two have the same name.
        """
        boxes = [ndimage.find_objects(volume) for volume in volumes]
        found: dict[str, Structure] = {}
        for item in structures:
            if item.name in found:
                raise VolumeError(f"two structures are named {item.name!r}")
            box = dict(enumerate(boxes[item.volume], 1)).get(item.value)
            if box is not None:
                voxels = np.count_nonzero(volumes[item.volume][box] == item.value)
                found[item.name] = replace(item, voxels=int(voxels), box=box)
        if not found:
            raise VolumeError("no voxel is labelled: expected at least one structure")
        return cls(volumes, grid, tuple(found.values()))

    def __getitem__(self, name: str) -> Structure:
        by_name = {item.name: item for item in self.structures}
        if name not in by_name:
            raise VolumeError(
                f"no structure with voxels is named {name!r}; there are "
                f"{', '.join(by_name)}",
            )
        return by_name[name]

    def mask(self, name: str) -> NDArray[np.bool_]:
        """Return which voxels in a structure's box belong to it, (i, j, k)."""
        structure = self[name]
        return self.volumes[structure.volume][structure.box] == structure.value

    def centroid_m(self, name: str) -> Array:
        """Return the mean position of a structure's voxels in LPS, (3,)."""
        corner = [side.start for side in self[name].box]
        return self.grid.points_m(
            np.add(ndimage.center_of_mass(self.mask(name)), corner)
        )

    def deepest_point_m(self, name: str) -> Array:
        """Return the point of a structure that lies farthest from its surface, (3,)."""
        mask = np.pad(self.mask(name), 1)
        spacing_m = self.grid.spacing_m.tolist()
        depth_m = np.asarray(ndimage.distance_transform_edt(mask, spacing_m))
        index = np.unravel_index(int(depth_m.argmax()), depth_m.shape)
        corner = [side.start - 1 for side in self[name].box]
        return self.grid.points_m(np.array(index) + corner)

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
        unchecked = check_against_scan(self, scan)
        kinds = find_body(scan, fat=fat, progress=progress)
        values = resample_nearest(kinds, scan.grid, self.grid)
        names = ("lean", "fat") if fat else ("body",)
        return replace(self._with_volume(values, names), unchecked=unchecked)

    def _with_volume(self, values: NDArray[Any], names: Sequence[str]) -> "Labels":
        """Return labels with one more volume, and structures of values from 1."""
        named = [Structure.named(name, value) for value, name in enumerate(names, 1)]
        added = [
            replace(item, volume=len(self.volumes))
            for item in Labels.of([values], self.grid, named).structures
        ]
        twice = {item.name for item in self.structures} & {item.name for item in added}
        if twice:
            raise VolumeError(f"two structures are named {', '.join(twice)}")
        return replace(
            self,
            volumes=[*self.volumes, values],
            structures=(*self.structures, *added),
        )

    def with_dense(self, scan: Volume) -> "Labels":
        """Add `DENSE`, an obstacle: what is dense as bone in the CT and not labelled.

        What ``lean``, ``fat`` or ``body`` covers counts as not labelled. Pieces smaller
        than 10 mm³, which stop no needle, are left out.

        Args:
            scan: The CT, in HU.
        """
        min_dense_m3 = 10e-9  # smaller pieces are calcifications, or noise
        # Soft tissue, with contrast medium too, seldom exceeds it; bone and metal do.
        dense_HU = 200.0
        is_dense = resample_nearest(
            (scan.values > dense_HU).astype(np.uint8), scan.grid, self.grid
        ).astype(bool)
        for item in self.structures:
            if item.name not in TISSUES:
                inside = self.volumes[item.volume][item.box] == item.value
                is_dense[item.box] &= ~inside
        labelled: Any = ndimage.label(is_dense, np.ones((3, 3, 3)))
        pieces = labelled[0]
        is_large = np.bincount(pieces.ravel()) * self.grid.voxel_m3 >= min_dense_m3
        is_large[0] = False
        values = is_large[pieces].astype(np.uint8)
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
        progress: Callable[[float], None] | None = None,
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
            corner = [side.start for side in self[name].box] + 0.5 * (joined - 1)
            surfaces[name] = closed_surface(
                name,
                join_voxels(self.mask(name), joined),
                self.grid.points_m(corner),
                self.grid.axes_m * joined,
                self[name].colour,
            )
            if progress is not None:
                progress(len(surfaces) / len(chosen))
        return surfaces

    def skin(self) -> Surface:
        """Return the closed surface of all that is labelled; see `with_body`."""
        body = Labels.of(
            [self.inside().view(np.uint8)], self.grid, [Structure.named("skin", 1)]
        )
        return body.surfaces()["skin"]

    def inside(self) -> NDArray[np.bool_]:
        """Return which voxels any structure covers, (i, j, k)."""
        inside = np.zeros(self.grid.shape, bool)
        for volume in self.volumes:
            inside |= volume != 0
        return inside

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
                their normals. The stated deviations contain this and what the voxels'
                size adds.

        Raises:
            VolumeError: A point is not finite, both are the same, the target lies
                outside, or the entry more than a metre; a deviation that is negative or
                in millimetres.
        """
        return find_layers(self, entry_m, target_m, boundary_std_m)

    def clearances(
        self,
        entry_m: ArrayLike,
        target_m: ArrayLike,
        names: Iterable[str] | None = None,
    ) -> list[Clearance]:
        """Return how near a straight path comes to structures, the nearest first.

        Every voxel counts as the box that it fills. `VoxelBoxes` judges many paths
        faster; `require_clear_path` refuses one that comes too near to an obstacle.

        Args:
            entry_m: First point, (3,) in LPS.
            target_m: Last point.
            names: Of the structures; None for obstacles and structures at risk.

        Raises:
            VolumeError: No structure with voxels has one of the names.
        """
        chosen = [one for one in self.structures if one.is_obstacle or one.is_risk]
        if names is not None:
            chosen = [self[name] for name in names]
        boxes = [VoxelBoxes(self, one) for one in chosen]
        return find_clearances(boxes, entry_m, target_m)
