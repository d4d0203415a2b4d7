"""How near the actual needle, and its way ahead, come to structures at risk.

A plan was judged along its own line. The needle is a little beside it, and goes on
along its own direction: what counts is what lies beside the needle, and ahead of it.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from foundation.arrays import Array
from needleforce.anatomy.clearance import FreeSpace, VoxelBoxes
from needleforce.anatomy.outer_voxels import OuterVoxels
from needleforce.anatomy.registration import Registration
from needleforce.anatomy.segmentation import Segmentation

APPROACH_m = 0.05
"""The way ahead of a tip further above the entry is not judged: an arm on its way to
the patient points anywhere."""

STEP_m = 0.1e-3
"""Motion of the needle after which a near structure is measured again."""

STEP_FRACTION = 0.2
"""A structure is measured again after this fraction of the distance that it has left
above its margin: none comes nearer than its margin unnoticed, and far ones cost little.
"""

MIN_PART_m = 1e-4
"""A shorter part of the needle is measured as one of this length."""

CLOSER_m = 1e-3
"""A structure that the plan itself passes nearer than its margin is too near only when
the needle comes nearer by this much."""

MM_PER_M = 1e3


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
    """

    number: int
    name: str
    needle_m: float
    ahead_m: float
    std_m: float
    needed_m: float
    is_obstacle: bool

    @property
    def distance_m(self) -> float:
        """From the needle or its way ahead, the smaller one."""
        return min(self.needle_m, self.ahead_m)

    @property
    def is_too_near(self) -> bool:
        """Whether less stays free than must."""
        return self.distance_m <= self.needed_m

    def __str__(self) -> str:
        part = "the needle" if self.needle_m <= self.ahead_m else "the way ahead"
        if self.distance_m == 0.0:
            return f"{part} meets {self.name}"
        distance_mm = MM_PER_M * self.distance_m
        std_mm = MM_PER_M * self.std_m
        return f"{part} passes {self.name} at {distance_mm:.1f} ± {std_mm:.1f} mm"


class _Measured(NamedTuple):
    """A distance, and where the part of the needle was to which it belongs.

    Attributes:
        ends_m: Of the part, in the model, (2, 3).
        distance_m: To the structure.
    """

    ends_m: Array
    distance_m: float


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
        left_out = frozenset(leave_out)
        outer = OuterVoxels(labels)
        self._structures = [
            item
            for item in labels.structures
            if (item.is_obstacle or item.is_risk) and item.name not in left_out
        ]
        self.names = tuple(item.name for item in self._structures)
        self._boxes = [VoxelBoxes(outer, [item]) for item in self._structures]
        self._registration = registration
        self._entry_m = np.asarray(entry_m, dtype=float)
        way_m = np.asarray(target_m, dtype=float) - self._entry_m
        self._length_m = float(np.linalg.norm(way_m))
        self._axis = way_m / self._length_m
        self._std_m = space.std_m
        kept_free_m = space.needle_radius_m + space.margin_m
        planned_ends_m = np.array([entry_m, target_m], dtype=float)
        planned_m = [_measure(boxes, planned_ends_m) for boxes in self._boxes]
        self._needed_m = [
            kept_free_m if distance_m > kept_free_m else distance_m - CLOSER_m
            for distance_m in planned_m
        ]
        self._measured: dict[tuple[int, str], _Measured] = {}

    def clearances(self, tip_m: Array, axis: Array) -> tuple[NeedleClearance, ...]:
        """Return how near the needle comes to each structure, the nearest first.

        Args:
            tip_m: Tip of the needle in the robot's base, (3,).
            axis: Its direction, of length one, (3,).
        """
        tip = self._registration.to_model(tip_m)
        forward = axis @ self._registration.rotation
        depth_m = float((tip - self._entry_m) @ self._axis)
        if depth_m < -APPROACH_m:
            return ()
        ahead_m = max(self._length_m - depth_m, MIN_PART_m)
        ahead = np.array([tip, tip + ahead_m * forward])
        inside = np.array([tip - max(depth_m, MIN_PART_m) * forward, tip])
        found = [
            NeedleClearance(
                number=number,
                name=item.name,
                needle_m=self._distance_m(number, "inside", inside)
                if depth_m > 0.0
                else np.inf,
                ahead_m=self._distance_m(number, "ahead", ahead),
                std_m=self._std_m,
                needed_m=self._needed_m[number],
                is_obstacle=item.is_obstacle,
            )
            for number, item in enumerate(self._structures)
        ]
        return tuple(sorted(found, key=lambda one: one.distance_m))

    def _distance_m(self, number: int, part: str, ends_m: Array) -> float:
        """Return the distance of a part of the needle from a structure.

        A part of which no end has moved by more than a step cannot have come nearer by
        more than that, and is not measured again.
        """
        last = self._measured.get((number, part))
        if last is not None:
            moved_m = float(np.linalg.norm(ends_m - last.ends_m, axis=1).max())
            left_m = last.distance_m - self._needed_m[number]
            if moved_m <= max(STEP_m, STEP_FRACTION * left_m):
                return last.distance_m
        distance_m = _measure(self._boxes[number], ends_m)
        self._measured[number, part] = _Measured(ends_m, distance_m)
        return distance_m


def _measure(boxes: VoxelBoxes, ends_m: Array) -> float:
    """Return the distance of a straight part from voxels; infinite without any."""
    nearest = boxes.nearest(ends_m[0], ends_m[1])
    return np.inf if nearest is None else nearest.distance_m
