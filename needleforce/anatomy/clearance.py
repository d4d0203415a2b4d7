"""How near a straight path comes to structures, judged on their voxels.

Every voxel counts as the box that it fills: no smoothing, so a rib of one voxel is as
hard as a thick one. Distances are those of the straight line from entry to target to
the nearest box of a structure, exact for boxes of any edges. A search tree of the
voxels' centres rules out what is far: the centre of a box lies no further from the
nearest of its points than half the box's diagonal.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree

from foundation.arrays import Array
from needleforce.anatomy.errors import (
    EXPORT_VOLUME,
    OTHER_PATH,
    PlanError,
    VolumeError,
)
from needleforce.anatomy.outer_voxels import Ball, OuterVoxels
from needleforce.anatomy.segmentation import Segmentation
from needleforce.anatomy.structures import Structure

NEEDLE_RADIUS_m = 0.8e-3
"""Of an 18 G needle (1.27 mm) with its sheath; what is not said otherwise."""

MARGIN_m = 2e-3
"""Distance that stays free around the needle: a segmentation errs by some 1 mm, a
needle bends by as much."""

STDS = 2.0
"""So many standard deviations of the registration are kept free, too."""

ORTHOGONAL = 1e-6
"""Cosine up to which axes of a grid count as orthogonal."""

MAX_CLEARANCE_m = 0.1
"""Structures further away than this are not listed."""

ROUNDING = 1e-12
"""A slope this much smaller than the steepest is none."""

ROUNDING_m = 1e-9
"""Distances from centres that differ by less are compared box by box."""

PATHS_AT_ONCE = 500
"""Paths of which the points are held in memory at once: some 10 MB."""

MIN_DISTANCE_m = 1e-9
"""Less is none: a path to a face of a box ends in it."""

MM_PER_M = 1e3

Search = Callable[[Array, Array], NDArray[np.intp]]
"""Finds voxels that may be the nearest to a path, given its ends along the grid."""


@dataclass(frozen=True)
class Clearance:
    """How near a path comes to a structure.

    Attributes:
        name: Of the structure.
        distance_m: From the needle's centre line to the nearest of its voxels; 0 where
            the line crosses one.
        depth_m: Where on the path that is, from the entry.
        is_obstacle: Bone or cartilage.
    """

    name: str
    distance_m: float
    depth_m: float
    is_obstacle: bool


class Approach(NamedTuple):
    """Where paths come nearest to voxels.

    Attributes:
        distance_m: From the path, 0 inside a voxel.
        depth_m: From the path's first point.
        owner: Index of the structure whose voxel it is.
    """

    distance_m: float
    depth_m: float
    owner: int


class FreeSpace(NamedTuple):
    """What a path needs around its centre line.

    Attributes:
        needle_radius_m: Of the needle.
        margin_m: Kept free around it.
        std_m: Standard deviation of the registration, the largest of any direction
            along the path.
    """

    needle_radius_m: float = NEEDLE_RADIUS_m
    margin_m: float = MARGIN_m
    std_m: float = 0.0

    @property
    def needed_m(self) -> float:
        """Distance that every obstacle must keep: radius, margin and two std."""
        return self.needle_radius_m + self.margin_m + STDS * self.std_m

    def __str__(self) -> str:
        return (
            f"{MM_PER_M * self.needed_m:.1f} mm: needle radius "
            f"{MM_PER_M * self.needle_radius_m:.1f}, margin "
            f"{MM_PER_M * self.margin_m:.1f}, 2 std of the registration "
            f"{MM_PER_M * STDS * self.std_m:.1f}"
        )


class VoxelBoxes:
    """The voxels of structures as boxes, and how near straight paths come to them.

    Building it takes a while, a path some tenths of a millisecond to some
    milliseconds: keep one for many paths.

    Args:
        labels: The segmentation, or the outer voxels of its structures.
        structures: Those whose voxels count.
        within: The ball in which voxels count, or all. How near a path comes is then
            right up to the distance between the path and the ball's surface.

    Attributes:
        structures: The same.

    Raises:
        VolumeError: The axes of the grid are not orthogonal.
    """

    def __init__(
        self,
        labels: Segmentation | OuterVoxels,
        structures: Iterable[Structure],
        within: Ball | None = None,
    ) -> None:
        outer = labels if isinstance(labels, OuterVoxels) else OuterVoxels(labels)
        self.structures = tuple(structures)
        grid = outer.labels.grid
        spacing_m = grid.spacing_m
        directions = grid.axes_m / spacing_m
        if np.abs(directions.T @ directions - np.eye(3)).max() > ORTHOGONAL:
            raise VolumeError(
                "the axes of the labels' grid are not orthogonal: resample them",
                EXPORT_VOLUME,
            )
        self._labels = outer.labels
        self._origin_m = grid.origin_m
        self._directions = directions
        self._half_m = 0.5 * spacing_m
        self._half_diagonal_m = float(np.linalg.norm(self._half_m))
        indices = [outer.indices(item, within) for item in self.structures]
        self._centres_m = np.concatenate([np.zeros((0, 3), np.int32), *indices]) * (
            spacing_m
        )
        self._owners = np.repeat(np.arange(len(indices)), list(map(len, indices)))

    @cached_property
    def _tree(self) -> KDTree:
        return KDTree(self._centres_m, balanced_tree=False)

    def nearest(self, entry_m: ArrayLike, target_m: ArrayLike) -> Approach | None:
        """Return where a path comes nearest to a voxel; None if there is no voxel.

        Args:
            entry_m: First point of the path, (3,) in LPS.
            target_m: Last point, (3,).
        """
        return self._find_approach(entry_m, target_m, self._search_tree)

    def _search_tree(self, entry: Array, target: Array) -> NDArray[np.intp]:
        """Return which voxels may be the nearest to a path, by the search tree."""
        samples = self._sample(entry[None], target[None])
        bound_m = float(self._tree.query(samples.points_m)[0].min())
        near = self._tree.query_ball_point(
            samples.points_m,
            bound_m + self._half_diagonal_m + 2.0 * float(samples.step_m[0]),
        )
        return np.unique(np.concatenate(near).astype(np.intp))

    def nearest_once(self, entry_m: ArrayLike, target_m: ArrayLike) -> Approach | None:
        """Return what `nearest` does, faster for the first paths.

        It passes all voxels and builds no search tree.
        """
        return self._find_approach(entry_m, target_m, self._search_all)

    def _search_all(self, entry: Array, target: Array) -> NDArray[np.intp]:
        """Return which voxels may be the nearest to a path, by passing all."""
        distances_m = _distances_to_points(entry, target, self._centres_m)
        # No box is nearer than its centre by more than half its diagonal.
        reach_m = distances_m.min() + self._half_diagonal_m + ROUNDING_m
        return np.flatnonzero(distances_m <= reach_m)

    def _find_approach(
        self, entry_m: ArrayLike, target_m: ArrayLike, search: Search
    ) -> Approach | None:
        """Return where a path comes nearest to a voxel that a search offers."""
        owner = self._structure_at(entry_m)
        if owner is not None:
            return Approach(0.0, 0.0, owner)
        if not len(self._centres_m):
            return None
        entry, target = self._along_grid(np.array([entry_m, target_m], float))
        return self._nearest_of(search(entry, target), entry, target)

    def nearer_than(
        self, entries_m: ArrayLike, targets_m: ArrayLike, distance_m: float
    ) -> NDArray[np.bool_]:
        """Return which of many paths come nearer to a voxel than a distance.

        Args:
            entries_m: First points, (n, 3) in LPS.
            targets_m: Last points, (n, 3), or (3,) for one that all share.
            distance_m: The distance.
        """
        entries_m = np.atleast_2d(np.asarray(entries_m, float))
        targets_m = np.broadcast_to(np.asarray(targets_m, float), entries_m.shape)
        is_near = np.array(
            [self._structure_at(entry_m) is not None for entry_m in entries_m], bool
        )
        if not len(self._centres_m):
            return is_near
        entries = self._along_grid(entries_m)
        targets = self._along_grid(targets_m)
        outside = np.flatnonzero(~is_near)
        for first in range(0, len(outside), PATHS_AT_ONCE):
            paths = outside[first : first + PATHS_AT_ONCE]
            is_near[paths] = self._are_nearer(
                entries[paths], targets[paths], distance_m
            )
        return is_near

    def _are_nearer(
        self, entries: Array, targets: Array, distance_m: float
    ) -> NDArray[np.bool_]:
        """Return which paths come nearer to a voxel than a distance.

        Args:
            entries: First points, in axes of the grid, (n, 3).
            targets: Last points, (n, 3).
            distance_m: The distance.
        """
        samples = self._sample(entries, targets)
        reaches_m = distance_m + self._half_diagonal_m + samples.step_m
        reach_m = float(reaches_m.max())
        low_m = self._centres_m.min(axis=0) - reach_m
        high_m = self._centres_m.max(axis=0) + reach_m
        is_beside = np.all(
            (samples.points_m > low_m) & (samples.points_m < high_m), axis=1
        )
        distances_m = np.full(len(samples.points_m), np.inf)
        if is_beside.any():
            distances_m[is_beside] = self._tree.query(
                samples.points_m[is_beside], distance_upper_bound=reach_m
            )[0]
        nearest_m = np.minimum.reduceat(distances_m, samples.first)
        is_near = nearest_m < distance_m
        # In between, the centre is too far and the box around it may be near enough.
        for path in np.flatnonzero(~is_near & (nearest_m < reaches_m)).tolist():
            near = self._tree.query_ball_point(samples.of(path), reaches_m[path])
            candidates = np.unique(np.concatenate(near).astype(int))
            nearest = self._nearest_of(candidates, entries[path], targets[path])
            is_near[path] = nearest.distance_m < distance_m
        return is_near

    def _along_grid(self, points_m: ArrayLike) -> Array:
        """Return points (n, 3) in axes along those of the grid [m]."""
        return (np.asarray(points_m, float) - self._origin_m) @ self._directions

    def _structure_at(self, point_m: ArrayLike) -> int | None:
        """Return the index of a structure that holds a point; None for none."""
        index = np.rint(self._labels.grid.indices(point_m)).astype(int)
        if np.any(index < 0) or np.any(index >= self._labels.grid.shape):
            return None
        voxel = tuple(index.tolist())
        for number, item in enumerate(self.structures):
            if self._labels.volumes[item.volume][voxel] == item.value:
                return number
        return None

    def _sample(self, entries: Array, targets: Array) -> "_Samples":
        """Return points of paths (n, 3), so close that boxes are found by them."""
        lengths_m = np.linalg.norm(targets - entries, axis=1)
        intervals = np.ceil(lengths_m / (2.0 * self._half_diagonal_m)).astype(int)
        intervals = np.maximum(intervals, 1)
        ends = np.cumsum(intervals + 1)
        first = ends - (intervals + 1)
        path = np.repeat(np.arange(len(entries)), intervals + 1)
        fractions = (np.arange(ends[-1]) - first[path]) / intervals[path]
        return _Samples(
            entries[path] + fractions[:, None] * (targets - entries)[path],
            first,
            0.5 * lengths_m / intervals,
        )

    def _nearest_of(
        self, candidates: NDArray[np.intp], entry: Array, target: Array
    ) -> Approach:
        """Return the nearest approach to the boxes of some voxels.

        Args:
            candidates: Their numbers, growing.
            entry: First point of the path, in axes of the grid.
            target: Last point.
        """
        if not len(candidates):
            return Approach(np.inf, np.nan, -1)
        distances_m, fractions = _distances_to_boxes(
            entry, target, self._centres_m[candidates], self._half_m
        )
        best = int(np.lexsort((fractions, distances_m))[0])
        depth_m = float(fractions[best] * np.linalg.norm(target - entry))
        owner = int(self._owners[candidates[best]])
        return Approach(float(distances_m[best]), depth_m, owner)


class _Samples(NamedTuple):
    """Points of straight paths.

    Attributes:
        points_m: Those of a path follow each other, (m, 3).
        first: Number of each path's first one, (n,).
        step_m: How far a path strays from the nearest of them, (n,).
    """

    points_m: Array
    first: NDArray[np.intp]
    step_m: Array

    def of(self, path: int) -> Array:
        """Return the points of one path."""
        ends = np.append(self.first[1:], len(self.points_m))
        return self.points_m[self.first[path] : ends[path]]


def find_clearances(
    labels: Segmentation | OuterVoxels,
    structures: Iterable[Structure],
    entry_m: ArrayLike,
    target_m: ArrayLike,
) -> list[Clearance]:
    """Return how near a path comes to structures, the nearest first."""
    outer = labels if isinstance(labels, OuterVoxels) else OuterVoxels(labels)
    clearances: list[Clearance] = []
    for item in structures:
        nearest = VoxelBoxes(outer, [item]).nearest_once(entry_m, target_m)
        if nearest is not None and nearest.distance_m <= MAX_CLEARANCE_m:
            clearances.append(
                Clearance(
                    item.name, nearest.distance_m, nearest.depth_m, item.is_obstacle
                )
            )
    return sorted(clearances, key=lambda one: (one.distance_m, one.depth_m))


def describe_clearance(clearance: Clearance) -> str:
    """Return a clearance in words."""
    if clearance.distance_m == 0.0:
        return (
            f"crosses {clearance.name} at {MM_PER_M * clearance.depth_m:.1f} mm below "
            "the entry"
        )
    return (
        f"passes {clearance.name} at {MM_PER_M * clearance.distance_m:.1f} mm, "
        f"{MM_PER_M * clearance.depth_m:.1f} mm below the entry"
    )


def too_near(clearances: Iterable[Clearance], space: FreeSpace) -> list[Clearance]:
    """Return the clearances that leave less than the space that a path needs."""
    return [one for one in clearances if one.distance_m <= space.needed_m]


def require_clear_path(
    clearances: Iterable[Clearance],
    space: FreeSpace,
    accepted_obstacles: Iterable[str] = (),
) -> None:
    """Refuse a path that comes too near to an obstacle.

    Args:
        clearances: Of the path.
        space: What it needs.
        accepted_obstacles: Names of obstacles that it may touch.

    Raises:
        PlanError: The path crosses an obstacle, or leaves it too little space.
    """
    accepted = frozenset(accepted_obstacles)
    obstacles = [
        one
        for one in too_near(clearances, space)
        if one.is_obstacle and one.name not in accepted
    ]
    if obstacles:
        raise PlanError(
            f"the path {'; '.join(map(describe_clearance, obstacles))}: obstacles must "
            f"stay {space} away",
            OTHER_PATH,
        )


def _distances_to_points(entry: Array, target: Array, points: Array) -> Array:
    """Return the distances of a line segment from points (n, 3), shape (n,)."""
    way = target - entry
    start = points - entry
    fractions = np.clip(start @ way / max(float(way @ way), ROUNDING), 0.0, 1.0)
    return np.linalg.norm(start - fractions[:, None] * way, axis=1)


def _distances_to_boxes(
    entry: Array, target: Array, centres: Array, half: Array
) -> tuple[Array, Array]:
    """Return the distances of a line segment from boxes, and where it is nearest.

    The square of the distance, along the segment, is convex and of degree two between
    the places where the segment passes the planes of the box's faces: its slope is
    linear there, and where it changes sign lies the minimum.

    Args:
        entry: Start of the segment, (3,).
        target: Its end, (3,).
        centres: Of the boxes, (n, 3); their edges lie along the axes.
        half: Half their edges, (3,).

    Returns:
        Distances (n,), and fractions (n,) of the segment.
    """
    way = target - entry
    start = entry - centres
    is_moving = way != 0.0
    speed = np.where(is_moving, way, 1.0)
    cuts = np.stack([(half - start) / speed, (-half - start) / speed], axis=-1)
    cuts[:, ~is_moving] = 0.0
    cuts = np.clip(cuts.reshape(len(centres), 6), 0.0, 1.0)
    ends = np.broadcast_to([0.0, 1.0], (len(centres), 2))
    fractions = np.sort(np.concatenate([cuts, ends], axis=1), axis=1)
    slope = _excess(start, way, half, fractions) @ way  # (n, 8), grows along a row
    last = fractions.shape[1] - 1
    is_falling = slope < -ROUNDING * (way @ way)
    after = np.clip(is_falling.sum(axis=1), 0, last)
    before = np.maximum(after - 1, 0)
    rows = np.arange(len(centres))
    rise = slope[rows, after] - slope[rows, before]
    part = np.where(
        rise > 0.0, -slope[rows, before] / np.where(rise > 0.0, rise, 1.0), 1.0
    )
    part = np.clip(part, 0.0, 1.0)
    nearest = fractions[rows, before] + part * (
        fractions[rows, after] - fractions[rows, before]
    )
    gaps = _excess(start, way, half, nearest[:, None])[:, 0]
    distances = np.linalg.norm(gaps, axis=1)
    return np.where(distances < MIN_DISTANCE_m, 0.0, distances), nearest


def _excess(start: Array, way: Array, half: Array, fractions: Array) -> Array:
    """Return by how much points of segments lie outside boxes along each axis.

    Args:
        start: Of each segment, from the box's centre, (n, 3).
        way: To its end, (3,).
        half: Half the edges of the boxes, (3,).
        fractions: Of the points on the segments, (n, m).

    Returns:
        Signed distances along the axes, 0 inside, (n, m, 3).
    """
    points = start[:, None] + fractions[..., None] * way
    return points - np.clip(points, -half, half)
