"""Scans on a grid of voxels, and the structures of a segmentation.

LPS and metres; arrays are (i, j, k) along the axes of their `Grid`. Two of them may be
stored in different orders and still agree, so only places are ever compared.

Of a structure: what its name implies, and which voxels are its own.
"""

import csv
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from itertools import product
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from foundation.arrays import Array
from needleforce.anatomy.errors import VolumeError

RAS_TO_LPS = np.array([-1.0, -1.0, 1.0])
"""Factors of x, y and z from the frame of NIfTI and of what 3D Slicer shows."""


@dataclass(frozen=True, eq=False)
class Grid:
    """Where voxels lie: point = origin + axes @ index; whole indices are centres.

    Attributes:
        shape: Voxels along each of three axes.
        origin_m: Centre of voxel 0, 0, 0 in LPS, shape (3,).
        axes_m: Steps from a voxel to the next along each axis, in columns, shape
            (3, 3).
    """

    shape: tuple[int, ...]
    origin_m: Array
    axes_m: Array

    @property
    def spacing_m(self) -> Array:
        """Distance between voxels along each axis, (3,)."""
        return np.linalg.norm(self.axes_m, axis=0)

    @property
    def voxel_m3(self) -> float:
        """Volume of a voxel."""
        return abs(float(np.linalg.det(self.axes_m)))

    def points_m(self, indices: ArrayLike) -> Array:
        """Return points (..., 3) in LPS of indices (..., 3), also between voxels."""
        return self.origin_m + np.asarray(indices, float) @ self.axes_m.T

    def indices(self, points_m: ArrayLike) -> Array:
        """Return indices (..., 3), with fractions, of points (..., 3) in LPS."""
        return (np.asarray(points_m, float) - self.origin_m) @ np.linalg.inv(
            self.axes_m
        ).T

    def nearest(
        self, values: NDArray[Any], indices: NDArray[Any], outside: float = 0
    ) -> NDArray[Any]:
        """Return the values of the voxels nearest to indices (..., 3), shape (...).

        Args:
            values: Of the grid's voxels, (i, j, k).
            indices: With fractions.
            outside: What stands beyond the grid.
        """
        voxels = np.rint(indices).astype(np.int32)
        is_valid = np.all((voxels >= 0) & (voxels < self.shape), axis=-1)
        places = tuple(np.moveaxis(np.where(is_valid[..., None], voxels, 0), -1, 0))
        return np.where(is_valid, values[places], outside)

    def corners_m(self, box: Sequence[slice] = ()) -> Array:
        """Return the centres of the voxels in the eight corners, shape (8, 3).

        Args:
            box: A box in the grid; by default the whole grid.
        """
        sides = box or [slice(0, size) for size in self.shape]
        return self.points_m([*product(*((one.start, one.stop - 1) for one in sides))])


@dataclass(frozen=True, eq=False)
class Volume:
    """A scan: one number per voxel, of a CT in Hounsfield units.

    Attributes:
        values: The numbers, (i, j, k).
        grid: Where the voxels lie.
    """

    values: NDArray[Any]
    grid: Grid


TABLE = list(
    csv.DictReader(
        files("needleforce.anatomy")
        .joinpath("structures.csv")
        .read_text(encoding="utf-8")
        .splitlines()
    )
)
"""Words in the names of structures, and what they imply.

Roles: `obstacle` stops a needle, from `risk` a needle should keep away, it may pass
what is `passable`, and `says nothing` counts only beside other words. Beside a word
that `is_soft` words of obstacles do not count: a renal pelvis is no bone. Colours are
red, green, blue of 3D Slicer's table of generic anatomy; of several the first counts.
"""

ROLES = {
    role: frozenset(row["word"] for row in TABLE if row["role"] == role)
    for role in ("obstacle", "risk", "passable", "says nothing")
}
"""Words by their role."""

SOFT = frozenset(row["word"] for row in TABLE if row["is_soft"])
"""Beside them words of obstacles do not count."""


@dataclass(frozen=True)
class Structure:
    """One labelled structure of a segmentation.

    Attributes:
        name: As the segmentation has it.
        value: Of its voxels.
        colour: Red, green, blue from 0 to 1.
        is_obstacle: Bone or cartilage.
        is_risk: Lung, vessel, bowel and others that a needle should keep away from.
        volume: In which label volume it lies: segments that overlap need several.
        voxels: How many it has.
        box: Around its voxels, one slice per axis.
        kind: What coded terms of the file say that it is; empty where there are none.
    """

    name: str
    value: int
    colour: tuple[float, ...]
    is_obstacle: bool = False
    is_risk: bool = False
    volume: int = 0
    voxels: int = 0
    box: tuple[slice, ...] = ()
    kind: str = ""

    @classmethod
    def named(
        cls, name: str, value: int, volume: int = 0, kind: str = ""
    ) -> "Structure":
        """Return a structure with the colour and the hardness that its name implies.

        Args:
            name: Of the structure.
            value: Of its voxels.
            volume: In which label volume it lies.
            kind: What coded terms of the file say that it is; it is an obstacle, or at
                risk, if name or kind say so.
        """
        words = _telling_words(name) | _telling_words(kind)
        # Multiples of the golden ratio, modulo one, lie far apart: no two numbers close
        # by look alike where a name says nothing.
        shade = (0.618 * value) % 1.0
        bluish = f"{90 + 150 * shade} {200 - 60 * shade} {240 - 150 * shade}"
        told = [row["colour"] for row in TABLE if row["word"] in words]
        chosen = next(filter(None, told), bluish)
        return cls(
            name=name,
            value=value,
            colour=tuple(float(number) / 255.0 for number in chosen.split()),
            is_obstacle=bool(words & ROLES["obstacle"]),
            is_risk=bool(words & ROLES["risk"]),
            volume=volume,
            kind=kind,
        )

    @property
    def anatomy(self) -> str:
        """What it is: its name, or its kind where the name says nothing known."""
        return self.name if is_known(self.name) or not self.kind else self.kind


