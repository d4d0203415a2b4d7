"""What a needle crosses on a straight path.

Around each point of the path every voxel votes for its label, weighted by a smooth
kernel; the label with most votes holds the point. Where the winner changes is a
boundary, refined between two points. The layers therefore follow each other without
gaps or overlaps, which rays through the surfaces of neighbouring structures do not
grant. The votes smooth thin structures away; one that they leave out is a layer all the
same wherever the path runs through one of its voxels. Between two others it begins
where these others' votes say that they end: its own are too few.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foundation.arrays import Array
from needleforce.anatomy.errors import (
    TWO_POINTS,
    VolumeError,
    require_deviation,
)
from needleforce.anatomy.segmentation import Segmentation
from needleforce.anatomy.voxel_walk import Crossing, find_crossings

UNLABELLED = "unlabelled"
"""Name of what no structure covers."""

TISSUES = frozenset(("body", "lean", "fat"))
"""What is found in the CT around the structures, see `Labels.with_body`: its few voxels
between these are no layers."""

WIDTH_VOXELS = 1.2
"""Standard deviation of the kernel."""


STEP_VOXELS = 0.5
"""Distance of points on the path."""


SIZE_STD = 0.105
"""Standard deviation of the difference of two votes, from the voxels' size alone: of
the analytic torso's seeds below 1000, at 1 and 3 mm."""


MIN_FALL = 1e-9
"""Keeps the place of a boundary finite where two labels have the same votes."""


@dataclass(frozen=True)
class Layer:
    """A stretch of the path inside one structure; depths from the entry point.

    Attributes:
        name: Of the structure, or `UNLABELLED`.
        entry_m: Depth at which the needle enters it.
        exit_m: Depth at which it leaves it: the next layer's entry.
        entry_std_m: Standard deviation of the former, 0 at the path's first point.
        exit_std_m: Of the latter, 0 at the path's last point.
        is_obstacle: Bone or cartilage.
    """

    name: str
    entry_m: float
    exit_m: float
    entry_std_m: float
    exit_std_m: float
    is_obstacle: bool


class _Candidate(NamedTuple):
    """What a point of the path may belong to.

    Attributes:
        name: Of the structure, or `UNLABELLED`.
        is_obstacle: Bone or cartilage.
    """

    name: str
    is_obstacle: bool


class _Path(NamedTuple):
    """A straight path through a grid.

    Attributes:
        start: Index of its first point, with fractions, shape (3,).
        way: From there to its last point, in indices, shape (3,).
        length_m: From the first point to the last.
    """

    start: Array
    way: Array
    length_m: float

    @property
    def voxel_m(self) -> float:
        """Length of a voxel along the path."""
        return self.length_m / float(np.linalg.norm(self.way))

    def indices(self, fractions: Array) -> Array:
        """Return the indices (n, 3) at fractions (n,) of the path."""
        return self.start + fractions[:, None] * self.way


class _Boundaries(NamedTuple):
    """Where the winner of the votes changes along a path, arrays of shape (n,).

    Attributes:
        depth_m: Of each boundary.
        rank_before: Of the winner before it.
        rank_behind: Of the winner behind it.
        step_m: Distance of the points on the path beside it.
        fall: By how many votes the lead of the winner falls between them.
    """

    depth_m: Array
    rank_before: NDArray[np.intp]
    rank_behind: NDArray[np.intp]
    step_m: Array
    fall: Array


class _Votes(NamedTuple):
    """Votes at points of a path.

    Attributes:
        depths_m: Of the points, at equal steps, (n,).
        shares: Of the candidates at each point, (n, candidates).
        candidates: By rank.
    """

    depths_m: Array
    shares: Array
    candidates: list[_Candidate]

    def of(self, *names: str) -> Array:
        """Return the share of some candidates together, (n,)."""
        ranks = [rank for rank, one in enumerate(self.candidates) if one.name in names]
        return np.asarray(self.shares[:, ranks].sum(axis=1), dtype=np.float64)


class _End(NamedTuple):
    """Where a layer begins or ends.

    Attributes:
        depth_m: Along the path.
        std_m: Its standard deviation.
    """

    depth_m: float
    std_m: float


