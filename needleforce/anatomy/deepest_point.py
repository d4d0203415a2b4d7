"""The point of a structure that lies farthest from its surface."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from foundation.arrays import Array

if TYPE_CHECKING:
    from needleforce.anatomy.labels import Labels

MAX_VOXELS = 4_000_000
"""Larger boxes are searched on blocks first: the distances take 70 bytes a voxel."""

BLOCK = 4
"""Voxels along the edge of a block."""


class _Region(NamedTuple):
    """Where the deepest voxel lies.

    Attributes:
        box: What decides on how deep it lies.
        is_candidate: Which voxels of the box it may be.
    """

    box: tuple[slice, ...]
    is_candidate: NDArray[np.bool_]


def deepest_point_m(labels: "Labels", name: str) -> Array:
    """Return the point of a structure that lies farthest from its surface, (3,)."""
    mask = np.pad(labels.mask(name), 1)
    spacing_m = labels.grid.spacing_m
    region = _Region(tuple(slice(0, size) for size in mask.shape), mask)
    if mask.size > MAX_VOXELS:
        region = _narrow(mask, spacing_m)
    depth_m = _depths_m(mask[region.box], spacing_m)
    depth_m[~region.is_candidate] = 0.0
    index = np.array(np.unravel_index(int(depth_m.argmax()), depth_m.shape))
    corner = [
        side.start + part.start - 1
        for side, part in zip(labels[name].box, region.box, strict=True)
    ]
    return labels.grid.points_m(index + corner)


def _depths_m(mask: NDArray[np.bool_], spacing_m: Array) -> NDArray[np.floating]:
    """Return the distances from the nearest voxel outside of a mask [m]."""
    depth_m: NDArray[np.floating] = np.zeros(mask.shape)
    ndimage.distance_transform_edt(mask, sampling=spacing_m.tolist(), distances=depth_m)
    return depth_m


def _narrow(mask: NDArray[np.bool_], spacing_m: Array) -> _Region:
    """Return where the deepest voxel of a mask can lie, by blocks.

    A voxel in a block, and the voxel outside that is nearest to it in another one, lie
    no further from the centres of their blocks than half a block's diagonal.
    """
    blocks = [-(-size // BLOCK) for size in mask.shape]
    padded: NDArray[np.bool_] = np.zeros([BLOCK * count for count in blocks], bool)
    padded[tuple(map(slice, mask.shape))] = mask
    shape = [length for count in blocks for length in (count, BLOCK)]
    is_full = np.asarray(padded.reshape(shape).all(axis=(1, 3, 5)))
    depth_m = _depths_m(is_full, BLOCK * spacing_m)
    diagonal_m = BLOCK * float(np.linalg.norm(spacing_m))
    deepest_m = float(depth_m.max())
    is_candidate = depth_m >= deepest_m - 2.0 * diagonal_m
    places = np.argwhere(is_candidate)
    reach = np.ceil((deepest_m + diagonal_m) / spacing_m).astype(int) + 1
    low = np.maximum(BLOCK * places.min(axis=0) - reach, 0)
    high = np.minimum(BLOCK * (places.max(axis=0) + 1) + reach, mask.shape)
    box = tuple(map(slice, low.tolist(), high.tolist()))
    fine = is_candidate
    for axis in range(3):
        fine = fine.repeat(BLOCK, axis=axis)
    return _Region(box, fine[box] & mask[box])
