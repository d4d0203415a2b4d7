"""Which structure each voxel of a scan belongs to: the bare data."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from foundation.arrays import Array
from needleforce.anatomy.errors import VolumeError
from needleforce.anatomy.structures import Structure
from needleforce.anatomy.volume import Grid

NO_SCAN = "labels not checked against a scan: none was given"
"""What is said of labels that were read alone."""


@dataclass(frozen=True, eq=False)
class Segmentation:
    """Label volumes on one grid, and what their values mean.

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
    ) -> Self:
        """Return labels with the voxels of each structure counted.

        Structures without voxels are left out.

        Raises:
            VolumeError: No structure has a voxel, or two have one name or one label.
        """
        boxes = [dict(enumerate(ndimage.find_objects(one), 1)) for one in volumes]
        names: set[str] = set()
        places: set[tuple[int, int]] = set()
        found: list[Structure] = []
        for item in structures:
            place = (item.volume, item.value)
            if item.name in names or place in places:
                raise VolumeError(f"two structures have the name or label of {item}")
            names.add(item.name)
            places.add(place)
            box = boxes[item.volume].get(item.value)
            if box is not None:
                voxels = np.count_nonzero(volumes[item.volume][box] == item.value)
                found.append(replace(item, voxels=int(voxels), box=box))
        if not found:
            raise VolumeError("no voxel is labelled: expected at least one structure")
        return cls(volumes, grid, tuple(found))

    def __getitem__(self, name: str) -> Structure:
        by_name = {item.name: item for item in self.structures}
        if name not in by_name:
            raise VolumeError(
                f"no structure with voxels is named {name!r}; there are "
                f"{', '.join(by_name)}",
            )
        return by_name[name]

    def at_risk(self) -> list[Structure]:
        """Return the obstacles, and the structures that a needle should not meet."""
        return [one for one in self.structures if one.is_obstacle or one.is_risk]

    def mask(self, name: str) -> NDArray[np.bool_]:
        """Return which voxels in a structure's box belong to it, (i, j, k)."""
        structure = self[name]
        return self.volumes[structure.volume][structure.box] == structure.value

    def corner(self, name: str) -> NDArray[np.integer]:
        """Return the index of the first voxel in a structure's box, (3,)."""
        return np.array([side.start for side in self[name].box])

    def centroid_m(self, name: str) -> Array:
        """Return the mean position of a structure's voxels in LPS, (3,)."""
        middle = ndimage.center_of_mass(self.mask(name))
        return self.grid.points_m(self.corner(name) + middle)

    def deepest_point_m(self, name: str) -> Array:
        """Return the point of a structure that lies farthest from its surface, (3,)."""
        mask = np.pad(self.mask(name), 1)
        spacing_m = self.grid.spacing_m.tolist()
        depth_m = np.asarray(ndimage.distance_transform_edt(mask, spacing_m))
        index = np.unravel_index(int(depth_m.argmax()), depth_m.shape)
        return self.grid.points_m(self.corner(name) - 1 + index)

    def inside(self) -> NDArray[np.bool_]:
        """Return which voxels any structure covers, (i, j, k)."""
        return np.any([volume != 0 for volume in self.volumes], axis=0)