def find_layers(
    labels: Segmentation,
    entry_m: ArrayLike,
    target_m: ArrayLike,
    boundary_std_m: float = 0.0,
) -> list[Layer]:
    """Return what a straight path crosses; see `Labels.layers_along`."""
    if boundary_std_m != 0.0:
        require_deviation("boundary_std_m", boundary_std_m, VolumeError)
    path = _checked_path(labels, entry_m, target_m)
    length_voxels = np.linalg.norm(path.way)
    points = int(np.ceil(length_voxels / STEP_VOXELS)) + 1
    fractions = np.linspace(0.0, 1.0, points)
    votes, candidates = _count_votes(labels, path.indices(fractions))
    winners = votes.argmax(axis=1)
    boundaries = _find_boundaries(path, fractions, votes, winners)
    std_m = _boundary_std_m(labels, path, boundaries, boundary_std_m)
    holders = [candidates[rank] for rank in (winners[0], *boundaries.rank_behind)]
    layers = _stack_layers(
        holders,
        depths_m=[0.0, *boundaries.depth_m.tolist(), path.length_m],
        stds_m=[0.0, *np.minimum(std_m, path.length_m).tolist(), 0.0],
    )
    structures = [item for item in labels.structures if item.name not in TISSUES]
    counted = _Votes(fractions * path.length_m, votes, candidates)
    for crossing in find_crossings(labels.volumes, structures, path.start, path.way):
        layers = _with_crossing(layers, crossing, path, counted, boundary_std_m)
    return layers


def _with_crossing(
    layers: Sequence[Layer],
    crossing: Crossing,
    path: _Path,
    votes: _Votes,
    boundary_std_m: float,
) -> list[Layer]:
    """Return layers with a stretch through voxels of a structure among them.

    Where the votes have that structure there or beside, the layers stay as they are.
    """
    begin_m = crossing.begin * path.length_m
    end_m = crossing.end * path.length_m
    item = crossing.structure
    # The steps of its voxels along a slanting surface are no layers of their own.
    beside_m = 0.0 if item.is_obstacle else path.voxel_m
    has_layer = any(
        layer.name == item.name
        and layer.entry_m <= end_m + beside_m
        and layer.exit_m >= begin_m - beside_m
        for layer in layers
    )
    if has_layer:
        return list(layers)
    ends = _ends_by_neighbours(layers, crossing, path, votes)
    if ends is None:
        std_m = _std_of_grazed_m(crossing, path, votes)
        ends = _End(begin_m, std_m), _End(end_m, std_m)
    (begin_m, begin_std_m), (end_m, end_std_m) = ends
    begin_std_m = np.hypot(begin_std_m, boundary_std_m) if begin_m > 0.0 else 0.0
    is_within = end_m < path.length_m
    end_std_m = np.hypot(end_std_m, boundary_std_m) if is_within else 0.0
    begin_std_m = min(float(begin_std_m), path.length_m)
    end_std_m = min(float(end_std_m), path.length_m)
    before = [
        layer
        if layer.exit_m <= begin_m
        else replace(layer, exit_m=begin_m, exit_std_m=begin_std_m)
        for layer in layers
        if layer.entry_m < begin_m
    ]
    behind = [
        layer
        if layer.entry_m >= end_m
        else replace(layer, entry_m=end_m, entry_std_m=end_std_m)
        for layer in layers
        if layer.exit_m > end_m
    ]
    stds_m = (begin_std_m, end_std_m)
    crossed = Layer(item.name, begin_m, end_m, *stds_m, item.is_obstacle)
    return [*before, crossed, *behind]


def _ends_by_neighbours(
    layers: Sequence[Layer], crossing: Crossing, path: _Path, votes: _Votes
) -> tuple[_End, _End] | None:
    """Return where the layers on both sides of a thin one say that they end.

    None where there are no two such layers, or where they say something else than the
    faces of its voxels, which are right to within one.
    """
    faces_m = path.length_m * np.array([crossing.begin, crossing.end])
    pairs = [
        (leader.name, follower.name)
        for leader, follower in pairwise(layers)
        if faces_m[0] < leader.exit_m < faces_m[1]
    ]
    if len(pairs) != 1:
        return None
    ((leader, follower),) = pairs
    name = crossing.structure.name
    leads = (
        votes.of(leader) - votes.of(name, follower),
        votes.of(leader, name) - votes.of(follower),
    )
    step_m = float(votes.depths_m[1])
    ends: list[_End] = []
    for lead, face_m in zip(leads, faces_m, strict=True):
        (index,) = np.nonzero((lead[:-1] > 0.0) & (lead[1:] <= 0.0))
        falls = lead[index] - lead[index + 1]
        depths_m = votes.depths_m[index] + step_m * lead[index] / falls
        is_near = np.abs(depths_m - face_m) < path.voxel_m
        if np.count_nonzero(is_near) != 1:
            return None
        std_m = SIZE_STD * step_m / float(falls[is_near][0])
        ends.append(_End(float(depths_m[is_near][0]), std_m))
    begin, end = ends
    return (begin, end) if begin.depth_m < end.depth_m else None


