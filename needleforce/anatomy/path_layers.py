"""What a needle crosses on a straight path.

Around each point of the path every voxel votes for its label, weighted by a smooth
kernel; the label with most votes holds the point. Where the winner changes is a
boundary, refined between two points. The layers therefore follow each other without
gaps or overlaps, which rays through the surfaces of neighbouring structures do not
grant. The votes smooth thin structures away; one that they leave out is a layer all the
same wherever the path runs through one of its voxels. Between two others it begins
where these others' votes say that they end: its own are too few.
"""

from dataclasses import dataclass, replace
from itertools import pairwise, product

import numpy as np
from numpy.typing import ArrayLike

from foundation.arrays import Array
from needleforce.anatomy.errors import VolumeError
from needleforce.anatomy.segmentation import Segmentation
from needleforce.anatomy.structures import Structure

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
        depths_m: Of points on it, at equal steps, (n,).
        ranked: Structures, the largest first; the first one stands for none.
        votes: Of the ranks at each point; a row sums to 1, (n, ranks).
    """

    start: Array
    way: Array
    depths_m: Array
    ranked: list[Structure]
    votes: Array

    @property
    def length_m(self) -> float:
        """From the first point to the last."""
        return float(self.depths_m[-1])

    @property
    def voxel_m(self) -> float:
        """Length of a voxel along the path."""
        return self.length_m / float(np.linalg.norm(self.way))

    def votes_of(self, *names: str) -> Array:
        """Return the votes of some structures together, (n,)."""
        ranks = [rank for rank, item in enumerate(self.ranked) if item.name in names]
        return np.asarray(self.votes[:, ranks].sum(axis=1), dtype=np.float64)


def find_layers(
    labels: Segmentation, entry_m: ArrayLike, target_m: ArrayLike
) -> list[Layer]:
    """Return what a straight path crosses; see `Labels.layers_along`."""
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
    std_m = np.minimum(SIZE_STD * step_m / fall, path.length_m)
    ends_m = pairwise([0.0, *depth_m.tolist(), path.length_m])
    stds_m = pairwise([0.0, *std_m.tolist(), 0.0])
    layers: list[Layer] = []
    for rank, ends, stds in zip([winners[0], *behind], ends_m, stds_m, strict=True):
        item = path.ranked[rank]
        layers.append(Layer(item.name, *ends, *stds, item.is_obstacle))
    for item, begin_m, end_m in _crossings(labels, path):
        # The steps of its voxels along a slanting surface are no layers of their own.
        beside_m = 0.0 if item.is_obstacle else path.voxel_m
        if not any(
            layer.name == item.name
            and layer.entry_m <= end_m + beside_m
            and layer.exit_m >= begin_m - beside_m
            for layer in layers
        ):
            layers = _with_crossing(layers, item, np.array([begin_m, end_m]), path)
    return layers


def _voted_path(labels: Segmentation, entry_m: ArrayLike, target_m: ArrayLike) -> _Path:
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
    outside_m = (np.maximum(-start, start - grid.shape) * grid.spacing_m).max()
    is_inside = np.all((end >= -0.5) & (end <= np.array(grid.shape) - 0.5))
    length_m = float(np.linalg.norm(ends_m[1] - ends_m[0]))
    if not is_inside or outside_m > max_outside_m or length_m == 0.0:
        raise VolumeError(
            f"the target {target_m} lies outside the volume, the entry {entry_m} "
            f"{outside_m:.3g} m outside it, or they are the same point: expected metres"
        )
    none = Structure(UNLABELLED, 0, ())
    ranked = [none, *sorted(labels.structures, key=lambda item: -item.voxels)]
    points = int(np.ceil(np.linalg.norm(end - start) / step_voxels)) + 1
    fractions = np.linspace(0.0, 1.0, points)
    votes = _count_votes(labels, ranked, start + np.outer(fractions, end - start))
    return _Path(start, end - start, fractions * length_m, ranked, votes)


def _count_votes(
    labels: Segmentation, ranked: list[Structure], indices: Array
) -> Array:
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
    cube = np.indices([2 * reach_voxels + 1] * 3).reshape(3, -1).T - reach_voxels
    voxels = np.rint(indices)[:, None] + cube  # (n, 343, 3)
    squares = (((voxels - indices[:, None]) / WIDTH_VOXELS) ** 2).sum(axis=2)
    weights = np.exp(-0.5 * squares) * (2.5 - 0.5 * squares)
    weights /= weights.sum(axis=1, keepdims=True)
    ranks = np.zeros(weights.shape, np.intp)
    for number, volume in enumerate(labels.volumes):
        rank_of_value = np.zeros(np.iinfo(np.uint16).max + 1, np.intp)
        for rank, item in enumerate(ranked[1:], 1):
            if item.volume == number:
                rank_of_value[item.value] = rank
        values = labels.grid.nearest(volume, voxels)
        np.maximum(ranks, rank_of_value[values], out=ranks)
    ranks += len(ranked) * np.arange(len(indices))[:, None]
    votes = np.bincount(ranks.ravel(), weights.ravel(), len(indices) * len(ranked))
    return votes.reshape(len(indices), len(ranked)).astype(float, copy=False)


def _crossings(
    labels: Segmentation, path: _Path
) -> list[tuple[Structure, float, float]]:
    """Return where a path runs through voxels of structures, begin and end, by depth.

    Where structures overlap the smallest counts, and every obstacle.
    """
    tie_voxels = 1e-9  # so near to a face a path runs through both voxels beside it
    cuts = [np.array([0.0, 1.0])]
    for begin, length, size in zip(
        path.start, path.way, labels.grid.shape, strict=True
    ):
        if length != 0.0:
            cuts.append((np.arange(size + 1) - 0.5 - begin) / length)
    fractions = np.unique(np.clip(np.concatenate(cuts), 0.0, 1.0))
    faces_m = path.length_m * fractions
    middles = path.start + np.outer(0.5 * (fractions[:-1] + fractions[1:]), path.way)
    signs = np.array(list(product((-tie_voxels, tie_voxels), repeat=3)))
    around = middles[:, None] + signs
    values = [labels.grid.nearest(volume, around) for volume in labels.volumes]
    is_held = np.zeros(len(middles), bool)
    found: list[tuple[Structure, float, float]] = []
    for item in reversed(path.ranked[1:]):
        if item.name in TISSUES:
            continue
        is_inside = (values[item.volume] == item.value).any(axis=1)
        if not item.is_obstacle:
            is_inside &= ~is_held
        is_held |= is_inside
        edges = np.diff(np.concatenate([[0], is_inside.astype(int), [0]]))
        begins = faces_m[edges > 0].tolist()
        ends = faces_m[edges < 0].tolist()
        found += [(item, *pair) for pair in zip(begins, ends, strict=True)]
    return sorted(found, key=lambda one: one[1])


def _with_crossing(
    layers: list[Layer], item: Structure, faces_m: Array, path: _Path
) -> list[Layer]:
    """Return layers with a stretch through voxels of a structure among them.

    Args:
        layers: Of the path, none of them the structure's there or beside.
        item: The structure.
        faces_m: Depths at which its voxels begin and end, (2,).
        path: The path.
    """
    ends_m = _ends_by_neighbours(layers, item.name, faces_m, path)
    if ends_m is None:
        std_m = _std_of_grazed_m(item.name, faces_m, path)
        ends_m = np.array([faces_m, [std_m, std_m]])
    begin_m, end_m = ends_m[0].tolist()
    is_between = (ends_m[0] > 0.0) & (ends_m[0] < path.length_m)
    stds_m = np.where(is_between, np.minimum(ends_m[1], path.length_m), 0.0)
    begin_std_m, end_std_m = stds_m.tolist()
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
    leader, follower = pairs[0]
    step_m = float(path.depths_m[1])
    ends: list[tuple[float, float]] = []
    for face_m, first, others in (
        (faces_m[0], (leader,), (name, follower)),
        (faces_m[1], (leader, name), (follower,)),
    ):
        lead = path.votes_of(*first) - path.votes_of(*others)
        (index,) = np.nonzero((lead[:-1] > 0.0) & (lead[1:] <= 0.0))
        falls = lead[index] - lead[index + 1]
        depths_m = path.depths_m[index] + step_m * lead[index] / falls
        is_near = np.abs(depths_m - face_m) < path.voxel_m
        if is_near.sum() != 1:
            return None
        ends += zip(depths_m[is_near], SIZE_STD * step_m / falls[is_near], strict=True)
    return np.array(ends).T if ends[0][0] < ends[1][0] else None


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
