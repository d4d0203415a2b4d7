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
from dataclasses import dataclass
from itertools import compress, product

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foundation.arrays import Array
from needleforce.anatomy.errors import VolumeError
from needleforce.anatomy.volume import Segmentation, Structure

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
        ends: Indices of its first and its last point, with fractions, (2, 3).
        depths_m: Of points on it, at equal steps, (n,).
        ranked: Structures, the largest first; the first one stands for none.
        votes: Of the ranks at each point; a row sums to 1, (n, ranks).
    """

    ends: Array
    depths_m: Array
    ranked: list[Structure]
    votes: Array

    @property
    def voxel_m(self) -> float:
        """Length of a voxel along the path."""
        return float(self.depths_m[-1] / np.linalg.norm(self.ends[1] - self.ends[0]))

    def votes_of(self, *names: str) -> Array:
        """Return the votes of some structures together, (n,)."""
        ranks = [rank for rank, item in enumerate(self.ranked) if item.name in names]
        return np.asarray(self.votes[:, ranks].sum(axis=1), dtype=np.float64)

    def boundaries(
        self, index: NDArray[np.integer], lead: Array, next_lead: Array
    ) -> Array:
        """Return depths and standard deviations of boundaries, (2, n).

        Args:
            index: Of the last point in front of each, (n,).
            lead: By so much the structure in front of it has more votes there.
            next_lead: Likewise at the next point: not positive.
        """
        min_fall = 1e-9  # keeps the place finite where two have the same votes
        fall = np.maximum(lead - next_lead, min_fall)
        step_m = self.depths_m[1]
        depths_m = self.depths_m[index] + step_m * lead / fall
        return np.array([depths_m, SIZE_STD * step_m / fall])


def find_layers(
    labels: Segmentation, entry_m: ArrayLike, target_m: ArrayLike
) -> list[Layer]:
    """Return what a straight path crosses; see `Labels.layers_along`."""
    path = _voted_path(labels, entry_m, target_m)
    winners = path.votes.argmax(axis=1)
    (index,) = np.nonzero(np.diff(winners))
    changes = np.array([winners[index], winners[index + 1]])
    lead, next_lead = (
        path.votes[at, changes[0]] - path.votes[at, changes[1]]
        for at in (index, index + 1)
    )
    items = [path.ranked[rank] for rank in [winners[0], *changes[1]]]
    # Depths and deviations of where layers begin and end, (2, layers + 1).
    cuts = np.zeros((2, len(items) + 1))
    cuts[:, 1:-1] = path.boundaries(index, lead, next_lead)
    cuts[0, -1] = path.depths_m[-1]
    for item, faces_m in sorted(_crossings(labels, path), key=lambda one: one[1][0]):
        # The steps of its voxels along a slanting surface are no layers of their own.
        beside_m = 0.0 if item.is_obstacle else path.voxel_m
        is_met = cuts[0, :-1] <= faces_m[1] + beside_m
        is_met &= cuts[0, 1:] >= faces_m[0] - beside_m
        if item not in compress(items, is_met):
            ends = _ends_by_neighbours(items, cuts[0], item.name, faces_m, path)
            if ends is None:
                ends = np.array(
                    [faces_m, [_std_of_grazed_m(item.name, faces_m, path)] * 2]
                )
            first = int(np.searchsorted(cuts[0], ends[0, 0]))
            last = int(np.searchsorted(cuts[0], ends[0, 1], "right"))
            cuts = np.hstack([cuts[:, :first], ends, cuts[:, last:]])
            items = [*items[:first], item, *items[last - 1 :]]
    cuts[1] = np.minimum(cuts[1], path.depths_m[-1])
    cuts[1, (cuts[0] <= 0.0) | (cuts[0] >= path.depths_m[-1])] = 0.0
    bounds = cuts.T.tolist()
    return [
        Layer(item.name, begin[0], end[0], begin[1], end[1], item.is_obstacle)
        for item, begin, end in zip(items, bounds[:-1], bounds[1:], strict=True)
    ]


def _voted_path(labels: Segmentation, entry_m: ArrayLike, target_m: ArrayLike) -> _Path:
    """Return the path between two points that lie where a needle's can."""
    max_outside_m = 1.0  # of the first point; beyond it the unit is not the metre
    step_voxels = 0.5  # distance of points on the path
    ends_m = np.array([entry_m, target_m], float)
    ends = labels.grid.indices(ends_m)
    beyond = np.maximum(-0.5 - ends, ends + 0.5 - labels.grid.shape)
    outside_m = (beyond * labels.grid.spacing_m).max(axis=1)
    length_m = float(np.linalg.norm(ends_m[1] - ends_m[0]))
    if not (outside_m[0] <= max_outside_m and outside_m[1] <= 0.0 < length_m):
        raise VolumeError(
            f"a path from {entry_m} to {target_m}: expected two points in metres, the "
            "target in the volume, the entry less than 1 m outside it"
        )
    none = Structure(UNLABELLED, 0, ())
    ranked = [none, *sorted(labels.structures, key=lambda item: -item.voxels)]
    steps = int(np.ceil(np.linalg.norm(ends[1] - ends[0]) / step_voxels))
    fractions = np.linspace(0.0, 1.0, steps + 1)
    points = ends[0] + np.outer(fractions, ends[1] - ends[0])
    votes = _count_votes(labels, ranked, points)
    return _Path(ends, fractions * length_m, ranked, votes)


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
    rank_of_value = np.zeros((len(labels.volumes), 2**16), np.intp)
    for rank, item in enumerate(ranked[1:], 1):
        rank_of_value[item.volume, item.value] = rank
    volumes = zip(rank_of_value, labels.volumes, strict=True)
    held = [rank_of[labels.grid.nearest(one, voxels)] for rank_of, one in volumes]
    cells = np.max(held, axis=0) + len(ranked) * np.arange(len(indices))[:, None]
    votes = np.bincount(cells.ravel(), weights.ravel(), len(indices) * len(ranked))
    return np.asarray(votes.reshape(len(indices), len(ranked)), dtype=np.float64)


