"""Labels of one grid on another one: each voxel takes the nearest one's value."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from foundation.arrays import Array
from needleforce.anatomy.volume import Grid

MAX_STRAY_VOXELS = 1e-6
"""Axes are parallel where a voxel at the end of one strays by less along others."""


class _AlongAxis(NamedTuple):
    """Which voxels along an axis of the source the target takes.

    Attributes:
        axis: The axis of the target that runs along it.
        indices: Along the axis of the source, one for each of the target's voxels;
            beyond its ends where the target reaches further, (n,).
    """

    axis: int
    indices: NDArray[np.intp]


def resample_nearest(
    values: NDArray[np.uint8], source: Grid, target: Grid
) -> NDArray[np.uint8]:
    """Return values on another grid, which may be flipped, cropped or finer.

    Args:
        values: On the source grid, (i, j, k).
        source: Their grid.
        target: The other grid; outside of the source the result is 0.
    """
    matrix = np.asarray(np.linalg.solve(source.axes_m, target.axes_m), float)
    offset = source.indices(target.origin_m)
    if source.shape == target.shape and _is_same(matrix, offset, target):
        return values
    along = _parallel_axes(matrix, offset, target)
    if along is not None:
        return _take(values, along)
    resampled: NDArray[np.uint8] = np.zeros(target.shape, np.uint8)
    ndimage.affine_transform(
        values,
        matrix,
        offset.tolist(),
        target.shape,
        resampled,
        order=0,
        mode="grid-constant",
    )
    return resampled


def _is_same(matrix: Array, offset: Array, target: Grid) -> bool:
    """Return whether every voxel lies at its own place."""
    last = np.array(target.shape) - 1.0
    stray = np.abs(matrix - np.eye(3)) @ last + np.abs(offset)
    return bool(stray.max() < MAX_STRAY_VOXELS)


def _parallel_axes(
    matrix: Array, offset: Array, target: Grid
) -> list[_AlongAxis] | None:
    """Return where the voxels along each axis of the target come from.

    Returns:
        One item for each axis of the source; None where the axes are not parallel.
    """
    # The axis of the target along each one of the source.
    owners: list[int] = np.abs(matrix).argmax(axis=1).tolist()
    if sorted(owners) != [0, 1, 2]:
        return None
    others = matrix.copy()
    others[np.arange(3), owners] = 0.0
    if (np.abs(others) @ (np.array(target.shape) - 1.0)).max() > MAX_STRAY_VOXELS:
        return None
    along: list[_AlongAxis] = []
    for axis, owner in enumerate(owners):
        places = offset[axis] + matrix[axis, owner] * np.arange(target.shape[owner])
        along.append(_AlongAxis(owner, np.floor(places + 0.5).astype(np.intp)))
    return along


def _take(values: NDArray[np.uint8], along: list[_AlongAxis]) -> NDArray[np.uint8]:
    """Return values at indices along each axis, in the order of the target's axes."""
    taken = values
    for axis, item in enumerate(along):
        size = values.shape[axis]
        is_inside = (item.indices >= 0) & (item.indices < size)
        taken = np.take(taken, np.where(is_inside, item.indices, 0), axis=axis)
        if not is_inside.all():
            outside: list[slice | NDArray[np.bool_]] = [slice(None)] * 3
            outside[axis] = ~is_inside
            taken[tuple(outside)] = 0
    order = np.argsort([item.axis for item in along])
    return np.ascontiguousarray(taken.transpose(order))
