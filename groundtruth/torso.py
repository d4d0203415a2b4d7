"""An analytic torso: bodies whose surfaces, volumes and crossings with a needle are known exactly.

Ellipsoids, one over the other: what comes later lies on top. Metres, LPS, the origin in the middle
of the body, which lies on its back. Sizes are those of an adult's upper abdomen; nothing is taken
from a patient.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from groundtruth.errors import ScenarioError

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Ellipsoid:
    """A solid body."""

    name: str
    center_m: Array  # shape (3,)
    radii_m: Array  # along its axes, shape (3,)
    rotation: Array  # its axes as columns, shape (3, 3)

    @property
    def volume_m3(self) -> float:
        """Its volume."""
        return 4.0 / 3.0 * np.pi * float(np.prod(self.radii_m))

    def level(self, points_m: ArrayLike) -> Array:
        """Below 1 inside, above 1 outside, at points of shape (..., 3)."""
        local = (np.asarray(points_m, dtype=float) - self.center_m) @ self.rotation / self.radii_m
        return np.einsum("...i,...i->...", local, local)

    def crossings_m(self, start_m: Array, axis: Array) -> list[float]:
        """Where a line from a point along a unit vector meets its surface: two depths, or none."""
        local = self.rotation.T @ (start_m - self.center_m) / self.radii_m
        along = self.rotation.T @ axis / self.radii_m
        a, b, c = along @ along, local @ along, local @ local - 1.0
        root = b * b - a * c
        return [] if root <= 0.0 else [float((-b + s * np.sqrt(root)) / a) for s in (-1.0, 1.0)]

    def front(self, count: int, rng: np.random.Generator) -> Array:
        """Points on the half of its surface that looks to the front, shape (count, 3)."""
        found = rng.normal(size=(8 * count, 3))
        found /= np.linalg.norm(found, axis=1, keepdims=True)
        points = (found * self.radii_m) @ self.rotation.T + self.center_m
        return points[(found / self.radii_m) @ self.rotation.T[:, 1] < 0.0][:count]


class Torso:
    """Bodies in layers.

    Attributes:
        bodies: From the skin inwards; number 1 is the first.
    """

    def __init__(self, bodies: list[Ellipsoid]) -> None:
        """Stack the bodies; `ScenarioError` without any."""
        if not bodies:
            raise ScenarioError("a torso without bodies: expected one ellipsoid at least")
        self.bodies = bodies

    @property
    def names(self) -> dict[int, str]:
        """Names of the bodies by number; 0 is air."""
        return {number: body.name for number, body in enumerate(self.bodies, start=1)}

    def numbers_at(self, points_m: ArrayLike) -> NDArray[np.uint8]:
        """Which body lies on top at points of shape (..., 3); 0 for air."""
        points = np.asarray(points_m, dtype=float)
        found = np.zeros(points.shape[:-1], dtype=np.uint8)
        for number, body in enumerate(self.bodies, start=1):
            found[body.level(points) < 1.0] = number
        return found

    def layers(self, entry_m: ArrayLike, target_m: ArrayLike) -> list[tuple[int, float, float]]:
        """Number, entry and exit depth [m] of every body along a needle, exactly."""
        start, end = np.asarray(entry_m, dtype=float), np.asarray(target_m, dtype=float)
        length_m = float(np.linalg.norm(end - start))
        axis = (end - start) / length_m
        cuts = {0.0, length_m}
        for body in self.bodies:
            cuts |= {cut for cut in body.crossings_m(start, axis) if 0.0 < cut < length_m}
        depths = sorted(cuts)
        found: list[tuple[int, float, float]] = []
        for begin, stop in pairwise(depths):
            number = int(self.numbers_at(start + 0.5 * (begin + stop) * axis))
            if found and found[-1][0] == number:
                found[-1] = (number, found[-1][1], stop)
            else:
                found.append((number, begin, stop))
        return found

    def voxels(
        self, spacing_m: ArrayLike, rotation: ArrayLike | None = None
    ) -> tuple[NDArray[np.uint8], Array, Array]:
        """Numbers [i, j, k] of voxels around the body, the first one's centre and the steps [m].

        Args:
            spacing_m: Of the voxels, one number or three.
            rotation: Of the grid against the body's axes, shape (3, 3).
        """
        turned = np.eye(3) if rotation is None else np.asarray(rotation, dtype=float)
        axes = turned * np.broadcast_to(spacing_m, 3)
        body = self.bodies[0]
        # The box of an ellipsoid along other axes.
        half = np.linalg.norm((turned.T @ body.rotation) * body.radii_m, axis=1)
        half = half + 3.0 * np.broadcast_to(spacing_m, 3)
        shape = np.ceil(2.0 * half / np.broadcast_to(spacing_m, 3)).astype(int) + 1
        origin = body.center_m - axes @ (0.5 * (shape - 1))
        numbers = np.zeros(shape, dtype=np.uint8)
        j, k = np.meshgrid(np.arange(shape[1]), np.arange(shape[2]), indexing="ij")
        for i in range(shape[0]):  # a slice at a time: large volumes fit into memory
            index = np.stack([np.full_like(j, i), j, k], axis=-1)
            numbers[i] = self.numbers_at(origin + index @ axes.T)
        return numbers, origin, axes


def random_torso(rng: np.random.Generator) -> Torso:
    """Skin with fat, muscle, cavity, liver, a vessel and a lesion in it; sizes vary by a tenth."""

    def body(name: str, center_mm: ArrayLike, radii_mm: ArrayLike, turn: float = 0.1) -> Ellipsoid:
        vary = 1.0 + 0.1 * rng.uniform(-1.0, 1.0, 3)
        shift = 0.05 * rng.uniform(-1.0, 1.0, 3) * np.asarray(radii_mm, dtype=float)
        return Ellipsoid(
            name,
            1e-3 * (np.asarray(center_mm, dtype=float) + shift),
            1e-3 * np.asarray(radii_mm, dtype=float) * vary,
            _turned(turn * rng.normal(size=3)),
        )

    skin = body("fat", (0, 0, 0), (165, 115, 150), 0.03)
    inner = [
        Ellipsoid(name, skin.center_m, factor * skin.radii_m, skin.rotation)
        for name, factor in (("muscle", rng.uniform(0.84, 0.9)), ("cavity", rng.uniform(0.74, 0.8)))
    ]
    liver = body("liver", (-40, -15, 10), (75, 58, 70))
    vessel = body("vessel", (-45, -10, 15), (9, 9, 42), 0.4)
    lesion = body("lesion", (-30, 5, -5), (11, 11, 11))
    return Torso([skin, *inner, liver, vessel, lesion])


def _turned(vector: ArrayLike) -> Array:
    from scipy.spatial.transform import Rotation

    return Rotation.from_rotvec(vector).as_matrix()
