"""What a needle crosses on a straight path.

Around each point of the path every voxel votes for its label, weighted by a smooth
kernel; the label with most votes holds the point. Where the winner changes is a
boundary, refined between two points. The layers therefore follow each other without
gaps or overlaps, which rays through the surfaces of neighbouring structures do not
grant. The votes smooth thin structures away; one that they leave out is a layer all the
same wherever the path runs through one of its voxels. Between two others it begins
where these others' votes say that they end: its own are too few.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise, product
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foundation.arrays import Array
from needleforce.anatomy.errors import VolumeError, require_deviation
from needleforce.anatomy.structures import Structure

if TYPE_CHECKING:
    from needleforce.anatomy.labels import Labels

UNLABELLED = "unlabelled"
"""Name of what no structure covers."""

TISSUES = frozenset(("body", "lean", "fat"))
"""What is found in the CT around the structures, see `Labels.with_body`: its few voxels
between these are no layers."""

WIDTH_VOXELS = 1.2
"""Standard deviation of the kernel."""

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


@dataclass(frozen=True, eq=False)
class _Path:
    """A straight path through labels, and the votes around its points.

    Attributes:
        start: Index of its first point, with fractions, (3,).
        way: From there to its last point, in indices, (3,).
        length_m: From the first point to the last.
        depths_m: Of points on it, at equal steps, (n,).
        ranked: Structures, the largest first: rank 1 and on; rank 0 is none.
        votes: Of the ranks at each point; a row sums to 1, (n, ranks).
    """

    start: Array
    way: Array
    length_m: float
    depths_m: Array
    ranked: list[Structure]
    votes: Array

    @property
    def voxel_m(self) -> float:
        """Length of a voxel along the path."""
        return self.length_m / float(np.linalg.norm(self.way))

    def indices(self, depths_m: Array) -> Array:
        """Return the indices (n, 3) at depths (n,)."""
        return self.start + np.outer(depths_m / self.length_m, self.way)

    def votes_of(self, *names: str) -> Array:
        """Return the votes of some structures together, (n,)."""
        all_names = (UNLABELLED, *(item.name for item in self.ranked))
        ranks = [rank for rank, name in enumerate(all_names) if name in names]
        return np.asarray(self.votes[:, ranks].sum(axis=1), dtype=np.float64)


def find_layers(
    labels: "Labels",
    entry_m: ArrayLike,
    target_m: ArrayLike,
    boundary_std_m: float = 0.0,
) -> list[Layer]:
    """Return what a straight path crosses; see `Labels.layers_along`."""
    if boundary_std_m != 0.0:
        require_deviation("boundary_std_m", boundary_std_m, VolumeError)
    path = _voted_path(labels, entry_m, target_m)
    winners = path.votes.argmax(axis=1)
    (index,) = np.nonzero(np.diff(winners))
    before = winners[index]
    behind = winners[index + 1]
    # It leads before a boundary and trails behind it.
    lead = path.votes[index, before] - path.votes[index, behind]
    trail = path.votes[index + 1, behind] - path.votes[index + 1, before]
    fall = np.maximum(lead + trail, MIN_FALL)
    step_m = path.depths_m[1]
    depth_m = path.depths_m[index] + step_m * lead / fall
    vote_std: Array | float = SIZE_STD
    if boundary_std_m and len(index):
        votes_per_m = _votes_per_m(labels, path, depth_m, before, behind)
        vote_std = np.hypot(SIZE_STD, boundary_std_m * votes_per_m)
    std_m = np.minimum(vote_std * step_m / fall, path.length_m)
    ends_m = pairwise([0.0, *depth_m.tolist(), path.length_m])
    stds_m = pairwise([0.0, *std_m.tolist(), 0.0])
    layers: list[Layer] = []
    for rank, ends, stds in zip([winners[0], *behind], ends_m, stds_m, strict=True):
        item = path.ranked[rank - 1] if rank else None
        name = UNLABELLED if item is None else item.name
        layers.append(Layer(name, *ends, *stds, item is not None and item.is_obstacle))
    for item, begin_m, end_m in _crossings(labels, path):
        # The steps of its voxels along a slanting surface are no layers of their own.
        beside_m = 0.0 if item.is_obstacle else path.voxel_m
        if not any(
            layer.name == item.name
            and layer.entry_m <= end_m + beside_m
            and layer.exit_m >= begin_m - beside_m
            for layer in layers
        ):
            faces_m = np.array([begin_m, end_m])
            layers = _with_crossing(layers, item, faces_m, path, boundary_std_m)
    return layers


def _voted_path(labels: "Labels", entry_m: ArrayLike, target_m: ArrayLike) -> _Path:
    """Return the path between two points that lie where a needle's can."""
    max_outside_m = 1.0  # of the first point; beyond it the unit is not the metre
    step_voxels = 0.5  # distance of points on the path
    ends_m = [np.asarray(entry_m, float), np.asarray(target_m, float)]
    has_shape = ends_m[0].shape == ends_m[1].shape == (3,)
    if not has_shape or not np.all(np.isfinite(ends_m)):
        raise VolumeError(
            f"entry {entry_m} and target {target_m}: expected two points of 3 numbers"
        )
    grid = labels.grid
    start, end = grid.indices(np.array(ends_m))
    if np.any(end < -0.5) or np.any(end > np.array(grid.shape) - 0.5):
        raise VolumeError(f"the target {target_m} m lies outside the volume")
    outside_m = (np.maximum(-start, start - grid.shape) * grid.spacing_m).max()
    length_m = float(np.linalg.norm(ends_m[1] - ends_m[0]))
    if outside_m > max_outside_m or length_m == 0.0:
        raise VolumeError(
            f"the entry {entry_m} lies {outside_m:.3g} m outside the volume, or is the "
            "same point as the target: expected metres"
        )
    ranked = sorted(labels.structures, key=lambda item: -item.voxels)
    points = int(np.ceil(np.linalg.norm(end - start) / step_voxels)) + 1
    fractions = np.linspace(0.0, 1.0, points)
    votes = _count_votes(labels, ranked, start + np.outer(fractions, end - start))
    return _Path(start, end - start, length_m, fractions * length_m, ranked, votes)


