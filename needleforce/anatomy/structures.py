"""Structures of a segmentation, and what their names imply."""

import csv
import re
from dataclasses import dataclass
from importlib.resources import files

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
        max_colour = 255.0  # of the table; colours of a structure are from 0 to 1
        words = _telling_words(name) | _telling_words(kind)
        # Multiples of the golden ratio, modulo one, lie far apart: no two numbers close
        # by look alike where a name says nothing.
        shade = (0.618 * value) % 1.0
        bluish = f"{90 + 150 * shade} {200 - 60 * shade} {240 - 150 * shade}"
        told = [row["colour"] for row in TABLE if row["word"] in words]
        chosen = next(filter(None, told), bluish)
        colour = [float(number) / max_colour for number in chosen.split()]
        return cls(
            name=name,
            value=value,
            colour=tuple(colour),
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
