"""Structures of a segmentation: what their names imply, and which voxels are theirs."""

import csv
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from foundation.arrays import Array
from needleforce.anatomy.errors import VolumeError
from needleforce.anatomy.volume import Grid

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