def _count_votes(labels: "Labels", ranked: list[Structure], indices: Array) -> Array:
    """Count the votes of the voxels around points, (n, ranks).

    Where structures overlap the last, which is the smallest, holds the voxel. The
    kernel, a Gaussian times 5/2 - r^2 / 2, has no second moment: it keeps boundaries
    that curve in place where a Gaussian would pull them inwards (Wand and Schucany
    1990).

    Args:
        labels: The segmentation.
        ranked: Its structures, the largest first.
        indices: Of the points, with fractions, (n, 3).
    """
    # Half the side of the cube in which voxels vote: two and a half deviations.
    reach_voxels = 3
    offsets = np.arange(-reach_voxels, reach_voxels + 1)
    voxels = np.rint(indices).astype(int)[:, :, None] + offsets  # (n, 3, 7)
    squares = ((voxels - indices[:, :, None]) / WIDTH_VOXELS) ** 2
    weights = _combine_axes(np.multiply, np.exp(-0.5 * squares)) * (
        2.5 - 0.5 * _combine_axes(np.add, squares)
    )
    weights /= weights.sum(axis=(1, 2, 3), keepdims=True)
    is_inside = (voxels >= 0) & (voxels < np.array(labels.grid.shape)[:, None])
    i, j, k = np.moveaxis(np.where(is_inside, voxels, 0), 1, 0)
    places = (i[:, :, None, None], j[:, None, :, None], k[:, None, None, :])
    ranks = np.zeros(weights.shape, np.intp)
    for number, volume in enumerate(labels.volumes):
        own = {
            item.value: k for k, item in enumerate(ranked, 1) if item.volume == number
        }
        table = np.zeros(max(own, default=0) + 2, np.intp)
        table[list(own)] = list(own.values())
        np.maximum(ranks, table[np.clip(volume[places], 0, len(table) - 1)], out=ranks)
    ranks *= _combine_axes(np.logical_and, is_inside)  # outside is no structure
    size = 1 + len(ranked)
    ranks += size * np.arange(len(indices))[:, None, None, None]
    votes = np.bincount(ranks.ravel(), weights.ravel(), len(indices) * size)
    return votes.reshape(len(indices), size).astype(float, copy=False)


