"""How near a straight path comes to structures, judged on their voxels.

Every voxel counts as the box that it fills: no smoothing, so a rib of one voxel is as
hard as a thick one. Distances are those of the straight line from entry to target to
the nearest box of a structure. Voxels behind each other along an axis of the grid are
one box, and a tree of boxes around boxes rules out what is far: every path visits some
dozens of them, however many voxels there are.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import KDTree

from foundation.arrays import Array, Matrix, Vector, WrittenVector
from foundation.jit import compile_waiting, compiled, compiled_inside
from needleforce.anatomy.errors import OTHER_PATH, PlanError, VolumeError
from needleforce.anatomy.structures import Structure

if TYPE_CHECKING:
    from needleforce.anatomy.labels import Labels

NEEDLE_RADIUS_m = 0.8e-3
"""Of an 18 G needle (1.27 mm) with its sheath; what is not said otherwise."""

MARGIN_m = 2e-3
"""Distance that stays free around the needle: a segmentation errs by some 1 mm, a
needle bends by as much."""

STDS = 2.0
"""So many standard deviations of the registration are kept free, too."""

MM_PER_M = 1e3


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
    """Where a path comes nearest to voxels.

    Attributes:
        distance_m: From the path, 0 inside a voxel.
        depth_m: From the path's first point.
    """

    distance_m: float
    depth_m: float


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
    """The voxels of a structure as boxes, and how near straight paths come to them.

    Building it takes a while, a path some microseconds: keep one for many paths.

    Args:
        labels: The segmentation.
        structure: Whose voxels count.

    Attributes:
        structure: The same.
        tree: The boxes, see `nearest_box`.

    Raises:
        VolumeError: The axes of the grid are not orthogonal.
    """

    def __init__(self, labels: "Labels", structure: Structure) -> None:
        self.structure = structure
        grid = labels.grid
        spacing_m = grid.spacing_m
        directions = grid.axes_m / spacing_m
        if np.abs(directions.T @ directions - np.eye(3)).max() > 1e-6:
            raise VolumeError(
                "the axes of the labels' grid are not orthogonal: resample them"
            )
        self._origin_m = grid.origin_m
        self._directions = directions
        # Voxels behind each other along the last axis of the grid are one box.
        mask = labels.volumes[structure.volume][structure.box] == structure.value
        change = np.diff(np.pad(mask, ((0, 0), (0, 0), (1, 1))).view(np.int8), axis=-1)
        corner = np.array([side.start for side in structure.box])
        first = np.argwhere(change == 1) + corner
        last = np.argwhere(change == -1) + corner - [0, 0, 1]
        # In the order of such a tree neighbours come soon after each other.
        order = KDTree(0.5 * (first + last) * spacing_m, leafsize=2).indices
        self.tree = _box_tree(
            (0.5 * (first + last) * spacing_m)[order],
            (0.5 * (last - first + 1) * spacing_m)[order],
        )
        compile_waiting()

    def nearest(
        self, entry_m: ArrayLike, target_m: ArrayLike, within_m: float = np.inf
    ) -> Approach | None:
        """Return where a path comes nearest to a voxel; None if it is further away.

        Args:
            entry_m: First point of the path, (3,) in LPS.
            target_m: Last point, (3,).
            within_m: Voxels further away than this are not looked for.
        """
        ends = self.along_grid(np.array([entry_m, target_m]))
        distance_m, fraction, _ = nearest_box(self.tree, ends, within_m)
        if fraction < 0.0:
            return None
        return Approach(distance_m, fraction * float(np.linalg.norm(ends[1] - ends[0])))

    def along_grid(self, points_m: ArrayLike) -> Array:
        """Return points of LPS, (n, 3), along the axes of the boxes."""
        return (np.asarray(points_m, float) - self._origin_m) @ self._directions

    def from_grid(self, points_m: Array) -> Array:
        """Return points along the axes of the boxes, (n, 3), in LPS."""
        return points_m @ self._directions.T + self._origin_m


def _box_tree(centres_m: Array, halves_m: Array) -> Matrix:
    """Return a binary tree of boxes as rows of centre and half edges, (2 n, 6).

    Row 1 holds all boxes, rows 2 i and 2 i + 1 share those in row i, and the last n
    rows are the given boxes.

    Args:
        centres_m: Of boxes that lie near each other where their numbers are, (n, 3).
        halves_m: Half their edges, (n, 3).
    """
    count = len(centres_m)
    low_m = np.concatenate([np.zeros((count, 3)), centres_m - halves_m])
    high_m = np.concatenate([np.zeros((count, 3)), centres_m + halves_m])
    end = count
    while end > 1:
        begin = (end + 1) // 2
        pairs = slice(2 * begin, 2 * end)
        low_m[begin:end] = low_m[pairs].reshape(-1, 2, 3).min(axis=1)
        high_m[begin:end] = high_m[pairs].reshape(-1, 2, 3).max(axis=1)
        end = begin
    return np.hstack([0.5 * (low_m + high_m), 0.5 * (high_m - low_m)])


@compiled
def nearest_box(tree: Matrix, ends: Matrix, within: float) -> tuple[float, float, int]:
    """Return the distance of a line segment from the nearest box, and where that is.

    Args:
        tree: See `_box_tree`.
        ends: Of the segment, along the axes of the boxes, (2, 3).
        within: Boxes further away do not count.

    Returns:
        The distance; the fraction of the segment, the first of equal ones, -1 if
        there is no box; and the row of the box.
    """
    tie = 1e-9  # beside a flat face thousands of boxes are as near, but for rounding
    entry = ends[0]
    way = ends[1] - ends[0]
    waiting = np.empty((64, 3))  # boxes to look into: number, distance, fraction
    _measure_box(tree, 1, entry, way, waiting[0])
    size = 1
    nearest = within
    found = -1.0
    row = 0
    while size > 0:
        size -= 1
        number, distance, fraction = waiting[size]
        is_tie = found >= 0.0 and distance > nearest - tie and fraction >= found
        if distance > nearest or is_tie:
            continue
        left = 2 * int(number)
        if left >= len(tree):
            nearest = distance
            found = fraction
            row = int(number)
            continue
        _measure_box(tree, left, entry, way, waiting[size])
        _measure_box(tree, left + 1, entry, way, waiting[size + 1])
        # The nearer one is looked into first: it goes last.
        _, near, near_at = waiting[size]
        _, far, far_at = waiting[size + 1]
        if near < far or (near == far and near_at < far_at):
            for k in range(3):
                swapped = waiting[size, k]
                waiting[size, k] = waiting[size + 1, k]
                waiting[size + 1, k] = swapped
        size += 2
    return nearest, found, row


@compiled_inside
def _measure_box(
    tree: Matrix, number: int, entry: Vector, way: Vector, measured: WrittenVector
) -> None:
    """Write the number of a box, its distance from a segment, and where that is.

    Args:
        tree: Boxes as rows of centre and half edges.
        number: Of the box.
        entry: Start of the segment, (3,).
        way: To its end, (3,).
        measured: Number, distance, and fraction of the segment, (3,).
    """
    box = tree[number]
    fraction = _nearest_fraction(box, entry, way)
    square = 0.0
    for i in range(3):
        excess = abs(entry[i] + fraction * way[i] - box[i]) - box[3 + i]
        if excess > 1e-9:  # a path to a face of a box ends in it
            square += excess * excess
    measured[0] = number
    measured[1] = np.sqrt(square)
    measured[2] = fraction


@compiled_inside
def _nearest_fraction(box: Vector, entry: Vector, way: Vector) -> float:
    """Return where a line segment is nearest to a box, as a fraction of its length.

    The square of the distance, along the segment, is convex and of degree two between
    the places where the segment passes the planes of the box's faces: its slope is
    linear there, and where it changes sign lies the minimum.
    """
    # A slope less steep than this is none.
    flat = -1e-12 * (way[0] * way[0] + way[1] * way[1] + way[2] * way[2])
    begin = 0.0
    end = 1.0
    if _slope_at(box, entry, way, begin) >= flat:
        return begin
    if _slope_at(box, entry, way, end) < flat:
        return end
    for side in range(6):
        axis = side // 2
        face = box[axis] + (2.0 * (side % 2) - 1.0) * box[3 + axis]
        # Beside a plane its cut is any place.
        cut = (face - entry[axis]) / way[axis] if way[axis] != 0.0 else 0.0
        if begin < cut < end:
            if _slope_at(box, entry, way, cut) < flat:
                begin = cut
            else:
                end = cut
    slope = _slope_at(box, entry, way, begin)
    part = -slope / (_slope_at(box, entry, way, end) - slope)
    return begin + min(part, 1.0) * (end - begin)


@compiled_inside
def _slope_at(box: Vector, entry: Vector, way: Vector, fraction: float) -> float:
    """Return half the slope of the square of the distance from a box."""
    slope = 0.0
    for i in range(3):
        offset = entry[i] + fraction * way[i] - box[i]
        slope += (offset - min(max(offset, -box[3 + i]), box[3 + i])) * way[i]
    return slope


def find_clearances(
    boxes: Iterable[VoxelBoxes], entry_m: ArrayLike, target_m: ArrayLike
) -> list[Clearance]:
    """Return how near a path comes to structures within 0.1 m, the nearest first."""
    clearances: list[Clearance] = []
    for one in boxes:
        nearest = one.nearest(entry_m, target_m, within_m=0.1)
        if nearest is not None:
            clearances.append(
                Clearance(
                    one.structure.name,
                    nearest.distance_m,
                    nearest.depth_m,
                    one.structure.is_obstacle,
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
