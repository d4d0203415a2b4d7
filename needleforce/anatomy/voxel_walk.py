"""Where a straight path runs through voxels of structures, voxel by voxel."""

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.arrays import Array
from needleforce.anatomy.structures import Structure


class Crossing(NamedTuple):
    """A stretch of a path through voxels of one structure.

    Attributes:
        structure: The structure.
        begin: Fraction of the path at which it begins.
        end: Fraction at which it ends.
    """

    structure: Structure
    begin: float
    end: float


def find_crossings(
    volumes: Sequence[NDArray[np.integer]],
    structures: Sequence[Structure],
    start: Array,
    way: Array,
) -> list[Crossing]:
    """Return where a path runs through voxels of structures, by depth.

    Where structures overlap the smallest counts, and every obstacle.

    Args:
        volumes: Label volumes, each (i, j, k).
        structures: Those that count.
        start: Index of the path's first point, with fractions, (3,).
        way: From there to its last point, in indices, (3,).
    """
    cuts = _face_fractions(start, way)
    middles = start + 0.5 * (cuts[:-1] + cuts[1:])[:, None] * way
    is_held = np.zeros(len(middles), bool)
    crossings: list[Crossing] = []
    for item in sorted(structures, key=lambda one: one.voxels):
        is_inside = _are_inside(volumes[item.volume], item, middles)
        if not item.is_obstacle:
            is_inside &= ~is_held
        is_held |= is_inside
        edges = np.diff(np.concatenate([[0], is_inside.astype(int), [0]]))
        begins = cuts[np.flatnonzero(edges > 0)].tolist()
        ends = cuts[np.flatnonzero(edges < 0)].tolist()
        crossings += [
            Crossing(item, begin, end) for begin, end in zip(begins, ends, strict=True)
        ]
    return sorted(crossings, key=lambda one: one.begin)


def _face_fractions(start: Array, way: Array) -> Array:
    """Return the fractions of a path at which it passes from voxel to voxel."""
    cuts = [np.array([0.0, 1.0])]
    for begin, length in zip(start.tolist(), way.tolist(), strict=True):
        if length != 0.0:
            low, high = sorted((begin, begin + length))
            faces = np.arange(np.ceil(low - 0.5), np.floor(high - 0.5) + 1.0) + 0.5
            cuts.append((faces - begin) / length)
    return np.unique(np.clip(np.concatenate(cuts), 0.0, 1.0))


def _are_inside(
    volume: NDArray[np.integer], item: Structure, points: Array
) -> NDArray[np.bool_]:
    """Return which points (n, 3), in indices, lie in voxels of a structure."""
    tie_voxels = 1e-9  # so near to a face a path runs through both voxels beside it
    is_inside = np.zeros(len(points), bool)
    lows = np.array([side.start for side in item.box])
    highs = np.array([side.stop for side in item.box])
    for signs in product((-tie_voxels, tie_voxels), repeat=3):
        voxels = np.rint(points + signs).astype(int)
        is_near = np.all((voxels >= lows) & (voxels < highs), axis=1)
        is_inside[is_near] |= volume[tuple(voxels[is_near].T)] == item.value
    return is_inside