def _std_of_grazed_m(crossing: Crossing, path: _Path, votes: _Votes) -> float:
    """Return the standard deviation of the ends of a layer that the path grazes.

    Near the middle of the layer its share of the votes is a parabola: an error of the
    votes moves the ends the further the flatter it is.
    """
    around_voxels = 2.5  # from the middle, in which the parabola is fitted
    least_curvature = 0.02  # per voxel squared: three voxels, more was not seen
    middle_m = 0.5 * (crossing.begin + crossing.end) * path.length_m
    offsets = (votes.depths_m - middle_m) / path.voxel_m
    is_near = np.abs(offsets) <= around_voxels
    curvature = 0.0
    if np.count_nonzero(is_near) > 3:
        share = votes.of(crossing.structure.name)[is_near]
        # Of the lead of what is around it: that loses what this one gains.
        curvature = -4.0 * float(np.polyfit(offsets[is_near], share, 2)[0])
    curvature = max(curvature, least_curvature)
    return path.voxel_m * float(np.sqrt(2.0 * SIZE_STD / curvature))


def _stack_layers(
    holders: Sequence[_Candidate], depths_m: Sequence[float], stds_m: Sequence[float]
) -> list[Layer]:
    """Return layers between depths that follow each other.

    Args:
        holders: What each layer belongs to.
        depths_m: Where the first layer begins, and where each ends.
        stds_m: Standard deviations of these depths.
    """
    return [
        Layer(holder.name, entry_m, exit_m, entry_std_m, exit_std_m, holder.is_obstacle)
        for holder, (entry_m, exit_m), (entry_std_m, exit_std_m) in zip(
            holders, pairwise(depths_m), pairwise(stds_m), strict=True
        )
    ]


def _checked_path(
    labels: Segmentation, entry_m: ArrayLike, target_m: ArrayLike
) -> _Path:
    """Return the path between two points that lie where a needle's can."""
    # Of the first point from the volume; beyond it the unit is not the metre.
    max_outside_m = 1.0
    entry = np.asarray(entry_m, float)
    target = np.asarray(target_m, float)
    has_shape = entry.shape == (3,) and target.shape == (3,)
    if not has_shape or not np.all(np.isfinite([entry, target])):
        raise VolumeError(
            f"entry {entry_m} and target {target_m}: expected two points of 3 numbers",
            TWO_POINTS,
        )
    grid = labels.grid
    start, end = grid.indices(np.array([entry, target]))
    if np.any(end < -0.5) or np.any(end > np.array(grid.shape) - 0.5):
        raise VolumeError(
            f"the target {target.tolist()} m lies outside the volume", TWO_POINTS
        )
    outside_m = np.maximum(-start, start - grid.shape) * grid.spacing_m
    if outside_m.max() > max_outside_m:
        raise VolumeError(
            f"the entry {entry.tolist()} lies {outside_m.max():.3g} m outside the "
            "volume: expected metres, not millimetres",
            TWO_POINTS,
        )
    if np.linalg.norm(end - start) == 0.0:
        raise VolumeError(
            f"entry and target are the same point {entry.tolist()}", TWO_POINTS
        )
    return _Path(start, end - start, float(np.linalg.norm(target - entry)))


def _find_boundaries(
    path: _Path, fractions: Array, votes: Array, winners: NDArray[np.intp]
) -> _Boundaries:
    """Return where the winner changes: it leads before a boundary, trails behind it."""
    (index,) = np.nonzero(np.diff(winners))
    rank_before = winners[index]
    rank_behind = winners[index + 1]
    step_m = np.diff(fractions)[index] * path.length_m
    lead = votes[index, rank_before] - votes[index, rank_behind]
    trail = votes[index + 1, rank_behind] - votes[index + 1, rank_before]
    fall = np.maximum(lead + trail, MIN_FALL)
    depth_m = fractions[index] * path.length_m + step_m * lead / fall
    return _Boundaries(depth_m, rank_before, rank_behind, step_m, fall)


def _boundary_std_m(
    labels: Segmentation, path: _Path, boundaries: _Boundaries, boundary_std_m: float
) -> Array:
    """Return the standard deviations of boundaries along the path, shape (n,)."""
    votes_per_m: Array | float = 0.0
    if boundary_std_m and len(boundaries.depth_m):
        indices = path.indices(boundaries.depth_m / path.length_m)
        votes_per_m = _votes_per_m(labels, indices, boundaries)
    vote_std = np.hypot(SIZE_STD, boundary_std_m * votes_per_m)
    return vote_std * boundaries.step_m / boundaries.fall


