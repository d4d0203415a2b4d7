"""Large volumes worked on slab by slab, so that temporary arrays stay small."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

SLAB_VOXELS = 1 << 22
"""Voxels of a slab: 32 MB of the widest numbers."""


def slabs_of(shape: Sequence[int]) -> Iterator[slice]:
    """Yield the slabs of a volume, spans of its first axis."""
    section_voxels = max(int(np.prod(shape[1:])), 1)
    thickness = max(SLAB_VOXELS // section_voxels, 1)
    for start in range(0, shape[0], thickness):
        yield slice(start, min(start + thickness, shape[0]))


def copy_in_order(values: NDArray[Any], kind: DTypeLike) -> NDArray[Any]:
    """Return a copy of a type, with the last axis the fastest in memory.

    Files have the first axis fastest; what walks along the last one, as most of scipy
    does, is several times as fast on the copy.

    Args:
        values: Numbers that the type can hold, (i, j, k).
        kind: The type.
    """
    copy = np.empty(values.shape, kind)
    for slab in slabs_of(values.shape):
        copy[slab] = values[slab]
    return copy


def are_whole(values: NDArray[Any]) -> bool:
    """Return whether all numbers of a volume are whole."""
    if np.issubdtype(values.dtype, np.integer):
        return True
    return all(
        bool(np.all(values[slab] == np.rint(values[slab])))
        for slab in slabs_of(values.shape)
    )
