"""Straight paths from the skin to a target: found, judged and ranked.

Rays leave the target in directions spread evenly over the sphere. Where one leaves the
body is its entry. What is too long, too flat on the skin, or too near to a structure to
avoid is left out; the others are ranked by

    cost = length / longest + angle / largest + needed clearance / clearance,

and of those whose entries lie close together the best is kept.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foundation.arrays import Array
from needleforce.anatomy.clearance import Clearance, FreeSpace, VoxelBoxes
from needleforce.anatomy.errors import PlanError, VolumeError
from needleforce.anatomy.labels import Labels
from needleforce.anatomy.path_layers import UNLABELLED, Layer

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


def find_paths(
    labels: Labels,
    target_m: ArrayLike,
    avoid: Iterable[str],
    limits: PathLimits = PathLimits(),
    progress: Callable[[float], None] = lambda fraction: None,
) -> tuple[SkinPath, ...]:
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
    exits_m = np.array(
        [
            body.exit_m(target, direction, limits.max_length_m)
            for direction in _even_directions(DIRECTIONS)
        ]
    )
    entries_m = exits_m[np.isfinite(exits_m).all(axis=1)]
    angles_rad = np.array([body.skin_angle_rad(entry, target) for entry in entries_m])
    is_clear = angles_rad <= limits.max_angle_rad
    steep = int(np.count_nonzero(is_clear))
    needed_m = limits.space.needed_m
    for number, one in enumerate(boxes, 1):
        for ray in np.flatnonzero(is_clear):
            is_clear[ray] = one.nearest(entries_m[ray], target, needed_m) is None
        progress(number / len(boxes))
    if not is_clear.any():
        raise PlanError(
            f"no path: of {DIRECTIONS} directions from the target {len(entries_m)} "
            f"leave the body within {1e3 * limits.max_length_m:g} mm, {steep} of these "
            f"within {np.degrees(limits.max_angle_rad):.0f} degrees of the skin's "
            f"normal, and none stays {1e3 * needed_m:.1f} mm from all of "
            f"{', '.join(one.structure.name for one in boxes)}",
            "Allow a longer or a flatter path or a smaller margin, avoid less, or "
            "choose another target.",
        )
    return _rank(
        labels, boxes, entries_m[is_clear], angles_rad[is_clear], target, limits
    )


def judge_line(
    labels: Labels, ends_m: Array, limits: PathLimits = PathLimits()
) -> SkinPath:
    """Return the path along a line, from the skin to one of its ends, judged.

    Programs write either end first: the target is the one from which, through the
    other, the way to the skin is shorter.

    Args:
        labels: The segmentation with the body.
        ends_m: The two ends in LPS, shape (2, 3).
        limits: What a path may be; nothing is refused here.

    Raises:
        VolumeError: The ends are one point, or neither leads out of the body.
    """
    body = _Body(labels)
    # From each end through the other one.
    targets_m = ends_m[::-1]
    ways_m = ends_m - targets_m
    directions = ways_m / max(float(np.linalg.norm(ways_m[0])), 1e-9)
    exits_m = np.array([*map(body.exit_m, targets_m, directions)])
    lengths_m = np.linalg.norm(exits_m - targets_m, axis=1)
    if np.isnan(lengths_m).all():
        raise VolumeError(
            "neither end of the line lies inside the body, with the skin behind the "
            "other one"
        )
    entry = int(np.nanargmin(lengths_m))
    boxes = [VoxelBoxes(labels, one) for one in labels.at_risk()]
    angle_rad = np.array([body.skin_angle_rad(exits_m[entry], targets_m[entry])])
    (path,) = _rank(
        labels, boxes, exits_m[[entry]], angle_rad, targets_m[entry], limits
    )
    return path


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
        self._diagonal_m = float(np.linalg.norm(np.ptp(self._grid.corners_m(), axis=0)))

    def kinds(self, points_m: Array) -> NDArray[np.integer]:
        """Return 1 for points (..., 3) in the body, 0 in air, -1 beyond the volume."""
        return self._grid.nearest(self._inside, self._grid.indices(points_m), -1)

    def exit_m(
        self, target: Array, direction: Array, max_length_m: float = np.inf
    ) -> Array:
        """Return where a ray from a target leaves the body soon enough, (3,).

        One that begins outside, or leaves the volume before the body, has none: nan.
        """
        reach_m = min(self._diagonal_m, max_length_m)
        step_m = 0.5 * float(self._grid.spacing_m.min())
        distances_m = step_m * np.arange(int(reach_m / step_m) + 2)
        kinds = self.kinds(target + distances_m[:, None] * direction)
        first = int((kinds != 1).argmax())
        length_m = distances_m[first] - 0.5 * step_m
        has_exit = kinds[first] == 0 and 0.0 < length_m <= reach_m
        return target + direction * (length_m if has_exit else np.nan)

    def skin_angle_rad(self, entry_m: Array, target: Array) -> float:
        """Return the angle between a path and the skin's normal.

        The normal points to the centroid of the part of a ball that lies outside the
        body: folds and voxels average out, the curvature of a flank does not.
        """
        skin_reach_m = 0.012  # radius of the ball
        normal_points = 1200  # in it
        radii = np.cbrt((np.arange(normal_points) * 0.618) % 1.0)
        offsets_m = skin_reach_m * radii[:, None] * _even_directions(normal_points)
        normal = offsets_m[self.kinds(entry_m + offsets_m) != 1].sum(axis=0)
        way_m = entry_m - target
        lengths = np.linalg.norm(normal) * np.linalg.norm(way_m)
        cosine = normal @ way_m / max(lengths, 1e-12)
        return float(np.arccos(np.clip(cosine, -1.0, 1.0)))


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
        clearances_m = [one.distance_m for one in nearest if one is not None]
        nearest_m = max(min(clearances_m, default=np.inf), min_clearance_m)
        costs[ray] += limits.space.needed_m / nearest_m
    paths: list[SkinPath] = []
    for ray in judged[np.argsort(costs[judged])]:
        apart_m = [np.linalg.norm(entries_m[ray] - path.entry_m) for path in paths]
        if len(paths) < max_paths and min(apart_m, default=1.0) >= min_entry_distance_m:
            entry_m = _begin_at_tissue(labels, entries_m[ray], target)
            path = SkinPath(
                entry_m=entry_m,
                target_m=target,
                angle_rad=float(angles_rad[ray]),
                cost=float(costs[ray]),
                layers=tuple(labels.layers_along(entry_m, target)),
                clearances=tuple(labels.clearances(entry_m, target)),
            )
            paths.append(path)
    return tuple(paths)


def _begin_at_tissue(labels: Labels, entry_m: Array, target: Array) -> Array:
    """Return the entry without air in front of it: skin lies between voxels."""
    max_gap_m = 3e-3  # so much air a found path may begin with
    first = labels.layers_along(entry_m, target)[0]
    if first.name != UNLABELLED or first.exit_m >= max_gap_m:
        return entry_m
    way_m = target - entry_m
    return entry_m + first.exit_m * way_m / np.linalg.norm(way_m)