def _count_votes(
    labels: Segmentation, indices: Array
) -> tuple[Array, list[_Candidate]]:
    """Count the votes of the voxels around points.

    Where structures overlap the last, which is the smallest, holds the voxel. The
    kernel, a Gaussian times 5/2 - r^2 / 2, has no second moment: it keeps boundaries
    that curve in place where a Gaussian would pull them inwards (Wand and Schucany
    1990).

    Args:
        labels: The segmentation.
        indices: Of the points, with fractions, shape (n, 3).

    Returns:
        Votes (n, candidates), whose rows sum to 1, and the candidates by rank.
    """
    # Half the side of the cube in which voxels vote: two and a half standard
    # deviations.
    reach_voxels = 3
    offsets = np.arange(-reach_voxels, reach_voxels + 1)
    voxels = np.rint(indices).astype(int)[:, :, None] + offsets  # (n, 3, 7)
    squares = ((voxels - indices[:, :, None]) / WIDTH_VOXELS) ** 2
    weights = _combine_axes(np.multiply, np.exp(-0.5 * squares)) * (
        2.5 - 0.5 * _combine_axes(np.add, squares)
    )
    weights /= weights.sum(axis=(1, 2, 3), keepdims=True)
    ranked = sorted(labels.structures, key=lambda item: -item.voxels)
    is_inside = (voxels >= 0) & (voxels < np.array(labels.grid.shape)[:, None])
    ranks = _ranks_of_voxels(labels, np.where(is_inside, voxels, 0))
    ranks *= _combine_axes(np.logical_and, is_inside)  # outside is no structure
    count = len(indices)
    size = 1 + len(ranked)
    ranks += size * np.arange(count)[:, None, None, None]
    votes = np.bincount(ranks.ravel(), weights.ravel(), count * size)
    candidates = [
        _Candidate(UNLABELLED, False),
        *(_Candidate(item.name, item.is_obstacle) for item in ranked),
    ]
    return votes.reshape(count, size).astype(float, copy=False), candidates


def _ranks_of_voxels(labels: Segmentation, voxels: NDArray[Any]) -> NDArray[np.intp]:
    """Return the rank of the structure in each voxel of cubes, (n, m, m, m).

    Args:
        labels: Their structures are ranked by size, from 1 for the largest; 0 is none.
        voxels: Indices along each axis, shape (n, 3, m).
    """
    i, j, k = np.moveaxis(voxels, 1, 0)
    places = (i[:, :, None, None], j[:, None, :, None], k[:, None, None, :])
    ranked = sorted(labels.structures, key=lambda item: -item.voxels)
    side = voxels.shape[2]
    ranks = np.zeros((len(voxels), side, side, side), np.intp)
    for number, volume in enumerate(labels.volumes):
        rank_by_value = {
            item.value: rank
            for rank, item in enumerate(ranked, 1)
            if item.volume == number
        }
        table = np.zeros(max(rank_by_value, default=0) + 2, np.intp)
        table[list(rank_by_value)] = list(rank_by_value.values())
        values = np.clip(volume[places], 0, len(table) - 1)
        np.maximum(ranks, table[values], out=ranks)
    return ranks


def _votes_per_m(
    labels: Segmentation, indices: Array, boundaries: _Boundaries
) -> Array:
    """Return by how many votes the lead falls per metre along the boundaries' normals.

    Across a flat boundary it falls by 2 k(0) a voxel, k the kernel in one dimension;
    how long a voxel is there depends on the normal.

    Args:
        labels: The segmentation.
        indices: Of the boundaries, with fractions, shape (n, 3).
        boundaries: The same boundaries.
    """
    # Distance at which the votes around a boundary show its normal.
    normal_step_voxels = 0.5
    steps = normal_step_voxels * np.vstack((np.eye(3), -np.eye(3)))
    around = indices[:, None] + steps
    votes, candidates = _count_votes(labels, around.reshape(-1, 3))
    votes = votes.reshape(len(indices), 6, len(candidates))
    rows = np.arange(len(indices))
    lead = (
        votes[rows, :, boundaries.rank_before] - votes[rows, :, boundaries.rank_behind]
    )
    gradient = lead[:, :3] - lead[:, 3:]  # votes per voxel along each axis
    per_voxel = np.maximum(np.linalg.norm(gradient, axis=1), MIN_FALL)
    gradient_per_m = gradient @ np.linalg.inv(labels.grid.axes_m)
    voxels_per_m = np.linalg.norm(gradient_per_m, axis=1) / per_voxel
    return 3.0 / (np.sqrt(2.0 * np.pi) * WIDTH_VOXELS) * voxels_per_m


def _combine_axes(combine: np.ufunc, parts: NDArray[Any]) -> NDArray[Any]:
    """Combine what belongs to three axes for each voxel of a cube.

    Args:
        combine: Of two arrays.
        parts: Shape (n, 3, m); the result is (n, m, m, m).
    """
    x, y, z = np.moveaxis(parts, 1, 0)
    in_plane = combine(x[:, :, None, None], y[:, None, :, None])
    return combine(in_plane, z[:, None, None, :])
