"""How near a path or the actual needle comes to structures, judged on their voxels.

Every voxel counts as the box that it fills: no smoothing, so a rib of one voxel is as
hard as a thick one. Distances are those of the straight line from entry to target to
the nearest box of a structure. Voxels behind each other along an axis of the grid are
one box, and a tree of boxes around boxes rules out what is far: every path visits some
dozens of them, however many voxels there are.

A plan is judged along its own line. The needle is a little beside it, and goes on along
its own direction: what counts is what lies beside the needle, and ahead of it.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import KDTree

from foundation.arrays import Array, Matrix, Vector
from foundation.jit import compile_waiting, compiled, compiled_inside
from needleforce.anatomy.errors import OTHER_PATH, PlanError, VolumeError
from needleforce.anatomy.registration import Registration
from needleforce.anatomy.volume import Segmentation, Structure

NEEDLE_RADIUS_m = 0.8e-3
"""Of an 18 G needle (1.27 mm) with its sheath; what is not said otherwise."""

MARGIN_m = 2e-3
"""Distance that stays free around the needle: a segmentation errs by some 1 mm, a
needle bends by as much."""

STDS = 2.0
"""So many standard deviations of the registration are kept free, too."""

MM_PER_M = 1e3

Nearest = tuple[float, float, int]
"""Distance of a segment from a box, where on the segment, and the row of the box."""


@dataclass(frozen=True)
class Clearance:
    """How near a path comes to a structure.

    Attributes:
        name: Of the structure.
        distance_m: From the needle's centre line to the nearest of its voxels; 0 where
            the line crosses one.
        depth_m: Where on the path that is, from the entry.
        is_obstacle: Bone or cartilage.
        place_m: Of the voxel's nearest point, (3,) in LPS.
    """

    name: str
    distance_m: float
    depth_m: float
    is_obstacle: bool
    place_m: tuple[float, ...]


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

    Raises:
        VolumeError: The axes of the grid are not orthogonal.
    """

    def __init__(self, labels: Segmentation, structure: Structure) -> None:
        self.structure = structure
        grid = labels.grid
        spacing_m = grid.spacing_m
        self._origin_m = grid.origin_m
        self._directions = grid.axes_m / spacing_m
        if not np.allclose(self._directions.T @ self._directions, np.eye(3), atol=1e-6):
            raise VolumeError(
                "the axes of the labels' grid are not orthogonal: resample them"
            )
        # Voxels behind each other along the last axis of the grid are one box.
        mask = np.pad(labels.mask(structure.name), ((0, 0), (0, 0), (1, 1)))
        change = np.diff(mask.view(np.int8), axis=-1)
        corner = labels.corner(structure.name)
        first = np.argwhere(change == 1) + corner
        last = np.argwhere(change == -1) + corner - [0, 0, 1]
        centres_m = 0.5 * (first + last) * spacing_m
        halves_m = 0.5 * (last - first + 1) * spacing_m
        # In the order of such a tree neighbours come soon after each other.
        order = KDTree(centres_m, leafsize=2).indices
        self._tree = _box_tree(centres_m[order], halves_m[order])
        compile_waiting()

    def nearest(
        self, entry_m: ArrayLike, target_m: ArrayLike, within_m: float = np.inf
    ) -> Clearance | None:
        """Return where a path comes nearest to a voxel; None if it is further away.

        Args:
            entry_m: First point of the path, (3,) in LPS.
            target_m: Last point, (3,).
            within_m: Voxels further away than this are not looked for.
        """
        ends = (
            np.array([entry_m, target_m], float) - self._origin_m
        ) @ self._directions
        distance_m, fraction, row = nearest_box(self._tree, ends, within_m)
        if row == 0:
            return None
        way_m = ends[1] - ends[0]
        centre_m, half_m = self._tree[row].reshape(2, 3)
        place = np.clip(
            ends[0] + fraction * way_m, centre_m - half_m, centre_m + half_m
        )
        return Clearance(
            name=self.structure.name,
            distance_m=distance_m,
            depth_m=fraction * float(np.linalg.norm(way_m)),
            is_obstacle=self.structure.is_obstacle,
            place_m=tuple((place @ self._directions.T + self._origin_m).tolist()),
        )


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
def nearest_box(tree: Matrix, ends: Matrix, within: float) -> Nearest:
    """Return the distance of a line segment from the nearest box, and where that is.

    Args:
        tree: See `_box_tree`.
        ends: Of the segment, along the axes of the boxes, (2, 3).
        within: Boxes further away do not count.

    Returns:
        The distance; the fraction of the segment, the first of equal ones; and the row
        of the box, 0 if there is none.
    """
    way = ends[1] - ends[0]
    nearest = (within, 2.0, 0)  # no fraction is as large: so far away is still near
    waiting = [_approach(tree, 1, ends[0], way)]
    while waiting:
        box = waiting.pop()
        if box >= nearest:
            continue
        left = 2 * box[2]
        if left >= len(tree):
            nearest = box
            continue
        waiting += [_approach(tree, k, ends[0], way) for k in (left, left + 1)]
        if waiting[-1] > waiting[-2]:  # the nearer one is looked into first
            waiting[-1], waiting[-2] = waiting[-2], waiting[-1]
    return nearest


