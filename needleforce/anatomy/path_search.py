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
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foundation.arrays import Array
from needleforce.anatomy.clearance import Clearance, FreeSpace, VoxelBoxes
from needleforce.anatomy.errors import PlanError, VolumeError
from needleforce.anatomy.labels import Labels
from needleforce.anatomy.path_layers import UNLABELLED, Layer, find_layers

DIRECTIONS = 6000
"""Rays over the whole sphere: 2.6 degrees from one to the next, 5 mm at 110 mm."""

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


def find_paths(
    labels: Labels,
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
    boxes = [VoxelBoxes(labels, labels[name]) for name in avoid]
    body = _Body(labels)
    if body.kinds(target) != 1:
        raise VolumeError(f"the target {target.tolist()} m lies outside the body")
    directions = _even_directions(DIRECTIONS)
    entries_m = body.exits_m(target, directions, limits.max_length_m)
    has_exit = np.isfinite(entries_m).all(axis=1)
    angles_rad = np.full(DIRECTIONS, np.inf)
    angles_rad[has_exit] = body.skin_angles_rad(entries_m[has_exit], target)
    is_clear = has_exit & (angles_rad <= limits.max_angle_rad)
    rejected = Counter(
        {
            f"longer than {1e3 * limits.max_length_m:g} mm": int((~has_exit).sum()),
            f"more than {np.degrees(limits.max_angle_rad):.0f} degrees from the skin's "
            "normal": int((has_exit & ~is_clear).sum()),
        }
    )
    needed_m = limits.space.needed_m
    for number, one in enumerate(boxes, 1):
        reason = f"nearer than {1e3 * needed_m:.1f} mm to {one.structure.name}"
        for ray in np.flatnonzero(is_clear):
            if one.nearest(entries_m[ray], target, needed_m) is not None:
                is_clear[ray] = False
                rejected[reason] += 1
        progress(number / len(boxes))
    if not is_clear.any():
        reasons = [f"{count} {why}" for why, count in rejected.most_common() if count]
        raise PlanError(
            f"no path: of {DIRECTIONS} directions from the target {', '.join(reasons)}",
            "Allow a longer or a flatter path or a smaller margin, avoid less, or "
            "choose another target.",
        )
    return FoundPaths(
        _rank(labels, boxes, entries_m[is_clear], angles_rad[is_clear], target, limits),
        rejected,
    )


def judge_path(
    labels: Labels,
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
    body = _Body(labels)
    way_m = np.asarray(entry_m, dtype=float) - target
    entries_m = body.exits_m(target, way_m[None] / np.linalg.norm(way_m))
    if body.kinds(target) != 1 or not np.isfinite(entries_m).all():
        raise VolumeError("the line leads from no point outside to one inside the body")
    boxes = [VoxelBoxes(labels, one) for one in labels.at_risk()]
    angles_rad = body.skin_angles_rad(entries_m, target)
    return _rank(labels, boxes, entries_m, angles_rad, target, limits)[0]


def orient_line(labels: Labels, ends_m: Array) -> tuple[Array, Array]:
    """Return the entry and the target, (3,) each: programs write either one first.

    The entry is the end behind which, or in front of which, the body soon ends.

    Args:
        labels: The segmentation with the body.
        ends_m: The two ends in LPS, shape (2, 3).

    Raises:
        VolumeError: The ends are one point, or neither leads out of the body.
    """
    body = _Body(labels)
    lengths_m = np.full(2, np.inf)  # from the target, through the entry, to the skin
    for entry in (0, 1):
        target_m = ends_m[1 - entry]
        way_m = ends_m[entry] - target_m
        direction = way_m / max(float(np.linalg.norm(way_m)), 1e-9)
        exit_m = body.exits_m(target_m, direction[None])[0]
        if body.kinds(target_m) == 1 and np.isfinite(exit_m).all() and way_m.any():
            lengths_m[entry] = np.linalg.norm(exit_m - target_m)
    entry = int(lengths_m.argmin())
    if lengths_m[entry] == np.inf:
        raise VolumeError(
            "neither end of the line lies inside the body, with the skin behind the "
            "other one"
        )
    return ends_m[entry], ends_m[1 - entry]


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


class _Body:
    """The voxels that any structure covers."""

    def __init__(self, labels: Labels) -> None:
        self._grid = labels.grid
        self._inside = labels.inside()

    def kinds(self, points_m: Array) -> NDArray[np.integer]:
        """Return 1 for points (..., 3) in the body, 0 in air, -1 beyond the volume."""
        return self._grid.nearest(self._inside, self._grid.indices(points_m), -1)

    def exits_m(
        self, target: Array, directions: Array, max_length_m: float = np.inf
    ) -> Array:
        """Return where rays from a target leave the body soon enough, (n, 3).

        A ray that leaves the volume before it leaves the body has no entry: nan.
        """
        diagonal_m = float(np.linalg.norm(np.ptp(self._grid.corners_m(), axis=0)))
        reach_m = min(diagonal_m, max_length_m)
        step_m = 0.5 * float(self._grid.spacing_m.min())
        distances_m = step_m * np.arange(1, int(reach_m / step_m) + 2)
        exits_m = np.full(directions.shape, np.nan)
        for number, direction in enumerate(directions):
            kinds = self.kinds(target + distances_m[:, None] * direction)
            first = int((kinds != 1).argmax())
            length_m = distances_m[first] - 0.5 * step_m
            if kinds[first] == 0 and length_m <= reach_m:
                exits_m[number] = target + length_m * direction
        return exits_m

    def skin_angles_rad(self, entries_m: Array, target: Array) -> Array:
        """Return the angles between paths and the skin's normal, (n,).

        The normal points to the centroid of the part of a ball that lies outside the
        body: folds and voxels average out, the curvature of a flank does not.
        """
        skin_reach_m = 0.012  # radius of the ball
        normal_points = 1200  # in it
        radii = np.cbrt((np.arange(normal_points) * 0.618) % 1.0)
        offsets_m = skin_reach_m * radii[:, None] * _even_directions(normal_points)
        angles_rad = np.empty(len(entries_m))
        for number, entry_m in enumerate(entries_m):
            normal = offsets_m[self.kinds(entry_m + offsets_m) != 1].sum(axis=0)
            way_m = entry_m - target
            lengths = np.linalg.norm(normal) * np.linalg.norm(way_m)
            cosine = normal @ way_m / max(lengths, 1e-12)
            angles_rad[number] = np.arccos(np.clip(cosine, -1.0, 1.0))
        return angles_rad


def _rank(
    labels: Labels,
    avoided: Sequence[VoxelBoxes],
    entries_m: Array,
    angles_rad: Array,
    target: Array,
    limits: PathLimits,
) -> tuple[SkinPath, ...]:
    """Return the best paths, their entries apart from each other, the best first."""
    # Keeps the cost finite where a structure that need not be avoided is crossed.
    min_clearance_m = 1e-4
    # Of so many rays, the shortest and steepest, the exact clearance is found.
    max_judged = 400
    max_paths = 10  # so many paths are kept
    min_entry_distance_m = 0.015  # entries closer together count as one
    lengths_m = np.linalg.norm(entries_m - target, axis=1)
    costs = lengths_m / limits.max_length_m + angles_rad / limits.max_angle_rad
    judged = np.argsort(costs)[:max_judged]
    for ray in judged:
        nearest = [one.nearest(entries_m[ray], target) for one in avoided]
        clearances_m = [np.inf, *(one.distance_m for one in nearest if one is not None)]
        costs[ray] += limits.space.needed_m / max(min(clearances_m), min_clearance_m)
    paths: list[SkinPath] = []
    for ray in judged[np.argsort(costs[judged])]:
        apart_m = [np.linalg.norm(entries_m[ray] - path.entry_m) for path in paths]
        if len(paths) < max_paths and min(apart_m, default=1.0) >= min_entry_distance_m:
            angle_rad = float(angles_rad[ray])
            cost = float(costs[ray])
            paths.append(_describe(labels, entries_m[ray], target, angle_rad, cost))
    return tuple(paths)


def _describe(
    labels: Labels, entry_m: Array, target: Array, angle_rad: float, cost: float
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