def _combine_axes(combine: np.ufunc, parts: NDArray[Any]) -> NDArray[Any]:
    """Combine what belongs to three axes for each voxel of a cube.

    Args:
        combine: Of two arrays.
        parts: Shape (n, 3, m); the result is (n, m, m, m).
    """
    x, y, z = np.moveaxis(parts, 1, 0)
    in_plane = combine(x[:, :, None, None], y[:, None, :, None])
    return combine(in_plane, z[:, None, None, :])


def _votes_per_m(
    labels: "Labels",
    path: _Path,
    depths_m: Array,
    before: NDArray[np.intp],
    behind: NDArray[np.intp],
) -> Array:
    """Return by how many votes the lead falls per metre along the boundaries' normals.

    Across a flat boundary it falls by 2 k(0) a voxel, k the kernel in one dimension;
    how long a voxel is there depends on the normal.

    Args:
        labels: The segmentation.
        path: Through it.
        depths_m: Of the boundaries, (n,).
        before: Rank of the winner before each, (n,).
        behind: Rank of the winner behind, (n,).
    """
    normal_step_voxels = 0.5  # at which the votes around a boundary show its normal
    steps = normal_step_voxels * np.vstack((np.eye(3), -np.eye(3)))
    around = path.indices(depths_m)[:, None] + steps
    votes = _count_votes(labels, path.ranked, around.reshape(-1, 3))
    votes = votes.reshape(len(depths_m), 6, -1)
    rows = np.arange(len(depths_m))
    lead = votes[rows, :, before] - votes[rows, :, behind]
    gradient = lead[:, :3] - lead[:, 3:]  # votes per voxel along each axis
    per_voxel = np.maximum(np.linalg.norm(gradient, axis=1), MIN_FALL)
    per_m = np.linalg.norm(gradient @ np.linalg.inv(labels.grid.axes_m), axis=1)
    return 3.0 / (np.sqrt(2.0 * np.pi) * WIDTH_VOXELS) * per_m / per_voxel


def _crossings(
    labels: "Labels", path: _Path
) -> Iterator[tuple[Structure, float, float]]:
    """Yield where a path runs through voxels of structures, begin and end, by depth.

    Where structures overlap the smallest counts, and every obstacle.
    """
    tie_voxels = 1e-9  # so near to a face a path runs through both voxels beside it
    cuts = [np.array([0.0, 1.0])]
    for begin, length in zip(path.start.tolist(), path.way.tolist(), strict=True):
        if length != 0.0:
            low, high = sorted((begin, begin + length))
            faces = np.arange(np.ceil(low - 0.5), np.floor(high - 0.5) + 1.0) + 0.5
            cuts.append((faces - begin) / length)
    faces_m = path.length_m * np.unique(np.clip(np.concatenate(cuts), 0.0, 1.0))
    middles = path.indices(0.5 * (faces_m[:-1] + faces_m[1:]))
    signs = np.array(list(product((-tie_voxels, tie_voxels), repeat=3)))
    voxels = np.rint(middles[:, None] + signs).astype(int)
    is_valid = np.all((voxels >= 0) & (voxels < labels.grid.shape), axis=-1)
    places = tuple(np.moveaxis(np.where(is_valid[..., None], voxels, 0), -1, 0))
    values = [np.where(is_valid, volume[places], 0) for volume in labels.volumes]
    is_held = np.zeros(len(middles), bool)
    found: list[tuple[Structure, float, float]] = []
    for item in sorted(path.ranked, key=lambda one: one.voxels):
        if item.name in TISSUES:
            continue
        is_inside = (values[item.volume] == item.value).any(axis=1)
        if not item.is_obstacle:
            is_inside &= ~is_held
        is_held |= is_inside
        edges = np.diff(np.concatenate([[0], is_inside.astype(int), [0]]))
        begins = faces_m[np.flatnonzero(edges > 0)].tolist()
        ends = faces_m[np.flatnonzero(edges < 0)].tolist()
        found += [(item, *pair) for pair in zip(begins, ends, strict=True)]
    yield from sorted(found, key=lambda one: one[1])


