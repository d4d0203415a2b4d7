"""The outer voxels of structures: those with a face to something else.

A path from outside meets one of them before any inner one.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.arrays import Array
from needleforce.anatomy.segmentation import Segmentation
from needleforce.anatomy.slabs import slabs_of
from needleforce.anatomy.structures import Structure


class Ball(NamedTuple):
    """A ball.

    Attributes:
        centre_m: Its centre, (3,) in LPS.
        radius_m: Its radius.
    """

    centre_m: Array
    radius_m: float


class OuterVoxels:
    """The outer voxels of structures, found once for each.

    Args:
        labels: The segmentation.

    Attributes:
        labels: The same.
    """

    def __init__(self, labels: Segmentation) -> None:
        self.labels = labels
        self._indices: dict[str, NDArray[np.int32]] = {}

    def indices(
        self, structure: Structure, within: Ball | None = None
    ) -> NDArray[np.int32]:
        """Return the indices (n, 3) of the outer voxels of a structure.

        Args:
            structure: Of the segmentation.
            within: Voxels whose boxes lie outside of this ball are left out.
        """
        if structure.name not in self._indices:
            volume = self.labels.volumes[structure.volume]
            self._indices[structure.name] = _find_outer(volume, structure)
        indices = self._indices[structure.name]
        if within is None:
            return indices
        spacing_m = self.labels.grid.spacing_m
        reach_m = within.radius_m + 0.5 * float(np.linalg.norm(spacing_m))
        offsets_m = (indices - self.labels.grid.indices(within.centre_m)) * spacing_m
        return indices[np.linalg.norm(offsets_m, axis=1) <= reach_m]


def _find_outer(volume: NDArray[np.integer], structure: Structure) -> NDArray[np.int32]:
    """Return the indices (n, 3) of the outer voxels of a structure."""
    part = volume[structure.box]
    corner = np.array([side.start for side in structure.box], np.int32)
    found = [np.zeros((0, 3), np.int32)]
    for slab in slabs_of(part.shape):
        beside = slice(max(slab.start - 1, 0), slab.stop + 1)
        mask = np.pad(part[beside] == structure.value, 1)
        # The slab's own sections; a section beside it is there, or none is.
        first = 1 + slab.start - beside.start
        sections = slice(first, first + slab.stop - slab.start)
        is_inner = mask[sections].copy()
        for axis in range(3):
            for step in (-1, 1):
                is_inner &= np.roll(mask, step, axis)[sections]
        outer = np.argwhere((mask[sections] & ~is_inner)[:, 1:-1, 1:-1])
        outer[:, 0] += slab.start
        found.append(outer.astype(np.int32) + corner)
    return np.concatenate(found)
