"""Scans on a grid of voxels.

LPS and metres; arrays are (i, j, k) along the axes of their `Grid`. Two of them may be
stored in different orders and still agree, so only places are ever compared.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foundation.arrays import Array

RAS_TO_LPS = np.array([-1.0, -1.0, 1.0])
"""Factors of x, y and z from the frame of NIfTI and of what 3D Slicer shows."""


@dataclass(frozen=True, eq=False)
class Grid:
    """Where voxels lie: point = origin + axes @ index; whole indices are centres.

    Attributes:
        shape: Voxels along each of three axes.
        origin_m: Centre of voxel 0, 0, 0 in LPS, shape (3,).
        axes_m: Steps from a voxel to the next along each axis, in columns, shape
            (3, 3).
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
        """Return points (..., 3) in LPS of indices (..., 3), also between voxels."""
        return self.origin_m + np.asarray(indices, float) @ self.axes_m.T

    def indices(self, points_m: ArrayLike) -> Array:
        """Return indices (..., 3), with fractions, of points (..., 3) in LPS."""
        return (np.asarray(points_m, float) - self.origin_m) @ np.linalg.inv(
            self.axes_m
        ).T

    def nearest(
        self, values: NDArray[Any], indices: NDArray[Any], outside: float = 0
    ) -> NDArray[Any]:
        """Return the values of the voxels nearest to indices (..., 3), shape (...).

        Args:
            values: Of the grid's voxels, (i, j, k).
            indices: With fractions.
            outside: What stands beyond the grid.
        """
        voxels = np.rint(indices).astype(np.int32)
        is_valid = np.all((voxels >= 0) & (voxels < self.shape), axis=-1)
        places = tuple(np.moveaxis(np.where(is_valid[..., None], voxels, 0), -1, 0))
        return np.where(is_valid, values[places], outside)

    def corners_m(self, box: Sequence[slice] = ()) -> Array:
        """Return the centres of the voxels in the eight corners, shape (8, 3).

        Args:
            box: A box in the grid; by default the whole grid.
        """
        sides = box or [slice(0, size) for size in self.shape]
        return self.points_m([*product(*((one.start, one.stop - 1) for one in sides))])


@dataclass(frozen=True, eq=False)
class Volume:
    """A scan: one number per voxel, of a CT in Hounsfield units.

    Attributes:
        values: The numbers, (i, j, k).
        grid: Where the voxels lie.
    """

    values: NDArray[Any]
    grid: Grid