def _with_crossing(
    layers: list[Layer],
    item: Structure,
    faces_m: Array,
    path: _Path,
    boundary_std_m: float,
) -> list[Layer]:
    """Return layers with a stretch through voxels of a structure among them.

    Args:
        layers: Of the path, none of them the structure's there or beside.
        item: The structure.
        faces_m: Depths at which its voxels begin and end, (2,).
        path: The path.
        boundary_std_m: Of the segmentation's boundaries.
    """
    ends_m = _ends_by_neighbours(layers, item.name, faces_m, path)
    if ends_m is None:
        std_m = _std_of_grazed_m(item.name, faces_m, path)
        ends_m = np.array([faces_m, [std_m, std_m]])
    begin_m, end_m = ends_m[0].tolist()
    stds_m = np.minimum(np.hypot(ends_m[1], boundary_std_m), path.length_m)
    is_between = (ends_m[0] > 0.0) & (ends_m[0] < path.length_m)
    begin_std_m, end_std_m = np.where(is_between, stds_m, 0.0).tolist()
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
    stds = (begin_std_m, end_std_m)
    return [*before, Layer(item.name, begin_m, end_m, *stds, item.is_obstacle), *behind]


def _ends_by_neighbours(
    layers: list[Layer], name: str, faces_m: Array, path: _Path
) -> Array | None:
    """Return where the layers on both sides of a thin one say that they end.

    Returns:
        Depths and standard deviations of begin and end, (2, 2); None where there are
        no two such layers, or where they say something else than the faces of its
        voxels, which are right to within one.
    """
    pairs = [
        (leader.name, follower.name)
        for leader, follower in pairwise(layers)
        if faces_m[0] < leader.exit_m < faces_m[1]
    ]
    if len(pairs) != 1:
        return None
    ((leader, follower),) = pairs
    leads = (
        path.votes_of(leader) - path.votes_of(name, follower),
        path.votes_of(leader, name) - path.votes_of(follower),
    )
    step_m = float(path.depths_m[1])
    ends: list[tuple[float, float]] = []
    for lead, face_m in zip(leads, faces_m.tolist(), strict=True):
        (index,) = np.nonzero((lead[:-1] > 0.0) & (lead[1:] <= 0.0))
        falls = lead[index] - lead[index + 1]
        depths_m = path.depths_m[index] + step_m * lead[index] / falls
        is_near = np.abs(depths_m - face_m) < path.voxel_m
        if np.count_nonzero(is_near) != 1:
            return None
        ends += zip(depths_m[is_near], SIZE_STD * step_m / falls[is_near], strict=True)
    ends_m = np.array(ends).T
    return ends_m if ends_m[0, 0] < ends_m[0, 1] else None


def _std_of_grazed_m(name: str, faces_m: Array, path: _Path) -> float:
    """Return the standard deviation of the ends of a layer that the path grazes.

    Near the middle of the layer its fraction of the votes is a parabola: an error of
    the votes moves the ends the further the flatter it is.
    """
    around_voxels = 2.5  # from the middle, in which the parabola is fitted
    least_curvature = 0.02  # per voxel squared: three voxels, more was not seen
    offsets = (path.depths_m - faces_m.mean()) / path.voxel_m
    is_near = np.abs(offsets) <= around_voxels + 1e-9
    curvature = 0.0
    if np.count_nonzero(is_near) > 3:
        votes = path.votes_of(name)[is_near]
        # Of the lead of what is around it: that loses what this one gains.
        curvature = -4.0 * float(np.polyfit(offsets[is_near], votes, 2)[0])
    curvature = max(curvature, least_curvature)
    return path.voxel_m * float(np.sqrt(2.0 * SIZE_STD / curvature))
