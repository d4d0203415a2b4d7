"""Voxels in the patient's frame: where they lie, and which structure each belongs to."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from needleforce.anatomy.errors import VolumeError


@dataclass(frozen=True, eq=False)
class Grid:
    """Where voxels lie: point = origin + axes @ index, indices are those of voxel centres."""

    shape: tuple[int, int, int]  # voxels along each axis
    origin_m: NDArray[np.float64]  # (3,) centre of voxel 0, 0, 0 in LPS
    axes_m: NDArray[np.float64]  # (3, 3) columns: step from a voxel to the next along each axis

    @property
    def spacing_m(self) -> NDArray[np.float64]:
        """Distance between voxels along each axis, (3,)."""
        return np.linalg.norm(self.axes_m, axis=0)

    def points_m(self, indices: ArrayLike) -> NDArray[np.float64]:
        """Points (..., 3) in LPS of indices (..., 3), which may lie between voxels."""
        return self.origin_m + np.asarray(indices, float) @ self.axes_m.T

    def indices(self, points_m: ArrayLike) -> NDArray[np.float64]:
        """Indices (..., 3), with fractions, of points (..., 3) in LPS."""
        return (np.asarray(points_m, float) - self.origin_m) @ np.linalg.inv(self.axes_m).T


@dataclass(frozen=True, eq=False)
class Volume:
    """A scan: one number per voxel, of a CT in Hounsfield units."""

    values: NDArray[np.generic]  # (i, j, k) in the order of the grid's axes
    grid: Grid


@dataclass(frozen=True)
class Structure:
    """One labelled structure of a segmentation."""

    name: str
    value: int  # of its voxels
    colour: tuple[float, float, float]  # red, green, blue from 0 to 1
    layer: int = 0  # which of the label volumes it lies in: overlapping segments need several
    is_obstacle: bool = False  # bone or cartilage


@dataclass(frozen=True, eq=False)
class Labels:
    """A segmentation: label volumes on one grid, and what their values mean."""

    volumes: Sequence[NDArray[np.integer]]  # each (i, j, k); 0 is no structure
    grid: Grid
    structures: tuple[Structure, ...]

    def __getitem__(self, name: str) -> Structure:
        """Return the structure of that name."""
        for structure in self.structures:
            if structure.name == name:
                return structure
        names = ", ".join(item.name for item in self.structures)
        raise VolumeError(f"no structure is named {name!r}; there are {names}")

    def mask(self, name: str) -> NDArray[np.bool_]:
        """Which voxels belong to a structure, (i, j, k)."""
        structure = self[name]
        return self.volumes[structure.layer] == structure.value
