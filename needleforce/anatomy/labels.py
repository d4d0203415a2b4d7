"""Segmentations: which structure each voxel belongs to."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from foundation.arrays import Array
from needleforce.anatomy.clearance import Clearance, find_clearances
from needleforce.anatomy.errors import AnatomyCode, VolumeError
from needleforce.anatomy.path_layers import Layer, find_layers
from needleforce.anatomy.scan_agreement import NO_SCAN, check_against_scan
from needleforce.anatomy.structures import Structure
from needleforce.anatomy.surface import Surface, closed_surface
from needleforce.anatomy.volume import Grid, Volume

BODY_HU = -300.0
"""Between air and fat, in Hounsfield units."""

FAT_HU = -30.0
"""Between fat and lean tissue, in Hounsfield units."""

FAT_NEIGHBOURS = 3
"""Voxels along each axis whose median decides between fat and lean: scans are noisy."""


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
        boxes = [dict(enumerate(ndimage.find_objects(volume), 1)) for volume in volumes]
        by_name: dict[str, Structure] = {}
        for item in structures:
            if item.name in by_name:
                raise VolumeError(
                    f"two structures are named {item.name!r}", AnatomyCode.LABELS
                )
            if (box := boxes[item.volume].get(item.value)) is not None:
                voxels = np.count_nonzero(volumes[item.volume][box] == item.value)
                by_name[item.name] = replace(item, voxels=int(voxels), box=box)
        if not by_name:
            raise VolumeError(
                "no voxel is labelled: expected at least one structure",
                AnatomyCode.LABELS,
            )
        return cls(volumes, grid, tuple(by_name.values()))

    def __getitem__(self, name: str) -> Structure:
        by_name = {item.name: item for item in self.structures}
        if name not in by_name:
            raise VolumeError(
                f"no structure with voxels is named {name!r}; there are "
                f"{', '.join(by_name)}",
                AnatomyCode.STRUCTURE,
            )
        return by_name[name]

    def mask(self, name: str) -> NDArray[np.bool_]:
        """Return which voxels in a structure's box belong to it, (i, j, k)."""
        structure = self[name]
        return self.volumes[structure.volume][structure.box] == structure.value

    def centroid_m(self, name: str) -> Array:
        """Return the mean position of a structure's voxels in LPS, (3,)."""
        corner = [side.start for side in self[name].box]
        return self.grid.points_m(np.argwhere(self.mask(name)).mean(axis=0) + corner)

    def with_body(self, scan: Volume, *, fat: bool = False) -> "Labels":
        """Add ``body``: all that is not air around the patient, found in the CT.

        Args:
            scan: The CT.
            fat: Add two structures in place of it, ``lean`` and ``fat``.

        Raises:
            VolumeError: Labels that lie elsewhere than the scan shows what they name,
                only air, or no air around.
        """
        unchecked = check_against_scan(self, scan)
        body = _find_body(scan)
        kinds = body.astype(np.uint8)
        if fat:
            median = ndimage.median_filter(scan.values, FAT_NEIGHBOURS)
            kinds += body & (median < FAT_HU)
        # Each of our voxels takes the scan's nearest: grids may be flipped, cropped or
        # finer.
        resampled = ndimage.affine_transform(
            kinds,
            np.linalg.solve(scan.grid.axes_m, self.grid.axes_m),
            scan.grid.indices(self.grid.origin_m).tolist(),
            self.grid.shape,
            order=0,
            mode="grid-constant",
        )
        names = ("lean", "fat") if fat else ("body",)
        added = [
            Structure.named(name, value, len(self.volumes))
            for value, name in enumerate(names, 1)
        ]
        labels = Labels.of(
            [*self.volumes, resampled], self.grid, (*self.structures, *added)
        )
        return replace(labels, unchecked=unchecked)

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
    ) -> dict[str, Surface]:
        """Return closed surfaces by name; see `closed_surface`.

        Args:
            names: Of the structures; None for all.
            progress: Called with the fraction done.

        Raises:
            VolumeError: No structure with voxels has one of the names.
        """
        all_names = [item.name for item in self.structures]
        chosen_names = all_names if names is None else list(names)
        surfaces: dict[str, Surface] = {}
        for name in chosen_names:
            structure = self[name]
            surfaces[name] = closed_surface(
                name,
                self.mask(name),
                self.grid.points_m([side.start for side in structure.box]),
                self.grid.axes_m,
                structure.colour,
            )
            if progress is not None:
                progress(len(surfaces) / len(chosen_names))
        return surfaces

    def skin(self) -> Surface:
        """Return the closed surface of all that is labelled; see `with_body`."""
        inside = np.zeros(self.grid.shape, bool)
        for volume in self.volumes:
            inside |= volume != 0
        name = "skin"
        body = Labels.of([inside.view(np.uint8)], self.grid, [Structure.named(name, 1)])
        return body.surfaces()[name]

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
        if names is None:
            chosen = [one for one in self.structures if one.is_obstacle or one.is_risk]
        else:
            chosen = [self[name] for name in names]
        return find_clearances(self, chosen, entry_m, target_m)


def _find_body(scan: Volume) -> NDArray[np.bool_]:
    """Return which voxels of a CT belong to the largest body, its holes filled.

    Raises:
        VolumeError: There is only air, or no air around.
    """
    parts: NDArray[np.int32] = np.zeros(scan.grid.shape, np.int32)
    count = ndimage.label(scan.values > BODY_HU, output=parts)
    largest = np.bincount(parts[parts > 0], minlength=1).argmax()
    body = (parts == largest) & (parts > 0)
    inner = body[1:-1, 1:-1, 1:-1]
    outer_voxels = body.size - inner.size
    if not count or body.sum() - inner.sum() == outer_voxels:
        raise VolumeError(
            f"no body in a scan of {scan.values.min():g} to {scan.values.max():g}: "
            f"expected a CT in Hounsfield units with air, below {BODY_HU:g}, around "
            "the patient",
            AnatomyCode.SCAN,
        )
    # Lungs are open at the top of a scan, so holes are filled section by section.
    head_axis = int(np.abs(scan.grid.axes_m[2]).argmax())
    for section in np.moveaxis(body, head_axis, 0):
        section[:] = ndimage.binary_fill_holes(section)
    return body
