"""Straight paths from the skin to a target: found, judged and ranked.

Rays leave the target in directions spread evenly over the sphere. Where one leaves the
body is its entry. What is too long, too flat on the skin, or too near to a structure to
avoid is left out; the others are ranked by

    cost = length / longest + angle / largest + needed clearance / clearance,

and of those whose entries lie close together the best is kept.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foundation.arrays import Array
from needleforce.anatomy.clearance import Clearance, FreeSpace, VoxelBoxes
from needleforce.anatomy.errors import TWO_POINTS, PlanError, VolumeError
from needleforce.anatomy.path_layers import UNLABELLED, Layer, find_layers

if TYPE_CHECKING:
    from needleforce.anatomy.labels import Labels

DIRECTIONS = 6000
"""Rays over the whole sphere: 2.6 degrees from one to the next, 5 mm at 110 mm."""

STEP_VOXELS = 0.5
"""Step along a ray, in the smallest spacing of the voxels."""


USUAL_SPACE = FreeSpace(margin_m=5e-3)
"""Of a path where no other margin is asked for."""


@dataclass(frozen=True)
class PathLimits:
    """What a path may be.

    Attributes:
        max_length_m: From the skin to the target.
        max_angle_rad: Between the path and the skin's normal.
        space: What must stay free around it.
    """

    max_length_m: float = 0.12
    max_angle_rad: float = np.radians(35.0)
    space: FreeSpace = USUAL_SPACE


@dataclass(frozen=True, eq=False)
class SkinPath:
    """A straight path from the skin to the target.

    Attributes:
        entry_m: Where it meets the skin, (3,) in LPS.
        target_m: Where it ends, (3,).
        angle_rad: Between it and the skin's normal.
        cost: By which paths are ranked, the least first.
        layers: What it crosses.
        clearances: How near it comes to structures at risk and obstacles.
    """

    entry_m: Array
    target_m: Array
    angle_rad: float
    cost: float
    layers: tuple[Layer, ...]
    clearances: tuple[Clearance, ...]

    @property
    def length_m(self) -> float:
        """From entry to target."""
        return float(np.linalg.norm(self.target_m - self.entry_m))


class FoundPaths(NamedTuple):
    """What a search found.

    Attributes:
        paths: The best first.
        rejected: How many rays were left out, by the reason.
    """

    paths: tuple[SkinPath, ...]
    rejected: Counter[str]


class _Rays(NamedTuple):
    """Rays from the target that leave the body.

    Attributes:
        entries_m: Where they do, (n, 3).
        outward: Their directions, (n, 3).
        lengths_m: How far away that is, (n,).
    """

    entries_m: Array
    outward: Array
    lengths_m: Array

    def chosen(self, is_chosen: NDArray[np.bool_]) -> "_Rays":
        """Return some of the rays."""
        return _Rays(
            self.entries_m[is_chosen],
            self.outward[is_chosen],
            self.lengths_m[is_chosen],
        )


def find_paths(
    labels: "Labels",
    target_m: ArrayLike,
    avoid: Iterable[str],
    limits: PathLimits = PathLimits(),
    progress: Callable[[float], None] = lambda fraction: None,
) -> FoundPaths:
    """Return the best straight paths from the skin to a target.

    Args:
        labels: The segmentation with the body, see `Labels.with_body`.
        target_m: The target, (3,) in LPS.
        avoid: Names of the structures that keep the clearance that `limits` ask for.
        limits: What a path may be.
        progress: Called with the fraction done.

    Raises:
        VolumeError: The target lies outside the body, or no structure has one of the
            names.
        PlanError: No path is within the limits; the message says what each limit
            refused.
    """
    target = np.asarray(target_m, dtype=float)
    avoided = [labels[name] for name in avoid]
    inside = _inside_body(labels)
    if not _are_inside(labels, inside, target[None])[0]:
        raise VolumeError(
            f"the target {np.round(1e3 * target, 1).tolist()} mm (LPS) lies outside "
            "the body that the CT shows",
            TWO_POINTS,
        )
    rejected: Counter[str] = Counter()
    rays = _cast_rays(labels, inside, target, limits.max_length_m)
    rejected[f"longer than {1e3 * limits.max_length_m:g} mm"] = DIRECTIONS - len(
        rays.lengths_m
    )
    angles_rad = _skin_angles_rad(labels, inside, rays)
    is_steep = angles_rad <= limits.max_angle_rad
    flattest_deg = np.degrees(limits.max_angle_rad)
    rejected[f"more than {flattest_deg:.0f} degrees from the skin's normal"] = int(
        (~is_steep).sum()
    )
    rays = rays.chosen(is_steep)
    angles_rad = angles_rad[is_steep]
    boxes = [VoxelBoxes(labels, item) for item in avoided]
    clear = _clear_rays(boxes, rays, target, limits, rejected, progress)
    if not clear.any():
        raise PlanError(
            _describe_no_path(rejected),
            "Allow a longer or a flatter path or a smaller margin, avoid "
            "less, or choose another target.",
        )
    ranked = _rank(labels, boxes, rays.chosen(clear), angles_rad[clear], target, limits)
    return FoundPaths(tuple(ranked), rejected)


def judge_path(
    labels: "Labels",
    entry_m: ArrayLike,
    target_m: ArrayLike,
    limits: PathLimits = PathLimits(),
) -> SkinPath:
    """Return one path from the skin towards a given point outside, judged.

    Args:
        labels: The segmentation with the body.
        entry_m: A point of the line, at the skin or outside, (3,) in LPS.
        target_m: Where it ends, inside, (3,).
        limits: What a path may be; nothing is refused here.

    Raises:
        VolumeError: The target lies outside the body, or the line never leaves it.
    """
    target = np.asarray(target_m, dtype=float)
    outward = np.asarray(entry_m, dtype=float) - target
    outward = outward / np.linalg.norm(outward)
    inside = _inside_body(labels)
    reach_m = float(np.linalg.norm(np.ptp(labels.grid.corners_m(), axis=0)))
    rays = _exits(labels, inside, target, outward[None], reach_m)
    if not _are_inside(labels, inside, target[None])[0] or not len(rays.lengths_m):
        raise VolumeError(
            "the line does not lead from outside the body to a target inside it",
            TWO_POINTS,
        )
    angles_rad = _skin_angles_rad(labels, inside, rays)
    boxes = [
        VoxelBoxes(labels, one)
        for one in labels.structures
        if one.is_obstacle or one.is_risk
    ]
    return _rank(labels, boxes, rays, angles_rad, target, limits)[0]


def orient_line(labels: "Labels", ends_m: Array) -> tuple[Array, Array]:
    """Return the entry and the target, (3,) each: programs write either one first.

    The entry is the end behind which, or in front of which, the body soon ends.

    Args:
        labels: The segmentation with the body.
        ends_m: The two ends in LPS, shape (2, 3).

    Raises:
        VolumeError: The ends are one point, or neither leads out of the body.
    """
    length_m = float(np.linalg.norm(ends_m[1] - ends_m[0]))
    if not length_m > 0.0:
        raise VolumeError("both ends of the line are one point", TWO_POINTS)
    inside = _inside_body(labels)
    reach_m = float(np.linalg.norm(np.ptp(labels.grid.corners_m(), axis=0)))
    distances_m = [np.inf, np.inf]  # from the target, through the entry, to the skin
    for number in range(2):
        entry_m = ends_m[number]
        target_m = ends_m[1 - number]
        outward = (entry_m - target_m) / length_m
        rays = _exits(labels, inside, target_m, outward[None], reach_m)
        is_inside = bool(_are_inside(labels, inside, target_m[None])[0])
        if is_inside and len(rays.lengths_m):
            distances_m[number] = float(rays.lengths_m[0])
    entry = int(np.argmin(distances_m))
    if not np.isfinite(distances_m[entry]):
        raise VolumeError(
            "neither end of the line lies inside the body, with the skin behind the "
            "other one",
            TWO_POINTS,
        )
    return ends_m[entry], ends_m[1 - entry]


def _inside_body(labels: "Labels") -> NDArray[np.bool_]:
    """Return which voxels any structure covers."""
    inside = labels.volumes[0] != 0
    for volume in labels.volumes[1:]:
        inside |= volume != 0
    return inside


def _are_inside(
    labels: "Labels", inside: NDArray[np.bool_], points_m: Array
) -> NDArray[np.bool_]:
    """Return which points (..., 3) lie in voxels of the body."""
    index = np.rint(labels.grid.indices(points_m)).astype(np.int32)
    is_valid = np.all((index >= 0) & (index < labels.grid.shape), axis=-1)
    voxels = tuple(np.moveaxis(np.where(is_valid[..., None], index, 0), -1, 0))
    return np.asarray(is_valid & inside[voxels])


def _even_directions(count: int) -> Array:
    """Return directions spread evenly over the sphere: a Fibonacci lattice.

    Args:
        count: Number of directions; the result has shape (count, 3).
    """
    number = np.arange(count) + 0.5
    height = 1.0 - 2.0 * number / count
    angle = np.pi * (1.0 + 5.0**0.5) * number
    radius = np.sqrt(1.0 - height**2)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=1)


def _cast_rays(
    labels: "Labels", inside: NDArray[np.bool_], target: Array, max_length_m: float
) -> _Rays:
    """Return the rays from the target that leave the body soon enough."""
    return _exits(labels, inside, target, _even_directions(DIRECTIONS), max_length_m)


def _exits(
    labels: "Labels",
    inside: NDArray[np.bool_],
    target: Array,
    directions: Array,
    max_length_m: float,
) -> _Rays:
    """Return the rays of given directions that leave the body soon enough.

    A ray that leaves the volume before it leaves the body has no entry.
    """
    step_m = STEP_VOXELS * float(labels.grid.spacing_m.min())
    distances_m = step_m * np.arange(1, int(max_length_m / step_m) + 2)
    lengths_m = np.full(len(directions), np.nan)
    for number, direction in enumerate(directions):
        points_m = target + distances_m[:, None] * direction
        outside = np.flatnonzero(~_are_inside(labels, inside, points_m))
        if not len(outside):
            continue
        exit_m = points_m[outside[0]]
        index = np.rint(labels.grid.indices(exit_m))
        if np.all((index >= 0) & (index < labels.grid.shape)):
            lengths_m[number] = distances_m[outside[0]] - 0.5 * step_m
    has_exit = lengths_m <= max_length_m
    lengths_m = lengths_m[has_exit]
    outward = directions[has_exit]
    return _Rays(target + lengths_m[:, None] * outward, outward, lengths_m)


def _skin_angles_rad(labels: "Labels", inside: NDArray[np.bool_], rays: _Rays) -> Array:
    """Return the angles between rays and the skin's normal, (n,).

    The normal points to the centroid of the part of a ball that lies outside the body.
    """
    # Radius of the ball whose part outside the body gives the skin's normal: folds and
    # voxels average out, the curvature of a flank does not.
    skin_reach_m = 0.012
    normal_points = 1200  # points in that ball
    ball = _even_directions(normal_points)
    radii = np.cbrt((np.arange(normal_points) * 0.618) % 1.0)
    offsets_m = skin_reach_m * radii[:, None] * ball
    angles_rad = np.empty(len(rays.lengths_m))
    for number, entry_m in enumerate(rays.entries_m):
        outside = ~_are_inside(labels, inside, entry_m + offsets_m)
        normal = offsets_m[outside].sum(axis=0)
        cosine = normal @ rays.outward[number] / max(np.linalg.norm(normal), 1e-12)
        angles_rad[number] = np.arccos(np.clip(cosine, -1.0, 1.0))
    return angles_rad


def _clear_rays(
    avoided: Sequence[VoxelBoxes],
    rays: _Rays,
    target: Array,
    limits: PathLimits,
    rejected: Counter[str],
    progress: Callable[[float], None],
) -> NDArray[np.bool_]:
    """Return which rays keep their distance from all structures to avoid."""
    is_clear = np.ones(len(rays.lengths_m), bool)
    needed_m = limits.space.needed_m
    for number, boxes in enumerate(avoided):
        reason = f"nearer than {1e3 * needed_m:.1f} mm to {boxes.structure.name}"
        for ray in np.flatnonzero(is_clear):
            if boxes.nearest(rays.entries_m[ray], target, needed_m) is not None:
                is_clear[ray] = False
                rejected[reason] += 1
        progress((number + 1) / len(avoided))
    return is_clear


def _rank(
    labels: "Labels",
    avoided: Sequence[VoxelBoxes],
    rays: _Rays,
    angles_rad: Array,
    target: Array,
    limits: PathLimits,
) -> list[SkinPath]:
    """Return the best paths, their entries apart from each other, the best first."""
    # Keeps the cost finite where a structure that need not be avoided is crossed.
    min_clearance_m = 1e-4
    # Of so many rays, the shortest and steepest, the exact clearance is found.
    max_judged = 400
    max_paths = 10  # so many paths are kept
    min_entry_distance_m = 0.015  # entries closer together count as one
    geometric_cost = (
        rays.lengths_m / limits.max_length_m + angles_rad / limits.max_angle_rad
    )
    judged = np.argsort(geometric_cost)[:max_judged]
    clearance_m = [
        min(
            nearest.distance_m
            for boxes in avoided
            if (nearest := boxes.nearest(entry_m, target)) is not None
        )
        if avoided
        else np.inf
        for entry_m in rays.entries_m[judged]
    ]
    cost = geometric_cost[judged] + limits.space.needed_m / np.maximum(
        clearance_m, min_clearance_m
    )
    paths: list[SkinPath] = []
    for place in np.argsort(cost):
        number = judged[place]
        entry_m = rays.entries_m[number]
        is_new = all(
            np.linalg.norm(entry_m - path.entry_m) >= min_entry_distance_m
            for path in paths
        )
        if is_new:
            angle_rad = float(angles_rad[number])
            paths.append(
                _describe_path(labels, entry_m, target, angle_rad, float(cost[place]))
            )
        if len(paths) == max_paths:
            break
    return paths


def _describe_path(
    labels: "Labels", entry_m: Array, target: Array, angle_rad: float, cost: float
) -> SkinPath:
    """Return a path with its layers and clearances; it begins at the first tissue."""
    # So much air the path of a found entry may begin with: skin lies between voxels.
    max_gap_m = 3e-3
    layers = find_layers(labels, entry_m, target)
    if layers[0].name == UNLABELLED and layers[0].exit_m < max_gap_m:
        axis = (target - entry_m) / np.linalg.norm(target - entry_m)
        entry_m = entry_m + layers[0].exit_m * axis
        layers = find_layers(labels, entry_m, target)
    clearances = labels.clearances(entry_m, target)
    return SkinPath(entry_m, target, angle_rad, cost, tuple(layers), tuple(clearances))


def _describe_no_path(rejected: Counter[str]) -> str:
    """Return in words that there is no path, and what refused how many rays."""
    reasons = [f"{count} {reason}" for reason, count in rejected.most_common() if count]
    return f"no path: of {DIRECTIONS} directions from the target {', '.join(reasons)}"