def words_of(name: str) -> set[str]:
    """Return the words of a structure's name, in small letters.

    They are divided by what is no letter, by digits, and by capitals behind small
    letters: ``RightRib9`` has the words right, rib and 9.
    """
    divided = re.sub(
        r"(?<=[^\W\d_])(?=\d)|(?<=\d)(?=[^\W\d_])|(?<=[a-z])(?=[A-Z])"
        r"|(?<=[A-Z])(?=[A-Z][a-z])",
        " ",
        name,
    )
    return set(re.split(r"[\W_]+", divided.lower()))


def is_known(name: str) -> bool:
    """Return whether a name says what a structure is, in words that are known here."""
    known = ROLES["obstacle"] | ROLES["risk"] | SOFT | ROLES["passable"]
    return bool((words_of(name) - ROLES["says nothing"]) & known)


def _telling_words(name: str) -> set[str]:
    """Return the words of a name, without those of bone in names of soft tissue."""
    words = words_of(name)
    return words - ROLES["obstacle"] if words & SOFT else words


NO_SCAN = "labels not checked against a scan: none was given"
"""What is said of labels that were read alone."""


@dataclass(frozen=True, eq=False)
class Segmentation:
    """Label volumes on one grid, and what their values mean.

    Attributes:
        volumes: Each (i, j, k); 0 is no structure.
        grid: Where the voxels lie.
        structures: Those with voxels.
        unchecked: Why the labels were not checked against their scan; empty if they
            were.
    """

    volumes: Sequence[NDArray[np.integer]]
    grid: Grid
    structures: tuple[Structure, ...]
    unchecked: str = NO_SCAN

    @classmethod
    def of(
        cls,
        volumes: Sequence[NDArray[Any]],
        grid: Grid,
        structures: Iterable[Structure],
    ) -> Self:
        """Return labels with the voxels of each structure counted.

        Structures without voxels are left out.

        Raises:
            VolumeError: No structure has a voxel, or two have one name or one label.
        """
        items = list(structures)
        names = [item.name for item in items]
        labels = {(item.volume, item.value) for item in items}
        if len({*names}) < len(items) or len(labels) < len(items):
            raise VolumeError(f"two of {', '.join(names)} have one name or one label")
        boxes = [dict(enumerate(ndimage.find_objects(one), 1)) for one in volumes]
        found: list[Structure] = []
        for item in items:
            box = boxes[item.volume].get(item.value)
            if box is not None:
                voxels = np.count_nonzero(volumes[item.volume][box] == item.value)
                found.append(replace(item, voxels=int(voxels), box=box))
        if not found:
            raise VolumeError("no voxel is labelled: expected at least one structure")
        return cls(volumes, grid, tuple(found))

    def __getitem__(self, name: str) -> Structure:
        by_name = {item.name: item for item in self.structures}
        if name not in by_name:
            raise VolumeError(
                f"no structure with voxels is named {name!r}; there are "
                f"{', '.join(by_name)}",
            )
        return by_name[name]

    def at_risk(self) -> list[Structure]:
        """Return the obstacles, and the structures that a needle should not meet."""
        return [one for one in self.structures if one.is_obstacle or one.is_risk]

    def mask(self, name: str) -> NDArray[np.bool_]:
        """Return which voxels in a structure's box belong to it, (i, j, k)."""
        structure = self[name]
        return self.volumes[structure.volume][structure.box] == structure.value

    def corner(self, name: str) -> NDArray[np.integer]:
        """Return the index of the first voxel in a structure's box, (3,)."""
        return np.array([side.start for side in self[name].box])

    def centroid_m(self, name: str) -> Array:
        """Return the mean position of a structure's voxels in LPS, (3,)."""
        middle = ndimage.center_of_mass(self.mask(name))
        return self.grid.points_m(self.corner(name) + middle)

    def deepest_point_m(self, name: str) -> Array:
        """Return the point of a structure that lies farthest from its surface, (3,)."""
        mask = np.pad(self.mask(name), 1)
        depth_m: Any = ndimage.distance_transform_edt(mask, self.grid.spacing_m)
        index = np.unravel_index(depth_m.argmax(), mask.shape)
        return self.grid.points_m(self.corner(name) - 1 + index)

    def inside(self) -> NDArray[np.bool_]:
        """Return which voxels any structure covers, (i, j, k)."""
        return np.any([volume != 0 for volume in self.volumes], axis=0)