@compiled_inside
def _approach(tree: Matrix, row: int, entry: Vector, way: Vector) -> Nearest:
    """Return the distance of a line segment from a box, and its first nearest place.

    The square of the distance, along the segment, is convex and of degree two between
    the places where the segment passes the planes of the box's faces: its slope is
    linear there, and where it changes sign lies the minimum.

    Args:
        tree: Boxes as rows of centre and half edges.
        row: Of the box.
        entry: Start of the segment, (3,).
        way: To its end, (3,).

    Returns:
        The distance, rounded so that boxes beside a flat face are equally near; the
        place as a fraction of the segment; and the row.
    """
    box = tree[row]
    tie = 1e-9
    # A slope less steep than this is none.
    flat = -1e-12 * (way[0] * way[0] + way[1] * way[1] + way[2] * way[2])
    begin = 0.0
    end = 1.0
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
    if slope < flat:
        part = -slope / (_slope_at(box, entry, way, end) - slope)
        begin += min(part, 1.0) * (end - begin)
    square = 0.0
    for i in range(3):
        excess = abs(entry[i] + begin * way[i] - box[i]) - box[3 + i]
        square += max(excess, 0.0) ** 2
    return tie * np.rint(np.sqrt(square) / tie), begin, row


@compiled_inside
def _slope_at(box: Vector, entry: Vector, way: Vector, fraction: float) -> float:
    """Return half the slope of the square of the distance from a box."""
    slope = 0.0
    for i in range(3):
        offset = entry[i] + fraction * way[i] - box[i]
        slope += (offset - min(max(offset, -box[3 + i]), box[3 + i])) * way[i]
    return slope


def describe_clearance(clearance: Clearance) -> str:
    """Return a clearance in words."""
    verb = f"passes {clearance.name} at {MM_PER_M * clearance.distance_m:.1f} mm,"
    if clearance.distance_m == 0.0:
        verb = f"crosses {clearance.name} at"
    return f"{verb} {MM_PER_M * clearance.depth_m:.1f} mm below the entry"


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
    near = too_near(clearances, space)
    obstacles = [one for one in near if one.is_obstacle and one.name not in accepted]
    if obstacles:
        raise PlanError(
            f"the path {'; '.join(map(describe_clearance, obstacles))}: obstacles must "
            f"stay {space} away",
            OTHER_PATH,
        )


REACH_m = 0.1
"""Structures further away than this are not reported."""


class NeedleClearance(NamedTuple):
    """How near the needle comes to a structure.

    Attributes:
        number: Of the structure, in the order of `NeedleSurroundings.names`.
        name: Of the structure.
        needle_m: From the centre line of the needle in the body; infinite above the
            entry.
        ahead_m: From its straight way on, as far as the target is deep.
        std_m: Standard deviation of the registration, the largest of any direction.
        needed_m: What must stay free.
        is_obstacle: Bone or cartilage.
        x_m: Where the structure is nearest, in the robot's base.
        y_m: Likewise.
        z_m: Likewise.
    """

    number: int
    name: str
    needle_m: float
    ahead_m: float
    std_m: float
    needed_m: float
    is_obstacle: bool
    x_m: float
    y_m: float
    z_m: float

    @property
    def distance_m(self) -> float:
        """From the needle or its way ahead, the smaller one."""
        return min(self.needle_m, self.ahead_m)

    @property
    def is_ahead(self) -> bool:
        """Whether the way ahead comes nearer than the needle is."""
        return self.ahead_m < self.needle_m

    @property
    def is_too_near(self) -> bool:
        """Whether less stays free than must."""
        return self.distance_m <= self.needed_m

    def __str__(self) -> str:
        part = "the way ahead" if self.is_ahead else "the needle"
        if self.distance_m == 0.0:
            return f"{part} meets {self.name}"
        return (
            f"{part} passes {self.name} at {MM_PER_M * self.distance_m:.1f} ± "
            f"{MM_PER_M * self.std_m:.1f} mm"
        )


