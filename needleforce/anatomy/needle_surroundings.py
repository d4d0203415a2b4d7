"""How near the actual needle, and its way ahead, come to structures at risk.

A plan was judged along its own line. The needle is a little beside it, and goes on
along its own direction: what counts is what lies beside the needle, and ahead of it.
"""

from collections.abc import Iterable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from foundation.arrays import Array, Matrix, Vector, WrittenBlocks, WrittenMatrix
from foundation.jit import compile_waiting, compiled
from needleforce.anatomy.clearance import FreeSpace, VoxelBoxes, nearest_box
from needleforce.anatomy.registration import Registration

if TYPE_CHECKING:
    from needleforce.anatomy.labels import Labels

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
        distance_mm = MM_PER_M * self.distance_m
        std_mm = MM_PER_M * self.std_m
        return f"{part} passes {self.name} at {distance_mm:.1f} ± {std_mm:.1f} mm"


def sort_clearances(
    clearances: Iterable[NeedleClearance],
) -> tuple[NeedleClearance, ...]:
    """Return clearances, those of what is too near first, then the nearest first.

    What must stay free differs: a structure that the plan itself passes may be nearest
    and not too near, while another one is.
    """
    return tuple(
        sorted(clearances, key=lambda one: (not one.is_too_near, one.distance_m))
    )


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
        labels: "Labels",
        registration: Registration,
        entry_m: ArrayLike,
        target_m: ArrayLike,
        space: FreeSpace,
        leave_out: Iterable[str] = (),
    ) -> None:
        # A structure that the plan itself passes nearer than its margin is too near
        # only when the needle comes nearer by this much.
        closer_m = 1e-3
        left_out = frozenset(leave_out)
        self._structures = [
            item
            for item in labels.structures
            if (item.is_obstacle or item.is_risk) and item.name not in left_out
        ]
        self.names = tuple(item.name for item in self._structures)
        boxes = [VoxelBoxes(labels, item) for item in self._structures]
        self._registration = registration
        self._entry_m = np.asarray(entry_m, dtype=float)
        way_m = np.asarray(target_m, dtype=float) - self._entry_m
        self._length_m = float(np.linalg.norm(way_m))
        self._axis = way_m / self._length_m
        self._std_m = space.std_m
        kept_free_m = space.needle_radius_m + space.margin_m
        planned = [one.nearest(entry_m, target_m, REACH_m) for one in boxes]
        planned_m = np.array(
            [np.inf if one is None else one.distance_m for one in planned]
        )
        self._needed_m = np.where(
            planned_m > kept_free_m, kept_free_m, planned_m - closer_m
        )
        compile_waiting()
        self._along_grid = boxes[0].along_grid if boxes else np.asarray
        self._from_grid = boxes[0].from_grid if boxes else np.asarray
        self._trees = np.concatenate([np.zeros((0, 6)), *(one.tree for one in boxes)])
        self._begins = np.cumsum([0.0, *(len(one.tree) for one in boxes)])
        self._distances_m = np.full((2, len(boxes)), np.inf)
        self._measured_ends = np.full((2, len(boxes), 6), np.inf)
        self._places_m = np.full((2, len(boxes), 3), np.nan)
        self._was_inside = False
        self._found: tuple[NeedleClearance, ...] = ()

    def clearances(self, tip_m: Array, axis: Array) -> tuple[NeedleClearance, ...]:
        """Return how near the needle comes to structures within 0.1 m.

        Those that are too near come first, then the nearest.

        Args:
            tip_m: Tip of the needle in the robot's base, (3,).
            axis: Its direction, of length one, (3,).
        """
        # The way ahead of a tip further above the entry is not judged: an arm on its
        # way to the patient points anywhere.
        approach_m = 0.05
        tip = self._registration.to_model(tip_m)
        forward = axis @ self._registration.rotation
        depth_m = float((tip - self._entry_m) @ self._axis)
        if depth_m < -approach_m:
            return ()
        # A shorter part of the needle is measured as one of 0.1 mm.
        inside_m = max(depth_m, 1e-4) * forward
        ahead_m = max(self._length_m - depth_m, 1e-4) * forward
        ends = self._along_grid([tip - inside_m, tip, tip, tip + ahead_m])
        measured = measure_again(
            self._trees,
            self._begins,
            self._needed_m,
            ends,
            self._measured_ends,
            self._distances_m,
            self._places_m,
        )
        is_inside = depth_m > 0.0
        if measured or is_inside != self._was_inside:
            self._was_inside = is_inside
            self._found = self._clearances()
        return self._found

    def _clearances(self) -> tuple[NeedleClearance, ...]:
        """Return the measured distances of structures within 0.1 m, in order."""
        inside_m, ahead_m = self._distances_m
        if not self._was_inside:
            inside_m = np.full_like(ahead_m, np.inf)
        part = (inside_m > ahead_m).astype(int)
        nearest = self._from_grid(self._places_m[part, np.arange(len(part))])
        places_m = self._registration.to_robot(nearest).tolist()
        found = [
            NeedleClearance(
                *(number, item.name, float(inside_m[number]), float(ahead_m[number])),
                *(self._std_m, float(self._needed_m[number]), item.is_obstacle),
                *places_m[number],
            )
            for number, item in enumerate(self._structures)
            if min(inside_m[number], ahead_m[number]) < np.inf
        ]
        return sort_clearances(found)


@compiled
def measure_again(
    trees: Matrix,
    begins: Vector,
    needed: Vector,
    ends: Matrix,
    measured_ends: WrittenBlocks,
    distances: WrittenMatrix,
    places: WrittenBlocks,
) -> int:
    """Measure the distances of straight parts of the needle that may have changed.

    None comes nearer than it must stay unnoticed, and far ones cost little. Returns how
    many were measured.

    Args:
        trees: Boxes of all structures, see `clearance.nearest_box`.
        begins: Row at which each structure's begin, and the end of the last, (n + 1,).
        needed: How far from each the needle must stay, (n,).
        ends: Of the parts inside and ahead, along the axes of the boxes, (4, 3).
        measured_ends: The ends with which each distance was measured, (2, n, 6).
        distances: From each structure, infinite beyond `REACH_m`, (2, n).
        places: Where each structure is nearest, along the axes of the boxes,
            (2, n, 3).
    """
    step = 0.1e-3  # of the needle, after which a near structure is measured again
    step_fraction = 0.2  # of what is left above what is needed, for far ones
    count = 0
    for part in range(2):
        both = ends[2 * part : 2 * part + 2]
        for number in range(len(needed)):
            moved = 0.0
            for end in range(2):
                square = 0.0
                for i in range(3):
                    square += (
                        both[end, i] - measured_ends[part, number, 3 * end + i]
                    ) ** 2
                moved = max(moved, np.sqrt(square))
            left = min(distances[part, number], REACH_m) - needed[number]
            if moved <= max(step, step_fraction * left):
                continue
            tree = trees[int(begins[number]) : int(begins[number + 1])]
            nearest, fraction, row = nearest_box(tree, both, REACH_m)
            distances[part, number] = nearest if fraction >= 0.0 else np.inf
            for i in range(3):
                low = tree[row, i] - tree[row, 3 + i]
                high = tree[row, i] + tree[row, 3 + i]
                place = both[0, i] + fraction * (both[1, i] - both[0, i])
                places[part, number, i] = min(max(place, low), high)
            measured_ends[part, number, :3] = both[0]
            measured_ends[part, number, 3:] = both[1]
            count += 1
    return count
