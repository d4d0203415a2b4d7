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
from needleforce.anatomy.labels import Labels
from needleforce.anatomy.registration import Registration

REACH_m = 0.1
"""Structures further away than this are not reported."""


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
        labels: Labels,
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
