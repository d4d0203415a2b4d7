"""What a straight needle crosses: layers in order, from the label volume itself.

Around each point of the path every voxel votes for its label, weighted by a smooth kernel; the
label with most votes holds the point. Where the winner changes is a boundary, refined between two
points. The layers therefore follow each other without gaps or overlaps, which rays through the
surfaces of neighbouring structures do not grant.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from needleforce.anatomy.errors import Array, VolumeError, require_deviation

if TYPE_CHECKING:
    from needleforce.anatomy.volume import Labels

UNLABELLED = "unlabelled"  # Name of what no structure covers
WIDTH_VOXELS, REACH_VOXELS, STEP_VOXELS = 1.2, 3, 0.5
"""Of the kernel: standard deviation and reach; and the distance of points on the path."""
MOST_OUTSIDE_m = 1.0  # The first point; beyond it the unit is not the metre
VOTE_STD = 0.105
"""Standard deviation of the difference of two votes, from the voxels' size alone: of the analytic
torso's seeds below 1000, at 1 and 3 mm."""


@dataclass(frozen=True)
class Layer:
    """A stretch of the path inside one structure; depths along the needle from the entry point."""

    name: str  # of the structure, or `UNLABELLED`
    entry_m: float  # depth at which the needle enters it
    exit_m: float  # depth at which it leaves it: the next layer's entry
    entry_std_m: float  # standard deviation of the former, 0 at the path's first point
    exit_std_m: float  # of the latter, 0 at the path's last point
    is_obstacle: bool  # bone or cartilage


def layers_on_path(
    labels: "Labels", entry_m: ArrayLike, target_m: ArrayLike, boundary_std_m: float = 0.0
) -> list[Layer]:
    """Return what the straight path between two points crosses, in order, without gaps or overlaps.

    Where structures overlap the smaller one counts. Layers thinner than about 1.5 voxels may be
    missed.

    Args:
        labels: The segmentation.
        entry_m: First point, (3,) in LPS.
        target_m: Last point, inside the volume.
        boundary_std_m: Standard deviation of the segmentation's boundaries along their normals. The
            stated deviations hold what the voxels' size brings, and this.

    Raises:
        VolumeError: A point is not finite, both are the same, the target lies outside, or the entry
            more than a metre; a deviation that is negative or in millimetres.
    """
    if boundary_std_m != 0.0:
        require_deviation("boundary_std_m", boundary_std_m, VolumeError)
    entry, target = np.asarray(entry_m, float), np.asarray(target_m, float)
    if entry.shape != (3,) or target.shape != (3,) or not np.all(np.isfinite([entry, target])):
        raise VolumeError(
            f"entry {entry_m} and target {target_m}: expected two points of 3 numbers"
        )
    first, last = labels.grid.indices(np.array([entry, target]))
    if np.any(last < -0.5) or np.any(last > np.array(labels.grid.shape) - 0.5):
        raise VolumeError(f"the target {target.tolist()} m lies outside the volume")
    beyond_m = np.maximum(-first, first - labels.grid.shape) * labels.grid.spacing_m
    if beyond_m.max() > MOST_OUTSIDE_m:
        raise VolumeError(
            f"the entry {entry.tolist()} lies {beyond_m.max():.3g} m outside the volume: expected "
            "metres, not millimetres"
        )
    length_m, steps = float(np.linalg.norm(target - entry)), np.linalg.norm(last - first)
    if steps == 0.0:
        raise VolumeError(f"entry and target are the same point {entry.tolist()}")
    at = np.linspace(0.0, 1.0, int(np.ceil(steps / STEP_VOXELS)) + 1)
    votes, kinds = _votes(labels, first + at[:, None] * (last - first))
    winners = votes.argmax(axis=1)
    (i,) = np.nonzero(np.diff(winners))
    left, right = winners[i], winners[i + 1]
    lead_m = np.diff(at)[i] * length_m  # the winner leads before a boundary and trails behind it
    lead, trail = votes[i, left] - votes[i, right], votes[i + 1, right] - votes[i + 1, left]
    fall = np.maximum(lead + trail, 1e-9)
    cuts_m = at[i] * length_m + lead_m * lead / fall
    # Across a flat boundary the lead falls by 2 k(0) a voxel, k the kernel in one dimension.
    steepest_1_m = 3.0 / (np.sqrt(2.0 * np.pi) * WIDTH_VOXELS) / np.cbrt(labels.grid.voxel_m3)
    std_m = np.hypot(VOTE_STD, boundary_std_m * steepest_1_m) * lead_m / fall
    depths = pairwise([0.0, *cuts_m.tolist(), length_m])
    deviations = pairwise([0.0, *np.minimum(std_m, length_m).tolist(), 0.0])
    return [
        Layer(kinds[rank][0], *depth, *std, kinds[rank][1])
        for rank, depth, std in zip(winners[[0, *(i + 1)]], depths, deviations, strict=True)
    ]


def _votes(labels: "Labels", indices: Array) -> tuple[Array, list[tuple[str, bool]]]:
    """Votes at points (n, 3), (n, 1 + structures), rows sum to 1; of what: name, if an obstacle.

    Where structures overlap the last, which is the smallest, holds the voxel. The kernel, a
    Gaussian times 5/2 - r^2 / 2, has no second moment: it keeps boundaries that curve in place
    where a Gaussian would pull them inwards (Wand and Schucany 1990).
    """
    offsets = np.arange(-REACH_VOXELS, REACH_VOXELS + 1)
    voxels = np.rint(indices).astype(int)[:, :, None] + offsets  # (n, 3, 7)
    squares = ((voxels - indices[:, :, None]) / WIDTH_VOXELS) ** 2
    weights = _outer(np.multiply, np.exp(-0.5 * squares)) * (2.5 - 0.5 * _outer(np.add, squares))
    weights /= weights.sum(axis=(1, 2, 3), keepdims=True)
    inside = (voxels >= 0) & (voxels < np.array(labels.grid.shape)[:, None])
    i, j, k = np.moveaxis(np.where(inside, voxels, 0), 1, 0)
    places = i[:, :, None, None], j[:, None, :, None], k[:, None, None, :]
    ranked = sorted(labels.structures, key=lambda item: -item.voxels)
    found = np.zeros(weights.shape, np.intp)
    for number, volume in enumerate(labels.volumes):
        table = np.zeros(np.iinfo(volume.dtype).max + 1, np.intp)  # from label to rank
        for rank, item in enumerate(ranked, 1):
            if item.volume == number:
                table[item.value] = rank
        np.maximum(found, table[volume[places]], out=found)
    found *= _outer(np.logical_and, inside)  # outside the volume is no structure
    count, size = len(indices), 1 + len(ranked)
    found += size * np.arange(count)[:, None, None, None]
    votes = np.bincount(found.ravel(), weights.ravel(), count * size)
    kinds = [(UNLABELLED, False), *((item.name, item.is_obstacle) for item in ranked)]
    return votes.reshape(count, size).astype(float, copy=False), kinds


def _outer(combine: np.ufunc, parts: NDArray[Any]) -> NDArray[Any]:
    """Combine what belongs to three axes, (n, 3, m), for each voxel of a cube, (n, m, m, m)."""
    x, y, z = np.moveaxis(parts, 1, 0)
    return combine(combine(x[:, :, None, None], y[:, None, :, None]), z[:, None, None, :])