def sort_clearances(
    clearances: Iterable[NeedleClearance],
) -> tuple[NeedleClearance, ...]:
    """Return clearances, those of what is too near first, then the nearest first.

    What must stay free differs: a structure that the plan itself passes may be nearest
    and not too near, while another one is.
    """
    order = sorted(clearances, key=lambda one: (not one.is_too_near, one.distance_m))
    return tuple(order)


class NeedleSurroundings:
    """The structures at risk around a planned path, in the robot's base.

    Args:
        labels: The segmentation.
        registration: Of the patient.
        entry_m: Planned entry in the model, (3,).
        target_m: Planned target in the model, (3,).
        space: What must stay free around the needle; its deviation is not added to the
            margin here, but stated beside each distance.
        leave_out: Names of structures that the needle may touch, such as the target.

    Attributes:
        names: Of the structures.
    """

    def __init__(
        self,
        labels: Segmentation,
        registration: Registration,
        entry_m: ArrayLike,
        target_m: ArrayLike,
        space: FreeSpace,
        leave_out: Iterable[str] = (),
    ) -> None:
        # A structure that the plan itself passes nearer than its margin is too near
        # only when the needle comes nearer by this much.
        closer_m = 1e-3
        kept_free_m = space.needle_radius_m + space.margin_m
        left_out = frozenset(leave_out)
        chosen = [one for one in labels.at_risk() if one.name not in left_out]
        self.names = tuple(one.name for one in chosen)
        self._boxes = [VoxelBoxes(labels, one) for one in chosen]
        self._registration = registration
        self._entry_m = np.asarray(entry_m, dtype=float)
        way_m = np.asarray(target_m, dtype=float) - self._entry_m
        self._length_m = float(np.linalg.norm(way_m))
        self._axis = way_m / self._length_m
        self._std_m = space.std_m
        planned = [
            boxes.nearest(entry_m, target_m, kept_free_m) for boxes in self._boxes
        ]
        self._needed_m = [
            kept_free_m if one is None else one.distance_m - closer_m for one in planned
        ]
        self._ends_m: Array = np.zeros((0, 3))
        self._found: tuple[NeedleClearance, ...] = ()

    def clearances(self, tip_m: Array, axis: Array) -> tuple[NeedleClearance, ...]:
        """Return how near the needle comes to structures within 0.1 m.

        Those that are too near come first, then the nearest. Places of the needle are
        rounded to 0.1 mm, so that a sample in which it hardly moves costs little.

        Args:
            tip_m: Tip of the needle in the robot's base, (3,).
            axis: Its direction, of length one, (3,).
        """
        step_m = 0.1e-3
        # The way ahead of a tip further above the entry is not judged: an arm on its
        # way to the patient points anywhere.
        approach_m = 0.05
        tip = self._registration.to_model(tip_m)
        forward = axis @ self._registration.rotation
        depth_m = float((tip - self._entry_m) @ self._axis)
        if depth_m < -approach_m:
            return ()
        skin = tip - max(depth_m, 0.0) * forward
        last = tip + max(self._length_m - depth_m, 0.0) * forward
        ends_m = step_m * np.rint(np.array([skin, tip, last]) / step_m)
        if not np.array_equal(ends_m, self._ends_m):
            self._ends_m = ends_m
            found = [self._measure(n, ends_m) for n in range(len(self._boxes))]
            self._found = sort_clearances(filter(None, found))
        return self._found

    def _measure(self, number: int, ends_m: Array) -> NeedleClearance | None:
        """Return how near the needle comes to a structure; None if it stays away.

        Args:
            number: Of the structure.
            ends_m: Entry of the needle, its tip, and the end of its way in LPS, (3, 3);
                entry and tip are one above the skin.
        """
        boxes = self._boxes[number]
        is_inside = not np.array_equal(ends_m[0], ends_m[1])
        inside = boxes.nearest(ends_m[0], ends_m[1], REACH_m) if is_inside else None
        ahead = boxes.nearest(ends_m[1], ends_m[2], REACH_m)
        found = [one for one in (inside, ahead) if one is not None]
        if not found:
            return None
        nearest = min(found, key=lambda one: one.distance_m)
        return NeedleClearance(
            number,
            self.names[number],
            np.inf if inside is None else inside.distance_m,
            np.inf if ahead is None else ahead.distance_m,
            self._std_m,
            self._needed_m[number],
            nearest.is_obstacle,
            *self._registration.to_robot(nearest.place_m).tolist(),
        )
