"""An analytic torso of ellipsoids, in place of a CT.

It gives a scan's labels, and where a path crosses which organ.

Stands in for a CT in tests, benchmarks and the demonstration without data. Points are
in the patient's frame LPS (x to the left, y to the back, z to the head), in metres.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from foundation.arrays import Array


@dataclass(frozen=True, eq=False)
class Ellipsoid:
    """A solid ellipsoid.

    Attributes:
        name: Name of the organ.
        centre_m: Centre, shape (3,).
        radii_m: Radii, shape (3,).
        axes: Directions of the radii in its columns, shape (3, 3).
    """

    name: str
    centre_m: Array
    radii_m: Array
    axes: Array

    @property
    def reach_m(self) -> Array:
        """Half the edges of the box around it along x, y, z, (3,)."""
        return np.linalg.norm(self.axes * self.radii_m, axis=1)

    def scaled(self, points_m: ArrayLike) -> Array:
        """Return points (..., 3) in the axes in which it is the unit ball."""
        return (np.asarray(points_m, float) - self.centre_m) @ self.axes / self.radii_m

    def distance_m(self, points_m: ArrayLike) -> Array:
        """Return the signed distance of points close to the surface, to first order.

        It is positive outside.
        """
        ball = self.scaled(points_m)
        level = np.linalg.norm(ball, axis=-1)
        return level * (level - 1.0) / np.linalg.norm(ball / self.radii_m, axis=-1)

    def depths_m(self, entry_m: ArrayLike, direction: ArrayLike) -> tuple[float, ...]:
        """Return the depths at which a line crosses it: two, or none.

        Args:
            entry_m: Point of the line at depth zero, shape (3,).
            direction: Its direction, length one, shape (3,).
        """
        start = self.scaled(entry_m)
        step = np.asarray(direction, float) @ self.axes / self.radii_m
        a = step @ step
        b = start @ step
        c = start @ start - 1.0
        root = b * b - a * c
        if root <= 0.0:
            return ()
        return float((-b - root**0.5) / a), float((-b + root**0.5) / a)


class Stretch(NamedTuple):
    """Part of a path within one organ.

    Attributes:
        name: Name of the organ, empty for air.
        entry_m: Depth at which the path enters it.
        exit_m: Depth at which the path leaves it.
    """

    name: str
    entry_m: float
    exit_m: float


@dataclass(frozen=True, eq=False)
class Torso:
    """A torso of ellipsoids.

    Attributes:
        shapes: Ellipsoids, each of which replaces those before it in the list.
    """

    shapes: Sequence[Ellipsoid]

    def __getitem__(self, name: str) -> Ellipsoid:
        return next(shape for shape in self.shapes if shape.name == name)

    def crossings(self, entry_m: ArrayLike, target_m: ArrayLike) -> list[Stretch]:
        """Return the organs that the path between two points crosses, in order.

        The depths are exact.
        """
        entry = np.asarray(entry_m, float)
        along = np.subtract(target_m, entry_m)
        length = float(np.linalg.norm(along))
        direction = along / length
        cuts = {t for shape in self.shapes for t in shape.depths_m(entry, direction)}
        depths = [0.0, *sorted(t for t in cuts if 0.0 < t < length), length]
        stretches: list[Stretch] = []
        for begin, end in pairwise(depths):
            name = self.name_at(entry + 0.5 * (begin + end) * direction)
            if stretches and stretches[-1].name == name:
                begin = stretches.pop().entry_m
            stretches.append(Stretch(name, begin, end))
        return stretches

    def name_at(self, point_m: ArrayLike) -> str:
        """Return the name of the organ at a point, empty for air."""
        inside = [s.name for s in self.shapes if np.sum(s.scaled(point_m) ** 2) < 1.0]
        return inside[-1] if inside else ""

    def voxels(
        self, shape: tuple[int, ...], origin_m: ArrayLike, axes_m: ArrayLike
    ) -> NDArray[np.uint8]:
        """Return the label of every voxel.

        It is the number, from 1, of the last shape that holds the voxel's centre; 0 for
        air.

        Args:
            shape: Voxels along each axis.
            origin_m: Centre of the first voxel, (3,).
            axes_m: Step from a voxel to the next along each axis, (3, 3) columns.
        """
        labels = np.zeros(shape, np.uint8)
        origin = np.asarray(origin_m, float)
        axes = np.asarray(axes_m, float)
        for number, body in enumerate(self.shapes, 1):
            _label_inside(labels, number, body, origin, axes)
        return labels


def _label_inside(
    labels: NDArray[np.uint8],
    number: int,
    body: Ellipsoid,
    origin_m: Array,
    axes_m: Array,
) -> None:
    """Write a number into all voxels whose centres an ellipsoid holds."""
    inverse = np.linalg.inv(axes_m)
    centre = inverse @ (body.centre_m - origin_m)
    reach = np.linalg.norm(inverse @ (body.axes * body.radii_m), axis=1)
    low = np.clip(np.floor(centre - reach), 0, labels.shape).astype(int)
    high = np.clip(np.ceil(centre + reach) + 1, 0, labels.shape).astype(int)
    j, k = np.meshgrid(
        np.arange(low[1], high[1]), np.arange(low[2], high[2]), indexing="ij"
    )
    # Plane by plane: the points of a fine volume need gigabytes.
    for i in range(low[0], high[0]):
        indices = np.stack([np.full_like(j, i), j, k], axis=-1)
        points_m = origin_m + indices @ axes_m.T
        plane = labels[i, low[1] : high[1], low[2] : high[2]]
        plane[np.sum(body.scaled(points_m) ** 2, axis=-1) < 1.0] = number


# Name, centre [mm], radii [mm], rotation vector [degrees].
_SHAPES = (
    ("fat", (0, 0, 0), (165, 115, 160), (0, 0, 0)),
    ("muscle", (0, 2, 0), (148, 99, 152), (0, 0, 0)),
    ("cavity", (0, 0, 0), (134, 84, 142), (0, 0, 0)),
    ("vertebra", (0, 78, 0), (21, 22, 135), (0, 0, 0)),
    ("rib_right", (-45, -87, 20), (38, 5, 6), (0, 0, 19)),
    ("stomach", (62, -18, 50), (42, 38, 48), (10, -20, 0)),
    ("liver", (-48, -8, 42), (74, 58, 62), (0, 18, -12)),
    ("vessel", (-38, 4, 42), (6, 5, 48), (12, 55, 0)),
    ("lesion", (-70, -22, 38), (13, 11, 12), (0, 0, 30)),
)
"""Sizes of a slender adult; the liver is on the right, which is the side of negative
x."""


def analytic_torso(rng: np.random.Generator | None = None) -> Torso:
    """Return the torso or, with a generator, a variation of it.

    Sizes vary by 5 %, positions by 3 mm, directions by 5 degrees.
    """
    shapes = []
    for name, centre_mm, radii_mm, turn_deg in _SHAPES:
        centre = 1e-3 * np.array(centre_mm, float)
        radii = 1e-3 * np.array(radii_mm, float)
        turn = np.radians(turn_deg)
        if rng is not None:
            centre = centre + rng.normal(0.0, 3e-3, 3)
            radii = radii * (1.0 + rng.normal(0.0, 0.05, 3))
            turn = turn + rng.normal(0.0, np.radians(5.0), 3)
        shapes.append(
            Ellipsoid(name, centre, radii, Rotation.from_rotvec(turn).as_matrix())
        )
    return Torso(tuple(shapes))