def _crossings(labels: Segmentation, path: _Path) -> Iterator[tuple[Structure, Array]]:
    """Yield where a path runs through voxels of structures: begin and end, (2,).

    Where structures overlap the smallest counts, and every obstacle.
    """
    tie_voxels = 1e-9  # so near to a face a path runs through both voxels beside it
    start = path.ends[0]
    way = path.ends[1] - start
    cuts = [
        (np.arange(labels.grid.shape[axis] + 1) - 0.5 - start[axis]) / way[axis]
        for axis in np.flatnonzero(way)
    ]
    fractions = np.unique(np.clip(np.concatenate([[0.0, 1.0], *cuts]), 0.0, 1.0))
    middles = start + np.outer(0.5 * (fractions[:-1] + fractions[1:]), way)
    signs = np.array(list(product((-tie_voxels, tie_voxels), repeat=3)))
    around = middles[:, None] + signs
    values = [labels.grid.nearest(volume, around) for volume in labels.volumes]
    is_held = np.zeros(len(middles), bool)
    for item in reversed(path.ranked[1:]):
        if item.name not in TISSUES:
            is_inside = (values[item.volume] == item.value).any(axis=1)
            is_inside &= item.is_obstacle | ~is_held
            is_held |= is_inside
            edges = np.flatnonzero(np.diff(is_inside, prepend=False, append=False))
            for faces_m in path.depths_m[-1] * fractions[edges].reshape(-1, 2):
                yield item, faces_m


def _ends_by_neighbours(
    items: list[Structure], cuts_m: Array, name: str, faces_m: Array, path: _Path
) -> Array | None:
    """Return where the layers on both sides of a thin one say that they end.

    Args:
        items: Structures of the layers.
        cuts_m: Depths at which they begin and end, (layers + 1,).
        name: Of the thin one.
        faces_m: Depths at which its voxels begin and end, (2,).
        path: The path.

    Returns:
        Depths and standard deviations of begin and end, (2, 2); None where there are
        no two such layers, or where they say something else than the faces of its
        voxels, which are right to within one.
    """
    (inner,) = np.nonzero((faces_m[0] < cuts_m[1:-1]) & (cuts_m[1:-1] < faces_m[1]))
    if len(inner) != 1:
        return None
    leader, follower = (items[inner[0] + side].name for side in (0, 1))
    found: list[Array] = []
    for face_m, in_front, behind in (
        (faces_m[0], (leader,), (name, follower)),
        (faces_m[1], (leader, name), (follower,)),
    ):
        lead = path.votes_of(*in_front) - path.votes_of(*behind)
        (index,) = np.nonzero((lead[:-1] > 0.0) & (lead[1:] <= 0.0))
        ends = path.boundaries(index, lead[index], lead[index + 1])
        found.append(ends[:, np.abs(ends[0] - face_m) < path.voxel_m])
    both = np.hstack(found)
    is_found = [one.shape[1] for one in found] == [1, 1]
    return both if is_found and both[0, 0] < both[0, 1] else None


def _std_of_grazed_m(name: str, faces_m: Array, path: _Path) -> float:
    """Return the standard deviation of the ends of a layer that the path grazes.

    Near the middle of the layer its fraction of the votes is a parabola: an error of
    the votes moves the ends the further the flatter it is.
    """
    around_voxels = 2.5  # from the middle, in which the parabola is fitted
    curvature = 0.02  # at least, per voxel squared: three voxels, more was not seen
    offsets = (path.depths_m - faces_m.mean()) / path.voxel_m
    is_near = np.abs(offsets) <= around_voxels + 1e-9
    if np.count_nonzero(is_near) > 3:
        parabola = np.polyfit(offsets[is_near], path.votes_of(name)[is_near], 2)
        # Of the lead of what is around it: that loses what this one gains.
        curvature = max(-4.0 * float(parabola[0]), curvature)
    return path.voxel_m * float(np.sqrt(2.0 * SIZE_STD / curvature))
